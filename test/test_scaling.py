"""The benchmarks of growth, memory and time: that they measure what they say, on small work."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.peers.report import MUJOCO, RAPIER
from benchmarks.peers.worlds import EDGES, World, break_body
from benchmarks.scaling.growth import Exponents, GrowthRow, ThreadsRow, fit_exponents, measure_growth, measure_threads
from benchmarks.scaling.limits import FIRST, LOOSE, TIGHT, UPDATE, Aim, measure_limits
from benchmarks.scaling.machine import measure_machine
from benchmarks.scaling.memory import MemoryRow, measure_memory
from benchmarks.scaling.piles import copy_of, make_pile, world_of
from benchmarks.scaling.report import Asked, write_csv
from benchmarks.scaling.round_trips import RoundTripRow, measure_round_trips
from benchmarks.scaling.updates import UpdateRow, measure_update_of_one
from benchmarks.scaling.visits import KINDS_OF_VISIT, FloorRow, VisitRow, floor_of
from benchmarks.studies.as_a_whole import SHEETS, scaling_section
from fracture_collision.geometry.generators import ball
from fracture_collision.world import Settings


@pytest.fixture(scope="module")
def source() -> World:
    seeds = np.random.default_rng(5).uniform(-0.6, 0.6, (6, 3))
    return break_body("ball6", ball(1.0, 0.35), seeds, False, EDGES)


def test_a_pile_lies_on_the_floor_and_is_the_same_again(source: World) -> None:
    count = 2 * len(source.fragments) + 2
    pile = make_pile(source, count)
    assert len(pile.bodies) == len(pile.events) == 3
    assert len(set(pile.states.fragment_ids.tolist())) == count
    again = make_pile(source, count)
    assert all(np.array_equal(a, b) for a, b in zip(pile.states, again.states, strict=True))
    turns = Rotation.from_quat(pile.states.orientations.reshape(-1, 4))
    centres = np.tile([f.centre for f in source.fragments], (3, 1))[:count]
    heights = (pile.states.positions.reshape(-1, 3) + turns.apply(centres))[:, 2]
    # the floor is at 0 and the first bodies began with their middles at 1.2
    assert heights.min() > 0.0 and np.median(heights) < 1.0
    answer = world_of(pile, Settings(threads=1)).contacts(pile.states)
    assert len(answer.gaps) > 0 and -0.1 < np.median(answer.gaps) < 0.0  # [R] slight overlaps


def test_copies_have_ids_of_their_own(source: World) -> None:
    copies = [copy_of(source, k) for k in range(3)]
    ids = [i for body, event in copies for i in (body.fragment_id, *event.new_fragment_ids.tolist())]
    assert len(set(ids)) == len(ids)


def test_a_known_exponent_is_found() -> None:
    rows = [GrowthRow(n, 4 * n, n, n, n, 1e-3 * n**1.5, n**1.2, n**1.2, 1.0) for n in (100, 300, 1000)]
    found = fit_exponents(rows)
    assert found.over_close_pairs == pytest.approx(1.2) and found.steepest == pytest.approx(1.2)
    assert found.broad_over_fragments == pytest.approx(1.5)


def test_growth_and_threads(source: World) -> None:
    small, large = measure_growth(source, (6, 24), repeats=2)
    assert (small.fragments, large.fragments) == (6, 24) and large.close_pairs > small.close_pairs
    assert 0.0 < large.broad_phase < large.whole and 0.0 < large.narrow_phase < large.whole
    (threads,) = measure_threads(source, 12, repeats=2)
    assert threads.same_bytes and threads.one > 0.0 and threads.two > 0.0 and threads.machine_speed_up > 0.0


def test_breaking_one_of_many(source: World) -> None:
    alone, one_of, last = measure_update_of_one(source, many=3, repeats=2)
    assert (alone.bodies, one_of.bodies, last.broken_before) == (1, 3, 2)
    assert alone.whole_over_alone == 1.0
    assert all(row.check > 0.0 and row.update > 0.0 and row.whole > row.update for row in (alone, one_of, last))


def test_what_a_visit_cannot_do_without() -> None:
    machine = measure_machine(1 << 16)
    assert machine.flop < machine.flop_latency and machine.load < machine.load_latency
    culled, located, listed = (floor_of(work, machine) for work in KINDS_OF_VISIT)
    assert 0.0 < culled.least < located.least < listed.least
    assert all(row.least < row.in_turn for row in (culled, located, listed))


def test_limits_are_below_what_is_measured(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a world of its own size, beside times that a CSV file gives."""
    monkeypatch.setattr("benchmarks.scaling.limits.PAUSE", 0.0)  # between looks, for a machine that others use
    peers = tmp_path / "peers.csv"
    rows = {TIGHT: (9.0, 18.0, 20.0), LOOSE: (9.0, 6.0, 5.0), MUJOCO: (30.0, 0.5, 0.3), RAPIER: (5.0, 3.0, 1.0)}
    with peers.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(("world", "method", "update", "first_query", "jitter_query"))
        writer.writerows(("shell20w", method, *times) for method, times in rows.items())
    whats = (TIGHT, MUJOCO, 3.0), (LOOSE, MUJOCO, 3.0), (UPDATE, RAPIER, 0.25), (FIRST, RAPIER, 0.5)
    tight, loose, update, both = measure_limits(
        [Aim(what, "shell20w", peer, times) for what, peer, times in whats], peers
    )
    assert tight.aim == pytest.approx(0.9) and update.aim == pytest.approx(1.25) and loose.ours == 5.0
    # fewer contacts have to be listed, all samples of cracks that are shared by pairs with few to be seen
    assert 0.0 < loose.alone < tight.alone and 0.0 < update.alone == both.alone - tight.alone
    assert 0.0 < loose.least < tight.least and update.least > 0.0 and update.rests_on.count("in") >= 4
    assert both.aim == pytest.approx(4.0) and both.ours == 27.0 and both.least == update.least + tight.least


@pytest.mark.slow
def test_memory_of_a_body_and_of_one_more() -> None:
    (row,) = measure_memory(("bunny",), (1,))
    assert row.nodes == 2010 and row.pieces >= 20
    assert 0.0 < row.whole_held < row.broken_held < row.peak_held
    # the system sees no less than a half of what is counted, and one more whole body shares the preprocess
    assert 0.5 * row.broken_held < row.broken_resident
    assert row.one_more_held < 0.1 * row.whole_held


@pytest.mark.slow
def test_round_trips_are_longer_than_the_computation(source: World) -> None:
    for row in measure_round_trips(source, 12, steps=5):
        assert row.steps == 5 and row.beyond > row.in_service > 0.0 and row.beyond_worst >= row.beyond


def test_the_page_has_a_column_for_what_was_measured(tmp_path: Path) -> None:
    fields = {
        "growth": GrowthRow, "exponents": Exponents, "threads": ThreadsRow, "memory": MemoryRow, "updates": UpdateRow,
        "visits": VisitRow, "floors": FloorRow, "round_trips": RoundTripRow,
    }  # fmt: skip
    for sheet in SHEETS:
        assert {column.name for column in sheet.columns} <= set(fields[sheet.name]._fields)
    assert scaling_section(tmp_path) == ""
    write_csv("growth", [GrowthRow(100, 4321, 50, 300, 1000, 0.25, 2.0, 2.5, 6.25)], tmp_path / "scaling.csv")
    write_csv("exponents", [Exponents(0.9123, 1.0, 1.0, 1.1)], tmp_path / "scaling.csv")
    section = scaling_section(tmp_path)
    assert "| 100 | 4,321 | 300 | 1,000 | 0.25 | 2.5 | 6.2 |" in section and "| 0.91 |" in section
    assert "Two threads" not in section


def test_tables_are_written(tmp_path: Path) -> None:
    rows = [GrowthRow(100, 400, 50, 300, 1000, 0.25, 2.0, 2.5, 6.25)]
    written = write_csv("growth", rows, tmp_path / "scaling.csv")
    with written.open() as file:
        (line,) = csv.DictReader(file)
    assert written.name == "scaling_growth.csv" and float(line["broad_phase"]) == 0.25 and line["cpu"]
    assert Asked("speed-up", 1.8, 1.7, at_least=True).is_met and not Asked("exponent", 1.2, 1.15).is_met

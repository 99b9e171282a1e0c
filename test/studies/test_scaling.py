"""The benchmarks of growth, memory and time measure the intended quantities, on small inputs."""

from __future__ import annotations

from itertools import count
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.peers.worlds import EDGES, World, break_body
from benchmarks.scaling.growth import Exponents, GrowthRow, ThreadsRow, fit_exponents, measure_growth, measure_threads
from benchmarks.scaling.heaps import FAST, MODERATE, SLOW, HeapRow, measure_heaps
from benchmarks.scaling.machine import Machine
from benchmarks.scaling.memory import MemoryRow, measure_memory
from benchmarks.scaling.piles import make_pile, world_of
from benchmarks.scaling.report import write_csv
from benchmarks.scaling.round_trips import RoundTripRow, measure_round_trips
from benchmarks.scaling.small_updates import SmallUpdateRow, measure_small_updates
from benchmarks.scaling.updates import UpdateRow, measure_update_of_one
from benchmarks.scaling.visits import KINDS_OF_VISIT, FloorRow, VisitRow, Work, floor_of
from benchmarks.studies.as_a_whole import SHEETS, scaling_section
from fracture_collision.geometry.generators import ball
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings


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
    # the floor is at 0 and the first bodies started with their centres at 1.2
    assert heights.min() > 0.0 and np.median(heights) < 1.0
    answer = world_of(pile, Settings(threads=1)).contacts(pile.states)
    assert len(answer.gaps) > 0 and -0.1 < np.median(answer.gaps) < 0.0  # [R] slight overlaps


def test_a_known_exponent_is_found() -> None:
    rows = [GrowthRow(n, 4 * n, n, n, n, 1e-3 * n**1.5, n**1.2, n**1.2, 1.0) for n in (100, 300, 1000)]
    found = fit_exponents(rows)
    assert found.over_close_pairs == pytest.approx(1.2) and found.steepest == pytest.approx(1.2)
    assert found.broad_over_fragments == pytest.approx(1.5)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> None:
    """A clock that advances by one second per reading, so a timed block lasts as many seconds as it reads the clock."""
    for module in ("growth", "heaps", "small_updates", "updates"):
        monkeypatch.setattr(f"benchmarks.scaling.{module}.perf_counter", count(0.0, 1.0).__next__)


def test_growth_and_threads(source: World, clock: None, monkeypatch: pytest.MonkeyPatch) -> None:
    small, large = measure_growth(source, (6, 24), repeats=2)
    assert (small.fragments, large.fragments) == (6, 24)
    assert small.close_pairs < large.close_pairs and small.visits < large.visits
    for row in (small, large):
        assert row.contact_pairs <= min(row.close_pairs, row.contacts) and row.whole == 1e3
        assert row.microseconds_a_pair == 1e6 / row.close_pairs
    # the work per pair does not grow with the pile
    assert large.visits / large.close_pairs < 1.5 * small.visits / small.close_pairs
    monkeypatch.setattr("benchmarks.scaling.growth.second_core", lambda: 2.0)
    (threads,) = measure_threads(source, 12, repeats=2)
    assert threads.same_bytes and threads.contacts > 0
    assert (threads.one, threads.two, threads.speed_up, threads.machine_speed_up) == (1e3, 1e3, 1.0, 2.0)


def test_breaking_one_of_many(source: World, clock: None) -> None:
    rows = measure_update_of_one(source, many=3, repeats=2)
    alone, one_of, last = rows
    assert (alone.bodies, one_of.bodies, last.broken_before) == (1, 3, 2)
    assert {(row.nodes, row.pieces) for row in rows} == {(len(source.body.vertices), len(source.fragments))}
    assert alone.whole_over_alone == alone.update_over_alone == 1.0
    for row in rows:
        assert row.check == row.masses == 1e3 and row.whole == pytest.approx(row.check + row.update + row.masses)


def test_heaps_at_rest_and_in_slow_motion(source: World, clock: None, monkeypatch: pytest.MonkeyPatch) -> None:
    poses, ask = [], CollisionWorld.contacts

    def contacts(world: CollisionWorld, states: FragmentStates) -> ContactConstraintArray:
        poses.append(states.positions.reshape(-1, 3))
        return ask(world, states)

    monkeypatch.setattr(CollisionWorld, "contacts", contacts)
    steps, size = 7, 12
    rows = measure_heaps(source, (size,), steps)
    assert [(row.fragments, row.moving, row.step) for row in rows] == [
        (size, 0, 0.0), (size, 1, MODERATE), (size, size, SLOW), (size, size, MODERATE), (size, size, FAST),
    ]  # fmt: skip
    own = len(poses[1:]) // len(rows)  # the first call applies the fractures
    for k, row in enumerate(rows):
        assert row.contacts > 0 and row.whole == 1e3 and row.microseconds_a_pair == 1e6 / row.close_pairs
        timed = slice(1 + (k + 1) * own - steps - 1, 1 + (k + 1) * own)
        moves = np.linalg.norm(np.diff(poses[timed], axis=0), axis=2)  # [m], R is 1 m
        assert np.all(np.count_nonzero(moves > 1e-12, axis=1) == row.moving), "in every step, none is still at a turn"
        assert moves.max() == pytest.approx(0.01 * row.step)


def test_breaking_a_small_fragment_of_a_large_body(clock: None) -> None:
    geometry = ball(1.0, 0.15)
    (row,) = measure_small_updates(geometry, pieces=20, events=3)
    assert row.nodes == len(geometry.vertices) and 10 < row.fragments <= 20 and row.events == 3
    mean = row.nodes / row.fragments
    assert 0.75 * mean < row.broken_nodes < 1.3 * mean and 2.0 <= row.pieces <= 4.0
    assert row.check == row.masses == 1e3 and row.whole == pytest.approx(row.check + row.update + row.masses)
    assert row.worst >= row.whole


# [ns] of a load, an addition and a branch misprediction, each of a different order of magnitude.
MACHINE = Machine(1 << 16, load_latency=1e6, load=1e5, flop_latency=10.0, flop=1.0, wrong_guess=2e8)


def test_lower_bounds_of_a_visit() -> None:
    work = Work("visit", lines=3, steps=2, flops=50, depth=7, guesses=4)
    floor = floor_of(work, MACHINE)
    assert floor.least == 3 * 1e5 and floor.in_turn == 2 * 1e6 + 7 * 10.0 + 0.5 * 4 * 2e8
    assert floor_of(work._replace(lines=0), MACHINE).least == 50.0
    kinds = [floor_of(each, MACHINE) for each in KINDS_OF_VISIT]
    assert sorted(kinds, key=lambda row: row.in_turn) == kinds, "each kind does what the one before it does, and more"


@pytest.mark.slow
def test_memory_of_a_body_and_of_one_more() -> None:
    (row,) = measure_memory(("bunny",), (1,))
    assert row.nodes == 2010 and row.pieces >= 20
    assert 0.0 < row.whole_held < row.broken_held < row.peak_held
    # resident memory is at least half of the counted memory, and another whole body shares the preprocessing
    assert 0.5 * row.broken_held < row.broken_resident
    assert row.one_more_held < 0.1 * row.whole_held


@pytest.mark.slow
def test_round_trips_are_measured_without_and_with_a_recorder(source: World) -> None:
    rows = measure_round_trips(source, 12, steps=5)
    assert [row.recorder for row in rows] == [False, True]
    for row in rows:
        assert (row.steps, row.fragments) == (5, 12) and row.contacts > 0 and row.answer_bytes > 0
        assert row.beyond_worst >= row.beyond, "one is a median of what the other is the largest of"


def test_the_page_has_a_column_for_each_measurement(tmp_path: Path) -> None:
    fields = {
        "growth": GrowthRow, "exponents": Exponents, "heaps": HeapRow, "threads": ThreadsRow, "memory": MemoryRow,
        "updates": UpdateRow, "small_updates": SmallUpdateRow, "visits": VisitRow, "floors": FloorRow,
        "round_trips": RoundTripRow,
    }  # fmt: skip
    for sheet in SHEETS:
        assert {column.name for column in sheet.columns} <= set(fields[sheet.name]._fields)
    assert scaling_section(tmp_path) == ""
    write_csv("growth", [GrowthRow(100, 4321, 50, 300, 1000, 0.25, 2.0, 2.5, 6.25)], tmp_path / "scaling.csv")
    write_csv("exponents", [Exponents(0.9123, 1.0, 1.0, 1.1)], tmp_path / "scaling.csv")
    section = scaling_section(tmp_path)
    assert "| 100 | 4,321 | 300 | 1,000 | 0.25 | 2.5 | 6.2 |" in section and "| 0.91 |" in section
    assert "Two threads" not in section

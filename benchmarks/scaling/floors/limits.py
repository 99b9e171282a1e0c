"""What the targets against other libraries leave room for: a lower bound for an answer on this machine.

The lower bounds are times of programs that only read and write what the answer depends on (`visits.Work` for queries;
the passes of `least_update.py` for updates). A target below its bound cannot be met with the same answer; above it, the
difference is the remaining potential.
"""

from __future__ import annotations

import csv
import time
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.peers.report import FIELD, MUJOCO, OURS, RAPIER, VERTICES
from benchmarks.peers.worlds import Frame, World, make_world
from benchmarks.scaling.floors.contacts_alone import contacts_alone
from benchmarks.scaling.floors.least_update import least_update, update_alone
from benchmarks.scaling.growth import ONE_THREAD, Progress, silent
from benchmarks.scaling.machine import Machine, measure_machine
from benchmarks.scaling.visits import LISTED, LOCATED, TETRAHEDRON, floor_of
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld
from fracture_collision.world.inspection import EVERY_CONTACT

# As written by `python -m benchmarks.peers --csv`: the targets are ratios to its times.
PEERS = Path(__file__).resolve().parents[3] / "docs" / "peers.csv"
TIGHT, LOOSE = OURS, "ours, epsilon 5 % R"  # settings
UPDATE, FIRST = "update", "update and first query"
COLUMNS = {UPDATE: ("update",), FIRST: ("update", "first_query")}  # of peers.csv; for queries: jitter_query
LOOSE_TOLERANCE = 0.05
LOOKS, PAUSE = 16, 0.5  # [s] between two measurements of the machine


class Aim(NamedTuple):
    """Target: `what` in one world takes at most `times` the time of `peer`."""

    what: str  # UPDATE, FIRST, or the setting of a query of jittered frames
    world: str
    peer: str
    times: float


AIMS = (
    Aim(TIGHT, "shell20w", MUJOCO, 3.0), Aim(LOOSE, "shell20w", MUJOCO, 3.0),
    Aim(TIGHT, "ball20w", MUJOCO, 3.0), Aim(LOOSE, "ball20w", MUJOCO, 3.0),
    Aim(TIGHT, "ball8", RAPIER, 1.0), Aim(TIGHT, "shell20", RAPIER, 1.0),
    Aim(TIGHT, "shell20w", VERTICES[1], 1.0 / 30.0), Aim(LOOSE, "shell20w", VERTICES[1], 1.0 / 30.0),
    Aim(TIGHT, "ball20w", VERTICES[1], 1.0 / 30.0), Aim(LOOSE, "ball20w", VERTICES[1], 1.0 / 30.0),
    Aim(UPDATE, "ball8", RAPIER, 1.0 / 4.0), Aim(UPDATE, "ball60", RAPIER, 1.0 / 2.0),
    Aim(UPDATE, "ball8", FIELD, 1.0 / 40.0), Aim(UPDATE, "ball60", FIELD, 1.0 / 20.0),
    Aim(FIRST, "ball8", RAPIER, 1.0 / 2.0), Aim(FIRST, "ball60", RAPIER, 1.0),
)  # fmt: skip


class LimitRow(NamedTuple):
    """Milliseconds, one thread."""

    what: str
    world: str
    peer: str
    times: float  # allowed multiple of the peer's time
    aim: float  # from peers.csv
    least: float
    alone: float  # our time when the contacting samples are known in advance: contacts_alone, update_alone
    ours: float  # from peers.csv
    ours_over_least: float
    rests_on: str  # the work in `least`


def measure_limits(
    aims: Sequence[Aim] = AIMS, peers: Path = PEERS, progress: Progress = silent
) -> list[LimitRow]:
    """Raises FileNotFoundError without peers.csv, KeyError if it lacks a world or method."""
    with peers.open(newline="", encoding="utf-8") as stream:
        times = {(row["world"], row["method"]): row for row in csv.DictReader(stream)}
    rows = []
    for name in dict.fromkeys(aim.world for aim in aims):
        progress(f"limits: {name}")
        its = [aim for aim in aims if aim.world == name]
        floors = _floors(make_world(name), {aim.what for aim in its})
        for aim in its:
            columns = COLUMNS.get(aim.what, ("jitter_query",))
            ours, theirs = (
                sum(float(times[name, method][column]) for column in columns)
                for method in (OURS if aim.what in COLUMNS else aim.what, aim.peer)
            )
            least, alone, words = floors[aim.what]
            rows.append(
                LimitRow(
                    aim.what, name, aim.peer, aim.times, aim.times * theirs, least, alone, ours, ours / least, words
                )
            )
    return rows


def _floors(world: World, whats: set[str]) -> dict[str, tuple[float, float, str]]:
    """For each: lower bound and answer alone [ms], and a description."""
    found = {
        what: _least_query(world, 0.0 if what == TIGHT else LOOSE_TOLERANCE)
        for what in (TIGHT, LOOSE)
        if what in whats or (what == TIGHT and FIRST in whats)
    }
    if whats & COLUMNS.keys():
        least, words = least_update(world)
        found[UPDATE] = least, update_alone(world), words
    if FIRST in whats:
        (least, alone, _), (query, its_contacts, _) = found[UPDATE], found[TIGHT]
        found[FIRST] = least + query, alone + its_contacts, "both of these"
    return found


def _least_query(world: World, tolerance: float) -> tuple[float, float, str]:
    """[ms] of a jittered frame, [ms] of its contacts alone, and a description. `tolerance`: 0: the service's default.

    Contacts must be located and listed. In a pair with fewer contacts than allowed, every other sample of the shared
    crack must be located too: in place it touches, so only its current position shows that it no longer does.
    """
    settings = ONE_THREAD._replace(penetration_tolerance=tolerance) if tolerance else ONE_THREAD
    everything = ONE_THREAD._replace(contacts_per_pair=EVERY_CONTACT)
    service, in_place = (_broken(world, chosen) for chosen in (settings, everything))
    shared = _contacts_of_pairs(in_place.contacts(_states(next(f for f in world.frames if f.kind == "touch"), world)))
    contacts, located, alone = [], [], []
    for frame in world.frames:
        if frame.kind != "jitter":
            continue
        states = _states(frame, world)
        answer = service.contacts(states)
        found = _contacts_of_pairs(answer)
        alone.append(contacts_alone(service, states, answer))
        contacts.append(sum(found.values()))
        wanted = settings.contacts_per_pair
        located.append(sum(max(n - found.get(pair, 0), 0) for pair, n in shared.items() if found.get(pair, 0) < wanted))
    machine = _undisturbed(TETRAHEDRON * len(world.body.tetrahedra))
    listed, apart = (floor_of(work, machine).in_turn for work in (LISTED, LOCATED))
    mean_listed, mean_apart = float(np.mean(contacts)), float(np.mean(located))
    words = f"{mean_listed:.0f} contacts at {listed:.0f} ns, {mean_apart:.0f} other samples of cracks at {apart:.0f} ns"
    return 1e-6 * (mean_listed * listed + mean_apart * apart), float(np.mean(alone)), words


@cache
def _undisturbed(footprint: int) -> Machine:
    """The machine's best figures.

    Other users of the shared cache make a load five times as slow, for seconds at a time.
    """
    measured = []
    for _ in range(LOOKS):
        measured.append(measure_machine(footprint))
        time.sleep(PAUSE)
    return Machine(*map(min, zip(*measured, strict=True)))


def _broken(world: World, settings) -> CollisionWorld:
    service = CollisionWorld(settings)
    service.add_body(world.body)
    service.add_fracture(world.event)
    return service


def _states(frame: Frame, world: World) -> FragmentStates:
    ids = np.array([f.fragment_id for f in world.fragments])
    return FragmentStates(1, 1, ids, frame.body_positions.ravel(), frame.quaternions.ravel())


def _contacts_of_pairs(answer: ContactConstraintArray) -> dict[tuple[int, int], int]:
    counts = np.diff(answer.pair_begin.astype(np.int64)).tolist()
    return dict(zip(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True), counts, strict=True))

"""Breakdown of the time of the paper's method with exact distances: visits, ns per visit, and a lower bound for one."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

import numpy as np

from benchmarks.peers.measure import KINDS
from benchmarks.peers.worlds import World, empty_states, make_world
from benchmarks.scaling.growth import Progress, silent
from benchmarks.scaling.machine import Machine, measure_machine
from benchmarks.studies.scene_trials import PAPERS
from fracture_collision.records import FragmentStates
from fracture_collision.world import CollisionWorld

WORLDS = ("ball20", "ball20w", "shell20w")
TREE_ENTRY = 44  # [bytes] of a node of a sphere tree: centre, radius, and its entry
# [bytes] that point location reads per tetrahedron: barycentric weights, fragment, places in the cells' lists.
TETRAHEDRON = 128


class Work(NamedTuple):
    """The work of one visit, counted in glondu2014/algorithm1, elementary_queries, point_location and flood of core.

    Counts only what the outcome depends on: the one tetrahedron that holds the point, not those tried before it; the
    one nearest triangle. Working memory (queues, poses, the other's box) is assumed to be in cache.
    """

    name: str
    lines: int  # cache lines of trees and meshes
    steps: int  # of these, lines whose address depends on the previous one
    flops: int  # additions, multiplications, comparisons of numbers; a root or a division counts as eight
    depth: int  # of these, operations that wait for the previous one
    guesses: int  # branches that depend on the position of the point


# Its sphere and entry; the point rotated and translated (18), the other's box (17), a root, a sum, a comparison.
CULLED = Work("culled child", 2, 1, 45, 22, 1)
# As above; the cell in the grid of occupied cells (12), the cell's list and its first tetrahedron, three barycentric
# weights in two lines (21) and their slack (9), the tetrahedron's fragment.
LOCATED = Work("located sample outside", 2 + 6, 1 + 4, 45 + 17 + 12 + 30, 22 + 12 + 14, 4)
# As above; the tetrahedron's four faces as bounds of the depth (56), its list of triangles (begin, count, kind, front,
# back), one plane (7) and one triangle (three lines; 110), the direction (20), two points and a normal transformed to
# the world (45) and written (three lines).
LISTED = Work("listed contact", 8 + 5 + 3 + 3, 5 + 3, 104 + 56 + 7 + 110 + 20 + 45, 48 + 38, 10)
KINDS_OF_VISIT = (CULLED, LOCATED, LISTED)


class VisitRow(NamedTuple):
    """One kind of frame of one world, one thread; medians over frames and rounds."""

    world: str
    kind: str
    close_pairs: float  # per frame
    contacts: float
    visits: float
    visits_a_pair: float
    broad_share: float  # of broad and narrow phase combined
    nanoseconds_a_pair: float  # both phases
    nanoseconds_a_visit: float  # narrow phase
    least: float  # [ns] per visit if all but those that became contacts were culled, loads and flops at full speed
    in_turn: float  # [ns] the same, each step waiting for the previous one
    in_turn_located: float  # [ns] the same, if all that became no contact were located samples
    best: float  # nanoseconds_a_visit in the best round, as the machine's figures are its best
    off: float  # best / in_turn


class FloorRow(NamedTuple):
    """One kind of visit on this machine [ns]."""

    visit: str
    lines: int
    flops: int
    footprint: int  # [bytes] covered by its loads
    load: float  # per line, address known
    load_latency: float
    flop: float
    flop_latency: float
    wrong_guess: float
    least: float  # loads or flops at full speed, whichever is slower
    in_turn: float  # each step waits for the previous one, and half of the branch predictions are wrong


def measure_visits(
    names: Sequence[str] = WORLDS, repeats: int = 7, progress: Progress = silent
) -> tuple[list[VisitRow], list[FloorRow]]:
    """Frames of benchmarks.peers: fragments in place, moved by up to 1 % R, and heaped."""
    rows, floors = [], []
    for name in names:
        progress(f"visits: {name}")
        world = make_world(name)
        service = CollisionWorld(PAPERS)
        service.add_body(world.body)
        service.add_fracture(world.event)
        service.contacts(empty_states(1))
        trees = measure_machine(TREE_ENTRY * sum(len(f.samples) + len(f.nodes) for f in world.fragments))
        mesh = measure_machine(TETRAHEDRON * len(world.body.tetrahedra))
        floors = [floor_of(work, trees if work is CULLED else mesh) for work in KINDS_OF_VISIT]
        for kind in KINDS:
            rows.append(_measure(world, service, kind, repeats, floors))
    return rows, floors


def floor_of(work: Work, machine: Machine) -> FloorRow:
    in_turn = (
        work.steps * machine.load_latency + work.depth * machine.flop_latency + 0.5 * work.guesses * machine.wrong_guess
    )
    return FloorRow(
        work.name, work.lines, work.flops, machine.footprint, machine.load, machine.load_latency, machine.flop,
        machine.flop_latency, machine.wrong_guess, max(work.lines * machine.load, work.flops * machine.flop), in_turn,
    )  # fmt: skip


def _measure(world: World, service: CollisionWorld, kind: str, repeats: int, floors: Sequence[FloorRow]) -> VisitRow:
    ids = np.array([f.fragment_id for f in world.fragments])
    frames = [f for f in world.frames if f.kind == kind]
    states = [FragmentStates(1, 1, ids, f.body_positions.ravel(), f.quaternions.ravel()) for f in frames]
    pairs, contacts, visits, shares, narrow, both = [], [], [], [], [], []
    for i in range(repeats + 1):
        for state in states:
            service.forget()
            answer = service.contacts(state)
            if i == 0:  # warm-up
                pairs.append(service.last_pairs)
                contacts.append(len(answer.gaps))
                visits.append(service.last_visits)
                continue
            times = service.last_timings
            together = times["broad_phase"] + times["narrow_phase"]
            shares.append(times["broad_phase"] / together)
            narrow.append(times["narrow_phase"])
            both.append(together)
    mean_pairs, mean_contacts, mean_visits = (float(np.mean(x)) for x in (pairs, contacts, visits))
    listed = mean_contacts / mean_visits
    culled, located, contact = floors
    in_turn = (1.0 - listed) * culled.in_turn + listed * contact.in_turn
    # a round's frames are summed, as they differ in size
    a_round = np.array(narrow).reshape(repeats, -1).sum(axis=1)
    a_visit, best = (1e9 * float(x) / sum(visits) for x in (np.median(a_round), a_round.min()))
    return VisitRow(
        world.name, kind, mean_pairs, mean_contacts, mean_visits, mean_visits / mean_pairs, median(shares),
        1e9 * float(np.median(np.array(both).reshape(repeats, -1).sum(axis=1))) / sum(pairs), a_visit,
        (1.0 - listed) * culled.least + listed * contact.least, in_turn,
        (1.0 - listed) * located.in_turn + listed * contact.in_turn, best, best / in_turn,
    )  # fmt: skip

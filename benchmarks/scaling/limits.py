"""What the aims against other libraries leave room for: the least that an answer can take on this machine.

Least times are those of programs that do nothing but read and write what the answer rests on (`visits.Work` for
queries; for updates the passes below). Where an aim lies below them, nobody meets it who gives the same answer; where
it lies above, the distance is what is left to do.
"""

from __future__ import annotations

import csv
import hashlib
import math
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.peers.report import FIELD, MUJOCO, OURS, RAPIER, VERTICES
from benchmarks.peers.worlds import Frame, World, empty_states, make_world
from benchmarks.scaling.contacts_alone import contacts_alone
from benchmarks.scaling.growth import SEARCHED, Progress, silent
from benchmarks.scaling.machine import Machine, measure_machine
from benchmarks.scaling.visits import LISTED, LOCATED, TETRAHEDRON, floor_of
from fracture_collision.core.compiled import threaded_kernel
from fracture_collision.core.moments import add_row, tetrahedron_terms
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld
from fracture_collision.world.inspection import EVERY_CONTACT

# As `python -m benchmarks.peers --csv` leaves it: the aims are ratios to its times.
PEERS = Path(__file__).resolve().parents[2] / "docs" / "peers.csv"
TIGHT, LOOSE = OURS, "ours, epsilon 5 % R"  # settings
UPDATE, FIRST = "update", "update and first query"
COLUMNS = {UPDATE: ("update",), FIRST: ("update", "first_query")}  # of peers.csv; of queries: jitter_query
LOOSE_TOLERANCE = 0.05
COLD = 64 << 20  # [bytes] walked through between two passes, more than a core's caches hold
TRIALS = 9
LOOKS, PAUSE = 16, 0.5  # [s] between two looks at what the machine can


class Aim(NamedTuple):
    """`what` of one world is to take no longer than `times` what `peer` takes."""

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
    times: float  # that the peer's time may be taken
    aim: float  # by peers.csv
    least: float
    # of a query: what its contacts take with nobody looking for them (contacts_alone.py), after an update's least;
    alone: float  # of an update nan
    ours: float  # by peers.csv
    ours_over_least: float
    rests_on: str  # what `least` has to do


def measure_limits(
    aims: Sequence[Aim] = AIMS, peers: Path = PEERS, progress: Progress = silent
) -> list[LimitRow]:
    """Raises FileNotFoundError without peers.csv, KeyError where it lacks a world or method."""
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
    """Of each the least and the contacts alone [ms], and words."""
    found = {
        what: _least_query(world, 0.0 if what == TIGHT else LOOSE_TOLERANCE)
        for what in (TIGHT, LOOSE)
        if what in whats or (what == TIGHT and FIRST in whats)
    }
    if whats & COLUMNS.keys():
        least, words = _least_update(world)
        found[UPDATE] = least, math.nan, words
    if FIRST in whats:
        least = found[UPDATE][0]
        found[FIRST] = least + found[TIGHT][0], least + found[TIGHT][1], "both of these"
    return found


def _least_query(world: World, tolerance: float) -> tuple[float, float, str]:
    """[ms] of a jittered frame, of its contacts alone, and words. `tolerance`: 0: the service's default.

    Contacts have to be located and listed. In a pair that has fewer than it wants, no sample of the crack that the two
    share is left out unseen: in place it touches, so only where it is now says that it no longer does.
    """
    settings = SEARCHED._replace(penetration_tolerance=tolerance) if tolerance else SEARCHED
    everything = SEARCHED._replace(contacts_per_pair=EVERY_CONTACT)
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
    machine = _undisturbed(TETRAHEDRON * len(world.body.tetrahedra) // 4)
    listed, apart = (floor_of(work, machine).in_turn for work in (LISTED, LOCATED))
    mean_listed, mean_apart = float(np.mean(contacts)), float(np.mean(located))
    words = f"{mean_listed:.0f} contacts at {listed:.0f} ns, {mean_apart:.0f} other samples of cracks at {apart:.0f} ns"
    return 1e-6 * (mean_listed * listed + mean_apart * apart), float(np.mean(alone)), words


@cache
def _undisturbed(footprint: int) -> Machine:
    """What the machine can, not what it was left to do: whoever else uses the common cache makes a load five times as
    slow, for seconds on end.
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


def _least_update(world: World) -> tuple[float, str]:
    """[ms] of a fracture, and words: its bytes hashed, its cut edges found among the mesh's and its labels' pieces
    counted (else it could not be refused), its planes put to the ends of their edges, each tetrahedron of what breaks
    read once and its moments added to a mass (of one that is cut: two, from the moments of one corner), for each node
    of the new trees one distance (its radius holds what is below it), the rows that all this leaves written. Left out:
    all other checks, who owns what in a cut tetrahedron, corners of triangles, cells, the way of a node into its tree.
    """
    service = CollisionWorld(SEARCHED)
    service.add_body(world.body)
    service.contacts(empty_states(0))
    event = world.event
    before = {name: len(rows) for name, rows in _columns(service)}
    service.add_fracture(event)
    service.contacts(empty_states(1))
    left = {name: rows[before[name] :] for name, rows in _columns(service)}
    mesh = service._registry.geometry.pools.mesh
    ends = event.cut_edges.reshape(-1, 2).astype(np.int64)
    planes = np.ascontiguousarray(event.cut_planes.reshape(-1, 4))
    shares = np.full(len(mesh.edges), -1.0)
    table = _edge_table(mesh.edges, len(mesh.nodes))
    cut, crossings = np.empty(len(ends), np.int64), np.empty(len(ends))
    spheres, roots = left["tree.spheres"], np.empty(len(mesh.nodes), np.int32)
    parts = np.zeros(len(mesh.nodes), np.int64)
    parts[event.nodes] = event.node_fragments
    sums = np.zeros((len(event.new_fragment_ids), mesh.moments.shape[1]))
    points, corners = np.unique(left["body.triangles"].reshape(-1, 3), axis=0, return_inverse=True)
    corners = corners.reshape(-1, 3)
    given = {plane.tobytes() for plane in np.vstack((planes, -planes))}
    bent = np.array([face.tobytes() not in given for face in left["body.faces"]])
    faces = np.empty_like(left["body.faces"])
    arrays = [np.ascontiguousarray(value) for value in event if isinstance(value, np.ndarray)]

    def find() -> None:
        _find_edges(ends, *table, cut)

    def put() -> None:
        _shares(ends, planes, mesh.nodes, crossings)
        shares[cut] = crossings

    passes: tuple[Callable[[], object], ...] = (
        lambda: [hashlib.sha256(array).digest() for array in arrays],
        lambda: (find(), _pieces(mesh.edges, parts, roots)),
        put,
        lambda: _sums(mesh.tetrahedra, mesh.tetrahedron_edges, mesh.moments, mesh.nodes, shares, parts, sums),
        lambda: _radii(spheres),
        lambda: _planes(points, corners, bent, faces),
        lambda: [array.copy() for array in left.values()],
    )
    find()
    put()
    whole = int(_sums(mesh.tetrahedra, mesh.tetrahedron_edges, mesh.moments, mesh.nodes, shares, parts, sums))
    times = [_cold_median(one) for one in passes]
    megabytes = 1e-6 * sum(array.nbytes for array in left.values())
    words = (
        f"{1e-6 * sum(a.nbytes for a in arrays):.2f} MB hashed in {times[0]:.2f}, edges and pieces checked in"
        f" {times[1]:.2f}, {len(ends)} planes put in {times[2]:.2f}, {len(mesh.tetrahedra)} tetrahedra,"
        f" {len(mesh.tetrahedra) - whole} of them cut, weighed in {times[3]:.2f}, radii of {len(spheres)} tree nodes in"
        f" {times[4]:.2f}, {len(corners)} triangles, {np.count_nonzero(bent)} of them in planes of their own, in"
        f" {times[5]:.2f}, {megabytes:.1f} MB written in {times[6]:.2f}"
    )
    return sum(times), words


def _columns(service: CollisionWorld) -> Iterator[tuple[str, np.ndarray]]:
    """All columns of its pools."""
    for pool, rows in service._registry.geometry.pools._asdict().items():
        if isinstance(rows, np.ndarray):
            yield pool, rows
        elif isinstance(rows, tuple):
            for name, column in rows._asdict().items():
                yield f"{pool}.{name}", column


def _cold_median(once: Callable[[], object]) -> float:
    """[ms]"""
    other = np.zeros(COLD, np.uint8)
    times = []
    for _ in range(TRIALS):
        other += 1
        began = perf_counter()
        once()
        times.append(perf_counter() - began)
    return 1e3 * median(times)


def _edge_table(edges: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges by their smaller end: first row of each node (nodes + 1,), the larger ends, rows of `edges`."""
    small, large = edges.min(axis=1), edges.max(axis=1)
    order = np.argsort(small, kind="stable")
    return np.searchsorted(small[order], np.arange(nodes + 1)), large[order], order


@threaded_kernel
def _find_edges(ends, begin, larger, rows, found):
    for i in range(len(ends)):
        a, b = min(ends[i, 0], ends[i, 1]), max(ends[i, 0], ends[i, 1])
        for k in range(begin[a], begin[a + 1]):
            if larger[k] == b:
                found[i] = rows[k]
                break
    return 0.0


@threaded_kernel
def _pieces(edges, parts, roots):
    """How many connected pieces the labels `parts` leave of a mesh's nodes."""
    pieces = len(roots)
    for i in range(len(roots)):
        roots[i] = i
    for k in range(len(edges)):
        a, b = edges[k, 0], edges[k, 1]
        if parts[a] != parts[b]:
            continue
        while roots[a] != a:
            roots[a] = roots[roots[a]]
            a = roots[a]
        while roots[b] != b:
            roots[b] = roots[roots[b]]
            b = roots[b]
        if a != b:
            roots[max(a, b)] = min(a, b)
            pieces -= 1
    return pieces


@threaded_kernel
def _radii(spheres):
    """Largest of one distance a tree node."""
    largest = 0.0
    for i in range(1, len(spheres)):
        p, q = spheres[i], spheres[i // 2]
        dx, dy, dz = p[0] - q[0], p[1] - q[1], p[2] - q[2]
        largest = max(largest, math.sqrt(dx * dx + dy * dy + dz * dz))
    return largest


@threaded_kernel
def _planes(points, corners, bent, faces):
    """Of triangles whose corners are rows of `points`: of those that are `bent` unit normal and offset."""
    total = 0.0
    for i in range(len(corners)):
        a, b, c = points[corners[i, 0]], points[corners[i, 1]], points[corners[i, 2]]
        total += a[0] + b[1] + c[2]
        if not bent[i]:
            continue
        ux, uy, uz, vx, vy, vz = b[0] - a[0], b[1] - a[1], b[2] - a[2], c[0] - a[0], c[1] - a[1], c[2] - a[2]
        x, y, z = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        share = 1.0 / math.sqrt(max(x * x + y * y + z * z, 1e-300))
        x, y, z = share * x, share * y, share * z
        faces[i, 0], faces[i, 1], faces[i, 2], faces[i, 3] = x, y, z, x * a[0] + y * a[1] + z * a[2]
    return total


@threaded_kernel
def _shares(ends, planes, nodes, shares):
    for i in range(len(ends)):
        a, b, p = nodes[ends[i, 0]], nodes[ends[i, 1]], planes[i]
        before = p[0] * a[0] + p[1] * a[1] + p[2] * a[2] - p[3]
        behind = p[0] * b[0] + p[1] * b[1] + p[2] * b[2] - p[3]
        shares[i] = before / (before - behind)
    return 0.0


@threaded_kernel
def _sums(tetrahedra, edges, moments, nodes, shares, parts, sums):
    """Moments: of a tetrahedron that one fragment has alone those it has; of one that is cut, those of the corner that
    its first cut edges leave, and of the rest what remains. Returns how many are whole.
    """
    whole = 0
    for t in range(len(tetrahedra)):
        v = tetrahedra[t]
        cut = 0
        for k in range(6):
            if shares[edges[t, k]] >= 0.0:
                cut += 1
        row = sums[parts[v[0]]]
        if cut == 0:
            whole += 1
            for d in range(10):
                row[d] += moments[t, d]
            continue
        o, a, b, c = nodes[v[0]], nodes[v[1]], nodes[v[2]], nodes[v[3]]
        p, q, r = abs(shares[edges[t, 0]]), abs(shares[edges[t, 1]]), abs(shares[edges[t, 2]])
        m = tetrahedron_terms(
            o[0], o[1], o[2],
            o[0] + p * (a[0] - o[0]), o[1] + p * (a[1] - o[1]), o[2] + p * (a[2] - o[2]),
            o[0] + q * (b[0] - o[0]), o[1] + q * (b[1] - o[1]), o[2] + q * (b[2] - o[2]),
            o[0] + r * (c[0] - o[0]), o[1] + r * (c[1] - o[1]), o[2] + r * (c[2] - o[2]),
        )  # fmt: skip
        rest = sums[parts[v[3]]]
        w = moments[t]
        add_row(row, m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
        add_row(
            rest, w[0] - m[0], w[1] - m[1], w[2] - m[2], w[3] - m[3], w[4] - m[4], w[5] - m[5], w[6] - m[6],
            w[7] - m[7], w[8] - m[8], w[9] - m[9],
        )  # fmt: skip
    return float(whole)

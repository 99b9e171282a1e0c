"""Lower bound for an update at a fracture on this machine, and our time for what every answer depends on."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from statistics import median
from time import perf_counter
from types import ModuleType
from unittest.mock import patch

import numpy as np

from benchmarks.peers.worlds import World, empty_states
from benchmarks.scaling.growth import ONE_THREAD
from fracture_collision.core.bodies import collision_geometry
from fracture_collision.core.memory.compiled import threaded_kernel
from fracture_collision.core.memory.pools import LEAF
from fracture_collision.core.mesh.moments import add_row, tetrahedron_terms
from fracture_collision.world import CollisionWorld

COLD = 64 << 20  # [bytes] traversed between two passes, more than a core's caches hold
TRIALS = 9
# Polygons and masses of the cut tetrahedra, corners of their hulls, and the fragments' samples with their leaves: the
# input of a query.
OUTPUTS = ((collision_geometry, "rebuild_surfaces"), (collision_geometry, "deal_samples"))


def least_update(world: World) -> tuple[float, str]:
    """[ms] of a fracture, and a description.

    Hashes the event's bytes; finds its cut edges among the mesh's and counts the pieces of its labels (needed to reject
    an event); evaluates its planes at the ends of their edges; reads each tetrahedron of what breaks once and adds its
    moments to a mass (a cut one: to two, from the moments of one corner); computes the boxes of the new leaves, and the
    planes of triangles that lie in no given plane; writes all resulting rows. Left out: all other checks, ownership in
    cut tetrahedra, corners of triangles, cells, ridges, a sample's way into its leaf.
    """
    service = CollisionWorld(ONE_THREAD)
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
    samples, roots = left["samples.points"], np.empty(len(mesh.nodes), np.int32)
    parts = np.zeros(len(mesh.nodes), np.int64)
    parts[event.nodes] = event.node_fragments
    sums = np.zeros((len(event.new_fragment_ids), mesh.moments.shape[1]))
    places = mesh.nodes - mesh.grid_origin  # as the moments have them
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
        lambda: _sums(mesh.tetrahedra, mesh.tetrahedron_edges, mesh.moments, places, shares, parts, sums),
        lambda: _boxes(samples),
        lambda: _planes(points, corners, bent, faces),
        lambda: [array.copy() for array in left.values()],
    )
    find()
    put()
    whole = int(_sums(mesh.tetrahedra, mesh.tetrahedron_edges, mesh.moments, places, shares, parts, sums))
    times = [_cold_median(one) for one in passes]
    megabytes = 1e-6 * sum(array.nbytes for array in left.values())
    words = (
        f"{1e-6 * sum(a.nbytes for a in arrays):.2f} MB hashed in {times[0]:.2f}, edges and pieces checked in"
        f" {times[1]:.2f}, {len(ends)} planes put in {times[2]:.2f}, {len(mesh.tetrahedra)} tetrahedra,"
        f" {len(mesh.tetrahedra) - whole} of them cut, weighed in {times[3]:.2f}, boxes of {len(samples)} samples in"
        f" {times[4]:.2f}, {len(corners)} triangles, {np.count_nonzero(bent)} of them in planes of their own, in"
        f" {times[5]:.2f}, {megabytes:.1f} MB written in {times[6]:.2f}"
    )
    return sum(times), words


def update_alone(world: World) -> float:
    """[ms], one thread, median, within real updates: our time for `OUTPUTS`.

    Excludes checks and hashes, the search for touched tetrahedra, cells and seeds.
    """
    sums = []
    for _ in range(TRIALS + 1):
        service = CollisionWorld(ONE_THREAD)
        service.add_body(world.body)
        service.contacts(empty_states(0))
        service.add_fracture(world.event)
        with _timed(OUTPUTS) as seconds:
            service.contacts(empty_states(1))
        assert len(seconds) == len(OUTPUTS)
        sums.append(sum(seconds))
    return 1e3 * median(sums[1:])


@contextmanager
def _timed(functions: Iterable[tuple[ModuleType, str]]) -> Iterator[list[float]]:
    """[s] of each call of these functions, patched in their modules."""
    seconds: list[float] = []

    def watched(call: Callable) -> Callable:
        def timed(*values: object) -> object:
            began = perf_counter()
            answer = call(*values)
            seconds.append(perf_counter() - began)
            return answer

        return timed

    with ExitStack() as stack:
        for module, name in functions:
            stack.enter_context(patch.object(module, name, watched(getattr(module, name))))
        yield seconds


def _columns(service: CollisionWorld) -> Iterator[tuple[str, np.ndarray]]:
    """All columns of the service's pools."""
    pools = service._registry.geometry.pools
    yield "occupancy", pools.occupancy
    for pool in ("mesh", "body", "fragment", "samples", "triangles", "seeds"):
        for name, column in vars(getattr(pools, pool)).items():
            if not name.startswith("_"):
                yield f"{pool}.{name}", column


def _cold_median(once: Callable[[], object]) -> float:
    """Median time [ms]."""
    other = np.zeros(COLD, np.uint8)
    times = []
    for _ in range(TRIALS):
        other += 1
        began = perf_counter()
        once()
        times.append(perf_counter() - began)
    return 1e3 * median(times)


def _edge_table(edges: np.ndarray, nodes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Edges by their smaller node: first row of each node (nodes + 1,), the larger nodes, rows of `edges`."""
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
    """Number of connected pieces of a mesh's nodes under the labels `parts`."""
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
def _boxes(samples):
    """Sum of the sides of the boxes of as many samples each as a leaf has."""
    total = 0.0
    for first in range(0, len(samples), LEAF):
        for d in range(3):
            low = high = samples[first, d]
            for i in range(first, min(first + LEAF, len(samples))):
                low, high = min(low, samples[i, d]), max(high, samples[i, d])
            total += high - low
    return total


@threaded_kernel
def _planes(points, corners, bent, faces):
    """Unit normals and offsets of the `bent` triangles; the corners of all are rows of `points`."""
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
    """Adds all moments to the masses of fragments; returns the number of uncut tetrahedra.

    An uncut tetrahedron adds its own to its fragment; a cut one adds those of the corner cut off by its first edges,
    and the remainder to the other fragment.
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
            o,
            (o[0] + p * (a[0] - o[0]), o[1] + p * (a[1] - o[1]), o[2] + p * (a[2] - o[2])),
            (o[0] + q * (b[0] - o[0]), o[1] + q * (b[1] - o[1]), o[2] + q * (b[2] - o[2])),
            (o[0] + r * (c[0] - o[0]), o[1] + r * (c[1] - o[1]), o[2] + r * (c[2] - o[2])),
            (0.0, 0.0, 0.0),
        )
        rest = sums[parts[v[3]]]
        w = moments[t]
        add_row(row, m[0], m[1], m[2], m[3], m[4], m[5], m[6], m[7], m[8], m[9])
        add_row(
            rest, w[0] - m[0], w[1] - m[1], w[2] - m[2], w[3] - m[3], w[4] - m[4], w[5] - m[5], w[6] - m[6],
            w[7] - m[7], w[8] - m[8], w[9] - m[9],
        )  # fmt: skip
    return float(whole)

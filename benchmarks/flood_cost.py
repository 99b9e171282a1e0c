"""What an exact depth costs by the depth of the point, and whether a start from a nodal field pays: two minutes.

    python benchmarks/flood_cost.py

Prints the tables of docs/numerics.md, 'What a flood costs', and writes docs/flood_cost.png. The service's kernel counts
nothing; the counts are those of a plain twin of it, whose distances must be the kernel's.
"""

from __future__ import annotations

import heapq
import math
import sys
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import matplotlib
import numpy as np
from numba import njit

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # broken bodies live with the tests
matplotlib.use("Agg")

from fractured_worlds import SETTINGS, FracturedWorld, fractured_world  # noqa: E402
from matplotlib import pyplot as plt  # noqa: E402

from fracture_collision.core.averaged_field import averaged_penetration  # noqa: E402
from fracture_collision.core.closest_point import closest_on_triangle  # noqa: E402
from fracture_collision.core.cut_tetrahedron import FACE_VERTICES, INTERFACE  # noqa: E402
from fracture_collision.core.flood import least_distance_squared, nearest_from_inside  # noqa: E402
from fracture_collision.core.point_location import holds_fragment, owner_in_tetrahedron, tetrahedron_at  # noqa: E402
from fracture_collision.core.pools import CUT, Pools  # noqa: E402
from fracture_collision.core.scratch import Scratch, make_scratch  # noqa: E402
from fracture_collision.geometry.generators import ball  # noqa: E402
from fracture_collision.geometry.stored_meshes import bunny  # noqa: E402
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes  # noqa: E402

# Half the longest side, R, is 1 m for both.
BODIES = {"ball": ball(1.0, 0.1), "bunny": bunny(2.0)}
SEEDS, GENERATIONS = 4, 2
DEPTHS = (0.0, 0.005, 0.02, 0.05, 0.15, 1.0)  # of R
POINTS, PER_BIN, FEWEST = 150_000, 1000, 100
REPEATS = 7
STARTS = ("nothing", "fronts", "exact nodes", "the answer")
LEGEND = """
tets: taken from the queue, their surface measured; seen: these and their neighbours, whose boxes are measured;
triangles: measured, the others being known to be farther by their planes. The first of each is that of a flood which
starts from nothing; after it triangles and nanoseconds (the tetrahedron of the point being known) of one that starts
with an upper bound: from the points that the averaged field's fronts hand on, the best of the four nodes'; from the
exact nearest points of the four nodes; from the answer itself, the best any start could do. Time includes making the
bound from the nodes. averaged: ns of eq. 1-2 at the same points.
"""

# Not cached: a cache in this folder would outlive a change of the kernels that these inline.
compiled = njit(error_model="numpy")


class Places(NamedTuple):
    """Points inside fragments and all a flood needs to start."""

    points: np.ndarray  # (n, 3) [m]
    rows: np.ndarray  # (n,) fragment row of the owner
    tets: np.ndarray  # (n,) tetrahedron that holds each

    def take(self, which: np.ndarray) -> Places:
        return Places(*(column[which] for column in self))


class Cost(NamedTuple):
    """Means over the points of one bin; a start each, see STARTS."""

    depth: float  # of R, the mean
    points: int
    tets: float
    seen: float
    triangles: tuple[float, ...]
    nanoseconds: tuple[float, ...]
    averaged: float  # [ns]


@compiled
def place(pools, fragment, points, scratch, tets, rows):
    for i in range(len(points)):
        x, y, z = points[i]
        tets[i] = tetrahedron_at(pools.mesh, pools.fragment.mesh[fragment], x, y, z)
        if tets[i] >= 0:
            rows[i] = owner_in_tetrahedron(pools, fragment, tets[i], x, y, z, scratch, 0)


@compiled
def flood(pools, rows, tets, points, limits, scratch, depths):
    for i in range(len(points)):
        x, y, z = points[i]
        depths[i] = math.sqrt(nearest_from_inside(pools, rows[i], tets[i], x, y, z, limits[i], scratch, 0)[0])


@compiled
def average(pools, rows, tets, points, depths):
    for i in range(len(points)):
        depths[i] = averaged_penetration(pools, rows[i], tets[i], points[i, 0], points[i, 1], points[i, 2])[0]


@compiled
def bound_by_nodes(pools, rows, tets, points, certain, limits):
    """Distance to the nearest of the points `certain` of the tetrahedron's nodes, a little more for rounding."""
    for i in range(len(points)):
        shift = pools.fragment.node_shift[rows[i]]
        best = math.inf
        for k in range(4):
            row = pools.mesh.tetrahedra[tets[i], k] + shift
            if pools.body.node_fragment[row] == rows[i]:
                c, x = certain[row], points[i]
                best = min(best, (c[0] - x[0]) ** 2 + (c[1] - x[1]) ** 2 + (c[2] - x[2]) ** 2)
        limits[i] = math.sqrt(best) * (1.0 + 1e-9) + 1e-12


@compiled
def measure_nodes(pools, shift, scratch, nearest):
    """The exact nearest surface point of every node of a world's one body; returns how many took a flood."""
    floods = 0
    for v in range(len(pools.mesh.nodes)):
        x, y, z = pools.mesh.nodes[v]
        row = v + shift
        nearest[row, 0], nearest[row, 1], nearest[row, 2] = x, y, z
        if not pools.mesh.on_surface[v]:
            t = pools.mesh.node_tets[pools.mesh.node_tets_begin[v]]
            best = nearest_from_inside(pools, pools.body.node_fragment[row], t, x, y, z, math.inf, scratch, 0)
            nearest[row, 0], nearest[row, 1], nearest[row, 2] = best[1], best[2], best[3]
            floods += 1
    return floods


@compiled
def counted_flood(pools, f, start, x, y, z, limit):
    """The flood again, plainly: (distance [m], tetrahedra taken, seen, triangles measured)."""
    mesh, body = pools.mesh, pools.body
    shift = pools.fragment.tet_shift[f]
    seen = np.zeros(len(mesh.tetrahedra), np.bool_)
    seen[start] = True
    queue = [(0.0, start)]
    best = limit * limit
    taken, looked_at, measured = 0, 1, 0
    while len(queue) and queue[0][0] < best:
        t = heapq.heappop(queue)[1]
        taken += 1
        near = np.empty(4, np.bool_)
        for face in range(4):
            near[face] = _height_squared(mesh, t, face, x, y, z) <= best
        if body.tet_fragment[t + shift] != CUT:
            for face in range(4):
                if mesh.neighbours[t, face] < 0 and _height_squared(mesh, t, face, x, y, z) <= best:
                    c = mesh.nodes[mesh.tetrahedra[t][FACE_VERTICES[face]]].ravel()
                    best = min(best, _to_triangle(x, y, z, c))
                    measured += 1
        for i in range(body.cut_begin[t + shift], body.cut_begin[t + shift] + body.cut_count[t + shift]):
            if body.front[i] != f and (body.kind[i] != INTERFACE or body.back[i] != f):
                continue
            if body.kind[i] != INTERFACE and not near[body.kind[i]]:
                continue
            p = body.faces[i]
            if (p[0] * x + p[1] * y + p[2] * z - p[3]) ** 2 <= best:
                best = min(best, _to_triangle(x, y, z, body.triangles[i]))
                measured += 1
        for face in range(4):
            n = mesh.neighbours[t, face]
            if n >= 0 and not seen[n]:
                seen[n] = True
                looked_at += 1
                if holds_fragment(pools, f, n):
                    key = least_distance_squared(mesh, n, x, y, z)
                    if key < best:
                        heapq.heappush(queue, (key, np.int64(n)))
    return math.sqrt(best), taken, looked_at, measured


@compiled
def _height_squared(mesh, t, face, x, y, z):
    """Of a point over the plane of a tetrahedron's face [m2]."""
    a, b, c = mesh.nodes[mesh.tetrahedra[t][FACE_VERTICES[face]]]
    normal = np.cross(b - a, c - a)
    height = (x - a[0]) * normal[0] + (y - a[1]) * normal[1] + (z - a[2]) * normal[2]
    return height * height / (normal[0] ** 2 + normal[1] ** 2 + normal[2] ** 2)


@compiled
def _to_triangle(x, y, z, c):
    return closest_on_triangle(x, y, z, c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7], c[8])[0]


@compiled
def count(pools, rows, tets, points, limits, counts):
    for i in range(len(points)):
        x, y, z = points[i]
        counts[i, 0], counts[i, 1], counts[i, 2], counts[i, 3] = counted_flood(
            pools, rows[i], tets[i], x, y, z, limits[i]
        )


def main() -> None:
    costs: dict[tuple[str, str], list[Cost]] = {}
    for name, body in BODIES.items():
        for cracks in ("flat", "curved"):
            settings = SETTINGS._replace(field="averaged")
            case = fractured_world(body, SEEDS, GENERATIONS, cracks == "curved", settings)
            print(f"{name}, {len(body.vertices)} nodes, {cracks} cracks, {len(case.oracle.fragment_ids)} fragments")
            costs[name, cracks] = measure(case)
            print(flush=True)
    print(LEGEND)
    draw(costs)


def measure(case: FracturedWorld) -> list[Cost]:
    pools = case.geometry.pools
    scratch = make_scratch(1, len(pools.mesh.tetrahedra), 8)
    places = inside(case, scratch)
    shift = int(pools.fragment.node_shift[case.row(case.oracle.fragment_ids[0])])
    exact = np.zeros((len(pools.body.node_field), 3))
    measure_nodes(pools, shift, scratch, exact)
    started = perf_counter()
    floods = measure_nodes(pools, shift, scratch, exact)
    seconds = perf_counter() - started
    certain = (np.ascontiguousarray(pools.body.node_field[:, 4:]), exact)
    depths = np.empty(len(places.points))
    flood(pools, places.rows, places.tets, places.points, np.full(len(depths), np.inf), scratch, depths)
    print(f"{'depth % R':>12}{'points':>8}{'tets':>7}{'seen':>7}" + "".join(f"{s:>13}" for s in STARTS), end="")
    print("".join(f"{s:>13}" for s in STARTS) + f"{'averaged':>10}")
    costs = []
    for low, high in zip(DEPTHS[:-1], DEPTHS[1:], strict=True):
        chosen = np.flatnonzero((depths >= low) & (depths < high))[:PER_BIN]
        if len(chosen) < FEWEST:
            continue
        costs.append(cost_of(pools, places.take(chosen), depths[chosen], certain, scratch))
        print(f"{100 * low:6.1f}-{100 * high:5.1f}{_line(costs[-1])}", flush=True)
    print(f"exact nearest points of the {floods} interior nodes: {1e6 * seconds / floods:.1f} us a node")
    return costs


def inside(case: FracturedWorld, scratch: Scratch) -> Places:
    random = np.random.default_rng(4)
    nodes, tetrahedra = case.oracle.vertices, case.oracle.tetrahedra
    volumes = tetrahedron_volumes(nodes, tetrahedra)
    corners = nodes[tetrahedra[random.choice(len(volumes), POINTS, p=volumes / volumes.sum())]]
    points = np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), POINTS))
    tets, rows = np.empty(POINTS, np.int64), np.zeros(POINTS, np.int64)
    place(case.geometry.pools, case.row(case.oracle.fragment_ids[0]), points, scratch, tets, rows)
    return Places(points, rows, tets).take(tets >= 0)


def cost_of(
    pools: Pools, places: Places, depths: np.ndarray, certain: tuple[np.ndarray, ...], scratch: Scratch
) -> Cost:
    asked = (places.rows, places.tets, places.points)
    answer, limits = np.empty(len(depths)), np.empty(len(depths))
    all_counts, times = [], []
    for start in range(len(STARTS)):
        making = 0.0
        if STARTS[start] == "nothing":
            limits[:] = np.inf
        elif STARTS[start] == "the answer":
            limits[:] = depths * (1.0 + 1e-9) + 1e-12
        else:
            making = _nanoseconds(bound_by_nodes, pools, *asked, certain[start - 1], limits)
            assert (limits >= depths).all()
        times.append(making + _nanoseconds(flood, pools, *asked, limits, scratch, answer))
        assert np.array_equal(answer, depths)
        counts = np.empty((len(depths), 4))
        count(pools, *asked, limits, counts)
        assert np.abs(counts[:, 0] - depths).max() <= 1e-12, "the twin is no twin any more"
        all_counts.append(counts.mean(axis=0))
    _, tets, seen, _ = all_counts[0]
    averaged = _nanoseconds(average, pools, *asked, answer)
    triangles = tuple(float(c[3]) for c in all_counts)
    return Cost(float(depths.mean()), len(depths), tets, seen, triangles, tuple(times), averaged)


def _nanoseconds(function, pools: Pools, rows: np.ndarray, *arguments) -> float:
    """[ns] a point, the best of some runs."""
    best = math.inf
    function(pools, rows, *arguments)
    for _ in range(REPEATS):
        started = perf_counter()
        function(pools, rows, *arguments)
        best = min(best, perf_counter() - started)
    return 1e9 * best / len(rows)


def _line(cost: Cost) -> str:
    return (
        f"{cost.points:8d}{cost.tets:7.1f}{cost.seen:7.1f}" + "".join(f"{t:13.1f}" for t in cost.triangles)
        + "".join(f"{t:13.0f}" for t in cost.nanoseconds) + f"{cost.averaged:10.0f}"
    )  # fmt: skip


def draw(costs: dict[tuple[str, str], list[Cost]]) -> None:
    figure, (work, time) = plt.subplots(1, 2, figsize=(10, 4))
    for (name, cracks), its in costs.items():
        depth = [100.0 * cost.depth for cost in its]
        style, color = ("-" if cracks == "flat" else ":"), ("tab:blue" if name == "ball" else "tab:red")
        work.loglog(depth, [c.tets for c in its], style, marker="o", color=color, label=f"{name}, {cracks}: tetrahedra")
        triangles = [c.triangles[0] for c in its]
        work.loglog(depth, triangles, style, marker="^", color=color, label=f"{name}, {cracks}: triangles")
        for k, marker in ((0, "o"), (2, "x"), (3, "+")):
            microseconds = [1e-3 * c.nanoseconds[k] for c in its]
            time.loglog(depth, microseconds, style, marker=marker, color=color, label=f"{name}, {cracks}: {STARTS[k]}")
    work.set(xlabel="depth [% R]", ylabel="taken, measured", title="What a flood does")
    time.set(xlabel="depth [% R]", ylabel="microseconds", title="What it takes, by what it starts from")
    for axes in (work, time):
        axes.legend(fontsize=6)
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "flood_cost.png", dpi=80)


if __name__ == "__main__":
    main()

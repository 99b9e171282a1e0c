"""Cost of an exact depth by the depth of the point, and whether a warm start from a nodal field pays off: two minutes.

    python benchmarks/flood_cost.py

Prints the tables of docs/accuracy.md, 'Cost of a depth', and writes docs/flood_cost.png. The service's kernel has no
counters; the counts come from a plain twin, whose distances must equal the kernel's.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from time import thread_time
from typing import NamedTuple

import matplotlib
import numpy as np
from numba import njit

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # broken bodies live with the tests
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402
from worlds.fractured_worlds import FracturedWorld, fractured_world  # noqa: E402

from benchmarks.counted_flood import count_floods  # noqa: E402
from fracture_collision.core.field.flood import (  # noqa: E402
    EVERYTHING,
    least_distance_squared,
    may_leave_over,
    nearest_from_inside,
    nearest_in_tetrahedron,
    next_stamp,
    nothing_within,
)
from fracture_collision.core.glondu2014.averaged_field import averaged_penetration  # noqa: E402
from fracture_collision.core.glondu2014.paper_pools import FieldPool  # noqa: E402
from fracture_collision.core.memory.pools import Pools  # noqa: E402
from fracture_collision.core.mesh.point_location import holds_fragment, owner_in_tetrahedron, tetrahedron_at  # noqa: E402
from fracture_collision.core.search.scratch import Scratch, make_scratch  # noqa: E402
from fracture_collision.geometry.generators import ball  # noqa: E402
from fracture_collision.geometry.stored_meshes import bunny  # noqa: E402
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes  # noqa: E402
from fracture_collision.world import Settings  # noqa: E402

# Half the longest side, R, is 1 m for both.
BODIES = {"ball": ball(1.0, 0.1), "bunny": bunny(2.0)}
SETTINGS = Settings(threads=1, method="glondu2014")  # keeps the averaged field; a flood needs nothing kept
SEEDS, GENERATIONS = 4, 2
DEPTHS = (0.0, 0.005, 0.02, 0.05, 0.15, 1.0)  # of R
POINTS, PER_BIN, FEWEST = 150_000, 1000, 100
REPEATS, SECONDS = 7, 1.0  # rounds of timing: at least this many, for at least this long
# Upper bounds of the depth that the service's flood, nearest tetrahedron first, may start with.
STARTS = ("nothing", "fronts", "exact nodes", "the answer")
# The other order, tetrahedra in rings as they are reached, and its starting bound.
RINGS = {"rings": "nothing", "rings, nodes": "exact nodes"}
LEGEND = """
tets: taken from the queue, their surface measured; seen: these and their neighbours, whose boxes are measured; tri:
triangles measured, the others being farther by their planes alone; ns: processor time a point, its tetrahedron known.
By what the flood starts with. nothing: as the service does; an upper bound of the depth from fronts: the points that
the averaged field's fronts hand on, the best of the four nodes'; from exact nodes: the exact nearest points of the four
nodes; the answer: the depth itself, better than any start could know. rings: tetrahedra in the order in which they are
reached instead of nearest first, from nothing, and with the exact nodes' bound; the first two such columns: how many
are taken. Time includes making the bound from the nodes. averaged: ns of eq. 1-2 at the same points.
"""

# Not cached: a cache in this folder would outlive changes to the kernels inlined here.
compiled = njit(error_model="numpy")


class Places(NamedTuple):
    """Points inside fragments, and all that a flood needs to start."""

    points: np.ndarray  # (n, 3) [m]
    rows: np.ndarray  # (n,) fragment row of the owner
    tets: np.ndarray  # (n,) tetrahedron that holds each point

    def take(self, which: np.ndarray) -> Places:
        return Places(*(column[which] for column in self))


class Cost(NamedTuple):
    """Means over the points of one bin."""

    depth: float  # of R
    points: int
    tets: float
    seen: float
    in_rings: dict[str, float]  # tetrahedra visited in that order, by RINGS
    triangles: dict[str, float]  # measured, by starting bound
    nanoseconds: dict[str, float]  # by starting bound
    averaged: float  # [ns]


@compiled
def place(pools, fragment, points, tets, rows):
    for i in range(len(points)):
        x, y, z = points[i]
        tets[i] = tetrahedron_at(pools.mesh, pools.fragment.mesh[fragment], x, y, z)
        if tets[i] >= 0:
            rows[i] = owner_in_tetrahedron(pools, fragment, tets[i], x, y, z)


@compiled
def flood(pools, rows, tets, points, limits, scratch, depths):
    for i in range(len(points)):
        x, y, z = points[i]
        best = nearest_from_inside(pools, rows[i], tets[i], (x, y, z), limits[i], EVERYTHING, scratch)
        depths[i] = math.sqrt(best[0])


@compiled
def rings(pools, rows, tets, points, limits, scratch, depths):
    """The flood without a heap: tetrahedra in the order in which they are reached. Returns the number visited.

    The result is equally exact: every tetrahedron nearer than the best distance so far is visited, in any order.
    """
    mesh, visited = pools.mesh, scratch.visited
    keys, items = scratch.heap_key, scratch.heap_tet
    taken = 0
    for i in range(len(points)):
        x, y, z = points[i]
        best = nothing_within(limits[i])
        stamp = next_stamp(scratch)
        keys[0], items[0], visited[tets[i]] = 0.0, tets[i], stamp
        first, behind = 0, 1
        while first < behind:
            t, key = items[first], keys[first]
            first += 1
            if key >= best[0]:
                continue
            taken += 1
            best = nearest_in_tetrahedron(pools, rows[i], t, x, y, z, EVERYTHING, best)
            for face in range(4):
                n = mesh.neighbours[t, face]
                if n >= 0 and visited[n] != stamp and may_leave_over(mesh, t, face, x, y, z, best[0]):
                    visited[n] = stamp
                    if holds_fragment(pools, rows[i], n):
                        key = least_distance_squared(mesh, n, x, y, z)
                        if key < best[0]:
                            keys[behind], items[behind] = key, n
                            behind += 1
        depths[i] = math.sqrt(best[0])
    return taken


@compiled
def average(pools, field, rows, tets, points, depths):
    for i in range(len(points)):
        x, y, z = points[i]
        depths[i] = averaged_penetration(pools, field, rows[i], tets[i], x, y, z)[0]


@compiled
def bound_by_nodes(pools, rows, tets, points, certain, limits):
    """Distance to the nearest of the points `certain` of the tetrahedron's nodes, plus a margin for rounding."""
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
    """The exact nearest surface point of every node of a world's only body; returns how many needed a flood."""
    floods = 0
    for v in range(len(pools.mesh.nodes)):
        x, y, z = pools.mesh.nodes[v]
        row = v + shift
        nearest[row, 0], nearest[row, 1], nearest[row, 2] = x, y, z
        if not pools.mesh.on_surface[v]:
            t = pools.mesh.node_tets[pools.mesh.node_tets_begin[v]]
            f = pools.body.node_fragment[row]
            best = nearest_from_inside(pools, f, t, (x, y, z), math.inf, EVERYTHING, scratch)
            nearest[row, 0], nearest[row, 1], nearest[row, 2] = best[1], best[2], best[3]
            floods += 1
    return floods


def main() -> None:
    costs: dict[tuple[str, str], list[Cost]] = {}
    for name, body in BODIES.items():
        for cracks in ("flat", "curved"):
            case = fractured_world(body, SEEDS, GENERATIONS, cracks == "curved", SETTINGS)
            print(f"{name}, {len(body.vertices)} nodes, {cracks} cracks, {len(case.oracle.fragment_ids)} fragments")
            costs[name, cracks] = measure(case)
            print(flush=True)
    print(LEGEND)
    draw(costs)


def measure(case: FracturedWorld) -> list[Cost]:
    pools, field = case.geometry.pools, case.geometry.paper.pools.field
    scratch = make_scratch(len(pools.mesh.tetrahedra), 8)
    places = inside(case)
    shift = int(pools.fragment.node_shift[case.row(case.oracle.fragment_ids[0])])
    exact = np.zeros((len(field.node_field), 3))
    measure_nodes(pools, shift, scratch, exact)
    started = thread_time()
    floods = measure_nodes(pools, shift, scratch, exact)
    seconds = thread_time() - started
    certain = {"fronts": np.ascontiguousarray(field.node_field[:, 4:]), "exact nodes": exact}
    depths = np.empty(len(places.points))
    flood(pools, places.rows, places.tets, places.points, np.full(len(depths), np.inf), scratch, depths)
    print("".join(f"{c:>17}" for c in COLUMNS))
    costs = []
    for low, high in zip(DEPTHS[:-1], DEPTHS[1:], strict=True):
        chosen = np.flatnonzero((depths >= low) & (depths < high))[:PER_BIN]
        if len(chosen) < FEWEST:
            continue
        costs.append(cost_of(pools, field, places.take(chosen), depths[chosen], certain, scratch))
        print(_line(low, high, costs[-1]), flush=True)
    print(f"exact nearest points of the {floods} interior nodes: {1e6 * seconds / floods:.1f} us a node")
    return costs


def inside(case: FracturedWorld) -> Places:
    random = np.random.default_rng(4)
    nodes, tetrahedra = case.oracle.vertices, case.oracle.tetrahedra
    volumes = tetrahedron_volumes(nodes, tetrahedra)
    corners = nodes[tetrahedra[random.choice(len(volumes), POINTS, p=volumes / volumes.sum())]]
    points = np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), POINTS))
    tets, rows = np.empty(POINTS, np.int64), np.zeros(POINTS, np.int64)
    place(case.geometry.pools, case.row(case.oracle.fragment_ids[0]), points, tets, rows)
    return Places(points, rows, tets).take(tets >= 0)


def cost_of(
    pools: Pools,
    field: FieldPool,
    places: Places,
    depths: np.ndarray,
    certain: dict[str, np.ndarray],
    scratch: Scratch,
) -> Cost:
    asked, n = (places.rows, places.tets, places.points), len(depths)
    limits = {"nothing": np.full(n, np.inf), "the answer": depths * (1.0 + 1e-9) + 1e-12}
    tasks = {}
    for start, points in certain.items():
        limits[start] = np.empty(n)
        tasks["bound", start] = (bound_by_nodes, (*asked, points, limits[start]))
        bound_by_nodes(pools, *asked, points, limits[start])
        assert (limits[start] >= depths).all()
    counts, taken = {}, {}
    for name in (*STARTS, *RINGS):
        start, search = RINGS.get(name, name), rings if name in RINGS else flood
        answer = np.empty(n)
        tasks["search", name] = (search, (*asked, limits[start], scratch, answer))
        total = search(pools, *asked, limits[start], scratch, answer)
        assert np.array_equal(answer, depths)
        if name in RINGS:
            taken[name] = total / n
            continue
        counts[name] = count_floods(pools, *asked, limits[name])
        assert np.abs(counts[name][:, 0] - depths).max() <= 1e-12, "the twin is no twin any more"
    tasks["averaged", ""] = (average, (field, *asked, np.empty(n)))
    times = _nanoseconds(pools, tasks, n)
    nanoseconds = {}
    for name in (*STARTS, *RINGS):
        nanoseconds[name] = times["search", name] + times.get(("bound", RINGS.get(name, name)), 0.0)
    _, tets, seen, _ = counts["nothing"].mean(axis=0)
    triangles = {start: float(its[:, 3].mean()) for start, its in counts.items()}
    return Cost(float(depths.mean()), n, tets, seen, taken, triangles, nanoseconds, times["averaged", ""])


def _nanoseconds(pools: Pools, tasks: dict[tuple[str, str], tuple], points: int) -> dict[tuple[str, str], float]:
    """[ns] of processor time per point: the best of many rounds, each of which runs all tasks in turn."""
    best = dict.fromkeys(tasks, math.inf)
    for function, arguments in tasks.values():
        function(pools, *arguments)
    rounds, first = 0, thread_time()
    while rounds < REPEATS or thread_time() - first < SECONDS:
        rounds += 1
        for task, (function, arguments) in tasks.items():
            started = thread_time()
            function(pools, *arguments)
            best[task] = min(best[task], 1e9 * (thread_time() - started) / points)
    return best


COLUMNS = (
    "depth % R", "points", "tets", "seen", *RINGS, *(f"tri: {s}" for s in STARTS),
    *(f"ns: {s}" for s in (*STARTS, *RINGS)), "averaged",
)  # fmt: skip


def _line(low: float, high: float, cost: Cost) -> str:
    counts = (cost.tets, cost.seen, *cost.in_rings.values(), *cost.triangles.values())
    times = (*cost.nanoseconds.values(), cost.averaged)
    cells = (f"{100 * low:g}-{100 * high:g}", cost.points, *(f"{c:.1f}" for c in counts), *(f"{t:.0f}" for t in times))
    return "".join(f"{cell:>17}" for cell in cells)


def draw(costs: dict[tuple[str, str], list[Cost]]) -> None:
    figure, (work, time, share) = plt.subplots(1, 3, figsize=(13, 4))
    for (name, cracks), its in costs.items():
        depth = [100.0 * cost.depth for cost in its]
        style, color = ("-" if cracks == "flat" else ":"), ("tab:blue" if name == "ball" else "tab:red")
        case = f"{name}, {cracks}"
        work.loglog(depth, [c.tets for c in its], style, marker="o", color=color, label=f"{case}: tetrahedra")
        triangles = [c.triangles["nothing"] for c in its]
        work.loglog(depth, triangles, style, marker="^", color=color, label=f"{case}: triangles")
        microseconds = [1e-3 * c.nanoseconds["nothing"] for c in its]
        time.loglog(depth, microseconds, style, marker="o", color=color, label=case)
    others = {"fronts": "y", "exact nodes": "tab:green", "the answer": "k", "rings": "m", "rings, nodes": "tab:orange"}
    for start, color in others.items():
        for number, its in enumerate(costs.values()):
            ratio = [c.nanoseconds[start] / c.nanoseconds["nothing"] for c in its]
            label = start if number == 0 else None
            share.semilogx([100.0 * c.depth for c in its], ratio, ".-", color=color, alpha=0.7, label=label)
    work.set(xlabel="depth [% R]", ylabel="taken, measured", title="What a flood does")
    time.set(xlabel="depth [% R]", ylabel="microseconds", title="What it takes, from nothing")
    share.set(xlabel="depth [% R]", ylabel="share of that", title="What it takes otherwise", ylim=(0.0, 1.5))
    for axes in (work, time, share):
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "flood_cost.png", dpi=80)


if __name__ == "__main__":
    main()

"""Errors of both fields against an independent library, and what an exact depth costs: about three minutes.

`python benchmarks/field_errors.py` prints the tables and writes docs/field_errors.csv and docs/field_errors.png. Truth:
libigl's distance from the closed surfaces that test/oracles builds. Lengths are in % of R.
"""

from __future__ import annotations

import csv
import math
import sys
from collections.abc import Iterator
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import igl
import matplotlib
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the oracles live with the tests
matplotlib.use("Agg")

from fractured_worlds import SETTINGS, FracturedWorld, fractured_world  # noqa: E402
from matplotlib import pyplot as plt  # noqa: E402
from oracles.fragmented_body import FragmentedBody  # noqa: E402
from scipy.interpolate import RegularGridInterpolator  # noqa: E402

from fracture_collision.core import interior_field  # noqa: E402
from fracture_collision.core.averaged_field import averaged_penetration  # noqa: E402
from fracture_collision.core.collision_geometry import CollisionGeometry, prepare_mesh  # noqa: E402
from fracture_collision.core.compiled import kernel  # noqa: E402
from fracture_collision.core.elementary_queries import bounded_probe, inside_tetrahedron  # noqa: E402
from fracture_collision.core.flood import nearest_from_inside  # noqa: E402
from fracture_collision.core.pools import AVERAGED, EXACT  # noqa: E402
from fracture_collision.core.scratch import make_scratch  # noqa: E402
from fracture_collision.core.tet_mesh import build_tet_mesh  # noqa: E402
from fracture_collision.geometry.generators import TetGeometry, ball, brick, plate, shell  # noqa: E402
from fracture_collision.world import CollisionWorld  # noqa: E402

AVERAGED_SETTINGS = SETTINGS._replace(field="averaged")
SEEDS, GENERATIONS, POINTS = 4, 5, 3000
NEAR, DEEP = 0.02, 0.10  # of R
INWARD = 0.01  # of R, the step that tries whether depth grows
WRONG_WAY = math.radians(30.0)
DEPTHS = (0.0, 0.005, 0.02, 0.05, 0.15, 0.25, 0.35, 0.5)  # of R
REPEATS = 5


class Asked(NamedTuple):
    """Points inside fragments, what a field says of them, and the truth. Lengths in parts of R."""

    depth: np.ndarray
    most: np.ndarray
    true: np.ndarray  # distance from the closed surface
    angle: np.ndarray  # [rad] of the direction off that to the nearest point
    grows: np.ndarray  # bool: deeper a little farther inward; points whose step stays inside only
    stays: np.ndarray  # bool


def ring(major: float, thickness: float, edge: float) -> TetGeometry:
    """A torus of square section [m]: a bar bent into a circle, its ends welded."""
    length = 2.0 * math.pi * major
    bar = brick((length, thickness, thickness), edge)
    x, y, z = bar.vertices.T
    first = {tuple(p): i for i, p in enumerate(np.round(bar.vertices, 9).tolist())}
    weld = np.arange(len(x))
    for i in np.flatnonzero(np.isclose(x, 0.5 * length)):
        weld[i] = first[tuple(np.round([-0.5 * length, y[i], z[i]], 9).tolist())]
    used, index = np.unique(weld, return_inverse=True)
    angle, r = x / major, major - y
    bent = np.column_stack([r * np.cos(angle), r * np.sin(angle), -z])
    tetrahedra = index[bar.tetrahedra].astype(np.int32)
    corners = bent[used][tetrahedra]
    turned = np.linalg.det(corners[:, 1:] - corners[:, :1]) < 0.0
    tetrahedra[turned] = tetrahedra[turned][:, [0, 1, 3, 2]]
    return TetGeometry(bent[used], tetrahedra)


BODIES = {
    "ball": ball(1.0, 0.25),
    "shell": shell(1.0, 0.6, 0.4),
    "plate": plate(2.0, 0.2, 0.25, 0.2),
    "ring": ring(0.75, 0.5, 0.17),
}


@kernel
def ask(pools, rows, points, scratch, out):
    for i in range(len(points)):
        x, y, z = points[i]
        status, d, nx, ny, nz, _, _, _, most = bounded_probe(pools, rows[i], x, y, z, 0.0, np.inf, scratch, 0)
        out[i, 0], out[i, 1], out[i, 2], out[i, 3], out[i, 4], out[i, 5] = status, -d, nx, ny, nz, most


@kernel
def find(pools, rows, points, scratch, tets):
    for i in range(len(points)):
        tets[i] = inside_tetrahedron(pools, rows[i], points[i, 0], points[i, 1], points[i, 2], scratch, 0)


@kernel
def flood(pools, rows, tets, points, from_nodes, count, scratch, reached):
    """Exact depths; `from_nodes`: the best starts from the nodes' certain points. `count`: tetrahedra looked at."""
    total = 0.0
    for i in range(len(points)):
        x, y, z = points[i]
        limit = np.inf
        if from_nodes:
            for k in range(4):
                row = pools.mesh.tetrahedra[tets[i], k] + pools.fragment.node_shift[rows[i]]
                if pools.body.node_fragment[row] == rows[i]:
                    s = pools.body.node_field[row]
                    limit = min(limit, (s[4] - x) ** 2 + (s[5] - y) ** 2 + (s[6] - z) ** 2)
            limit = math.sqrt(limit) * (1.0 + 1e-9) + 1e-12
        total += nearest_from_inside(pools, rows[i], tets[i], x, y, z, limit, scratch, 0)[0]
        if count:
            reached[i] = (scratch.visited[0] == scratch.stamp[0]).sum()
    return total


@kernel
def average(pools, rows, tets, points):
    total = 0.0
    for i in range(len(points)):
        total += averaged_penetration(pools, rows[i], tets[i], points[i, 0], points[i, 1], points[i, 2])[0]
    return total


def main() -> None:
    rows: list[dict] = []
    curves: dict[tuple[str, str], list[Asked]] = {}
    print(f"{SEEDS} seeds a fracture, {POINTS} points a row, lengths in % of R; near: true depth < 2, deep: > 10\n")
    columns = (
        "body", "cracks", "gen", "field", "mean", "99 %", "worst", "n mean", "n 99 %", "n worst", "d mean", "d 99 %",
        "d worst", "angle", "off 30", "n off 30", "shrinks", "slack", "most slack",
    )  # fmt: skip
    print("".join(f"{c:>10}" for c in columns))
    for name, body in BODIES.items():
        for cracks in ("flat", "curved"):
            for case in generations(body, cracks == "curved"):
                for field, asked in measure(case, 0.5 * np.ptp(body.vertices, axis=0).max()).items():
                    curves.setdefault((field, cracks), []).append(asked)
                    values = (name, cracks, case.generations, field, *figures(asked))
                    rows.append(dict(zip(columns, values, strict=True)))
                    print("".join(f"{_text(v):>10}" for v in rows[-1].values()), flush=True)
    print(LEGEND)
    costs = flood_costs()
    grid_errors()
    with (ROOT / "docs" / "field_errors.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows({k: _text(v) for k, v in row.items()} for row in rows)
    draw(rows, curves, costs)


LEGEND = """
n, d: near and deep points alone; angle: mean, degrees, of the direction off that to the nearest point; off 30: share of
points more than 30 degrees off; shrinks: share of points that do not get deeper 1 % R farther inward along the
direction (past the middle no field does); slack, most slack: the certain depth less the true one, mean and worst
"""


def generations(body: TetGeometry, curved: bool) -> Iterator[FracturedWorld]:
    """One body after each of its fractures; cells of the oracle that one leaves untouched serve the next."""
    messages = fractured_world(body, SEEDS, GENERATIONS, curved, AVERAGED_SETTINGS).messages
    world, oracle = CollisionWorld(AVERAGED_SETTINGS), FragmentedBody(body.vertices, body.tetrahedra)
    world.add_body(messages[0][0])
    for event in messages[1]:
        world.add_fracture(event)
        oracle.apply(event)
        case = FracturedWorld(world, oracle, event.sequence, curved, messages)
        world.contacts(case.states())
        yield case


def _text(value: float | str | int) -> str:
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def figures(asked: Asked) -> list[float]:
    error = 100.0 * np.abs(asked.depth - asked.true)
    near, deep = asked.true < NEAR, asked.true > DEEP
    result: list[float] = []
    for part in (np.ones(len(error), bool), near, deep):
        e = error[part] if part.any() else np.full(1, np.nan)
        result += [float(e.mean()), float(np.quantile(e, 0.99)), float(e.max())]
    result += [
        float(np.degrees(asked.angle.mean())), float((asked.angle > WRONG_WAY).mean()),
        float((asked.angle[near] > WRONG_WAY).mean()), float(1.0 - asked.grows[asked.stays].mean()),
        100.0 * float((asked.most - asked.true).mean()), 100.0 * float((asked.most - asked.true).max()),
    ]  # fmt: skip
    return result


def measure(case: FracturedWorld, radius: float) -> dict[str, Asked]:
    """Both fields at the same points: uniform in the body, and as many within 2 % R of the fragments' surfaces."""
    random = np.random.default_rng(1)
    surfaces = {f: case.oracle.surface_triangles(f) for f in case.oracle.fragment_ids}
    points = points_in(case, random, surfaces, radius)
    pools = case.geometry.pools
    scratch = make_scratch(1, len(pools.mesh.tetrahedra), 8)
    owners = np.full(len(points), -1)
    for fragment in case.oracle.fragment_ids:
        tets = np.empty(len(points), np.int64)
        find(pools, np.full(len(points), case.row(fragment)), points, scratch, tets)
        owners[tets >= 0] = fragment
    points, owners = points[owners >= 0], owners[owners >= 0]
    rows = np.array([case.row(f) for f in owners.tolist()])
    true, toward = np.empty(len(points)), np.empty((len(points), 3))
    for fragment, triangles in surfaces.items():
        own = owners == fragment
        if own.any():
            true[own], nearest = _distance(points[own], triangles)
            toward[own] = nearest - points[own]
    result = {}
    for name, field in (("averaged", AVERAGED), ("exact", EXACT)):
        chosen = pools._replace(field=field)
        answer, inward = np.empty((len(points), 6)), np.empty((len(points), 6))
        ask(chosen, rows, points, scratch, answer)
        ask(chosen, rows, points - INWARD * radius * answer[:, 2:5], scratch, inward)
        cosine = (answer[:, 2:5] * toward).sum(axis=1) / np.maximum(true, 1e-300)
        result[name] = Asked(
            answer[:, 1] / radius, answer[:, 5] / radius, true / radius,
            np.where(true > 1e-9 * radius, np.arccos(np.clip(cosine, -1.0, 1.0)), 0.0),
            inward[:, 1] > answer[:, 1], inward[:, 0] == answer[:, 0],
        )  # fmt: skip
    return result


def points_in(case: FracturedWorld, random: np.random.Generator, surfaces: dict, radius: float) -> np.ndarray:
    count = POINTS // 2
    corners = case.oracle.vertices[case.oracle.tetrahedra]
    volume = np.abs(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    chosen = corners[random.choice(len(corners), count, p=volume / volume.sum())]
    uniform = np.einsum("nij,ni->nj", chosen, random.dirichlet(np.ones(4), count))
    triangles = np.concatenate(list(surfaces.values()))
    sides = triangles[:, 1:] - triangles[:, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    chosen = triangles[random.choice(len(triangles), 2 * count, p=area / area.sum())]
    on = np.einsum("nij,ni->nj", chosen, random.dirichlet(np.ones(3), 2 * count))
    away = random.normal(size=on.shape)
    away *= NEAR * radius * random.uniform(0.0, 1.0, (len(on), 1)) / np.linalg.norm(away, axis=1)[:, None]
    return np.ascontiguousarray(np.vstack([uniform, on + away]))


def _distance(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    squared, _, nearest = igl.point_mesh_squared_distance(points, triangles.reshape(-1, 3), faces)[:3]
    return np.sqrt(squared), nearest


def flood_costs() -> list[tuple[float, ...]]:
    """What a flood costs by depth, with and without a start from the nodes; the point's tetrahedron is known."""
    case = fractured_world(ball(1.0, 0.1), 3, 1, False, AVERAGED_SETTINGS)
    random = np.random.default_rng(4)
    pools = case.geometry.pools
    scratch = make_scratch(1, len(pools.mesh.tetrahedra), 8)
    surfaces = {f: case.oracle.surface_triangles(f) for f in case.oracle.fragment_ids}
    points = np.vstack([points_in(case, random, surfaces, 1.0) for _ in range(4)])
    tets, rows = np.full(len(points), -1), np.zeros(len(points), np.int64)
    for fragment in case.oracle.fragment_ids:
        own = np.empty(len(points), np.int64)
        find(pools, np.full(len(points), case.row(fragment)), points, scratch, own)
        tets[own >= 0], rows[own >= 0] = own[own >= 0], case.row(fragment)
    points, rows, tets = points[tets >= 0], rows[tets >= 0], tets[tets >= 0]
    answer = np.empty((len(points), 6))
    ask(pools._replace(field=EXACT), rows, points, scratch, answer)
    print(f"\nA flood on a ball of {len(case.oracle.vertices)} nodes, three fragments; ns with the tetrahedron known")
    print(f"{'depth % R':>12}{'points':>8}{'tets':>8}{'from nodes':>12}{'ns':>8}{'from nodes':>12}{'averaged ns':>12}")
    costs = []
    for low, high in zip(DEPTHS[:-1], DEPTHS[1:], strict=True):
        part = (answer[:, 1] >= low) & (answer[:, 1] < high)
        if part.sum() < 50:
            continue
        r, t, p = rows[part], tets[part], points[part]
        reached = [np.empty(len(p)), np.empty(len(p))]
        sums = [flood(pools, r, t, p, start, True, scratch, reached[start]) for start in (False, True)]
        assert math.isclose(*sums, rel_tol=1e-12)
        times = [
            _best_ns(len(p), flood, pools, r, t, p, start, False, scratch, reached[0]) for start in (False, True)
        ]
        times.append(_best_ns(len(p), average, pools, r, t, p))
        costs.append((100 * low, 100 * high, reached[0].mean(), reached[1].mean(), *times))
        print(
            f"{100 * low:6.1f}-{100 * high:4.1f} {len(p):8d}{reached[0].mean():8.0f}{reached[1].mean():12.0f}"
            f"{times[0]:8.0f}{times[1]:12.0f}{times[2]:12.0f}"
        )
    return costs


def _best_ns(count: int, function, *arguments) -> float:
    best = math.inf
    for _ in range(REPEATS):
        started = perf_counter()
        function(*arguments)
        best = min(best, perf_counter() - started)
    return 1e9 * best / count


def grid_errors() -> None:
    """The dense grid's own error in whole bodies, by its resolution."""
    print("\nThe dense grid alone, whole bodies: error in % of R (mean, 99 %, worst), grid points a tetrahedron")
    kept = interior_field.CELLS_PER_EDGE
    for name, body in BODIES.items():
        mesh = build_tet_mesh(*body)
        geometry = CollisionGeometry()
        row = geometry.add_tetrahedra(prepare_mesh(mesh))
        random = np.random.default_rng(3)
        corners = mesh.nodes[mesh.tetrahedra[random.integers(0, len(mesh.tetrahedra), POINTS)]]
        points = np.ascontiguousarray(np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), POINTS)))
        answer = np.empty((POINTS, 6))
        ask(geometry.pools, np.full(POINTS, row), points, make_scratch(1, len(mesh.tetrahedra), 8), answer)
        radius = 0.5 * np.ptp(body.vertices, axis=0).max()
        for cells in (1, 2, 3, 4):
            interior_field.CELLS_PER_EDGE = cells
            interior = interior_field.make_interior_field(geometry.pools, row, 0, mesh)
            axes = [interior.origin[d] + interior.cell * np.arange(interior.dims[d]) for d in range(3)]
            cap = RegularGridInterpolator(axes, interior.depth.reshape(interior.dims))(points)
            error = 100.0 * np.abs(np.maximum(cap, 0.0) - answer[:, 1]) / radius
            print(
                f"{name:>8}, {cells} cells an edge: {error.mean():8.3f}{np.quantile(error, 0.99):8.3f}"
                f"{error.max():8.3f}{len(interior.depth) / len(mesh.tetrahedra):8.1f}"
            )
    interior_field.CELLS_PER_EDGE = kept


def draw(rows: list[dict], curves: dict[tuple[str, str], list[Asked]], costs: list[tuple[float, ...]]) -> None:
    figure, (by_depth, by_generation, cost) = plt.subplots(1, 3, figsize=(15, 4.5))
    edges = np.array([0.0, 0.5, 1, 2, 3, 5, 7, 10, 14, 18, 24, 32]) / 100.0
    for (field, cracks), parts in curves.items():
        if field == "exact" and cracks == "flat":
            continue  # zero
        true, depth = (np.concatenate([getattr(p, name) for p in parts]) for name in ("true", "depth"))
        bins = [(true >= low) & (true < high) for low, high in zip(edges[:-1], edges[1:], strict=True)]
        middle = 50.0 * (edges[:-1] + edges[1:])
        for label, statistic, style in (("mean", np.mean, "-"), ("99 %", lambda e: np.quantile(e, 0.99), ":")):
            values = [100.0 * statistic(np.abs(depth - true)[b]) if b.any() else np.nan for b in bins]
            by_depth.plot(middle, values, style, label=f"{field}, {cracks}: {label}")
    by_depth.set(xlabel="true depth [% R]", ylabel="error of depth [% R]", title="Four bodies, one to five generations")
    for cracks in ("flat", "curved"):
        for name in BODIES:
            own = [r for r in rows if (r["body"], r["cracks"], r["field"]) == (name, cracks, "averaged")]
            by_generation.plot(
                [r["gen"] for r in own], [r["mean"] for r in own], "-o" if cracks == "flat" else ":s",
                label=f"{name}, {cracks}",
            )  # fmt: skip
    by_generation.set(xlabel="generation", ylabel="mean error [% R]", title="The averaged field")
    middle = [0.5 * (c[0] + c[1]) for c in costs]
    for column, label in ((4, "flood"), (5, "flood from the nodes' bound"), (6, "averaged")):
        cost.semilogy(middle, [c[column] for c in costs], "-o", label=label)
    cost.set(xlabel="depth [% R]", ylabel="ns a point", title="Cost of a depth, ball of edge 0.1 R")
    for axes in (by_depth, by_generation, cost):
        axes.legend(fontsize=7)
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "field_errors.png", dpi=90)


if __name__ == "__main__":
    main()

"""Prints the figures of docs/numerics.md: the service against slow oracles, in about three minutes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the oracles live with the tests

from fractured_worlds import SETTINGS, FracturedWorld, fractured_world  # noqa: E402
from oracles.fragmented_body import ALL_KINDS, CRACK, STEP  # noqa: E402
from rigid_shapes import RigidShape, cube, l_block, noisy_ball, torus, true_distance  # noqa: E402

from fracture_collision.core.collision_geometry import CollisionGeometry, prepare_surface  # noqa: E402
from fracture_collision.core.elementary_queries import INSIDE, probe  # noqa: E402
from fracture_collision.core.scratch import make_scratch  # noqa: E402
from fracture_collision.geometry.generators import TetGeometry, ball, bowl, brick, plate, shell  # noqa: E402
from fracture_collision.geometry.tetrahedra import tetrahedron_volumes  # noqa: E402
from fracture_collision.records import FragmentStates  # noqa: E402
from fracture_collision.world import CollisionWorld  # noqa: E402

BODIES = {
    "ball": ball(1.0, 0.3),
    "brick": brick((2.0, 1.0, 0.8), 0.3),
    "shell": shell(1.0, 0.8, 0.4),
    "plate": plate(2.0, 0.2, 0.3, 0.2),
    "bowl": bowl(2.0, 0.2, 0.3, 0.6),
    "fine ball": ball(1.0, 0.15),
}
SEEDS, GENERATIONS = 8, 2
POINTS = 400
WRONG_WAY = np.cos(np.radians(30.0))
LEGEND = """
mass: pieces against the whole, relative; owners: points with another owner than the oracle's; depth: largest error
against all polygons of the border; steps: their area as a share of the crack area; ends cut: crack samples
more than 1 % of their edge before the crossing, and by at most; others: largest relative change of mass of a fragment
that had no part in a fracture; off 30: contacts more than 30 degrees off the flat crack of their pair, places jittered
by 1 % R
"""


def main() -> None:
    print(f"{SEEDS} Voronoi seeds, {GENERATIONS} generations; lengths in units of R, half the body's longest side\n")
    columns = (
        "body",
        "cracks",
        "mass",
        "owners",
        "depth",
        "steps",
        "ends cut",
        "by",
        "others",
        "off 30",
    )
    print("".join(f"{c:>10}" for c in columns))
    for curved in (False, True):
        for name, body in BODIES.items():
            case = fractured_world(body, SEEDS, GENERATIONS, curved)
            radius = 0.5 * np.ptp(body.vertices, axis=0).max()
            owners, depth = _field(case, radius)
            cut_short, cut_by = _sample_shares(case)
            row = (
                name, "curved" if curved else "flat", f"{_mass_error(case, body):.1e}", owners, f"{depth:.1e}",
                f"{_step_area(case):.1%}", f"{cut_short:.1%}", f"{cut_by:.2f}",
                f"{_change_of_others(case):.1e}", "" if curved else f"{_wrong_directions(case, radius):.1%}",
            )  # fmt: skip
            print("".join(f"{entry:>10}" for entry in row), flush=True)
    print(LEGEND)
    print(f"{'mesh':>12}{'triangles':>12}{'error':>12}{'wrong signs':>12}")
    for name, shape in (("cube", cube()), ("l_block", l_block()), ("torus", torus()), ("noisy ball", noisy_ball())):
        error, wrong = _triangle_field(shape)
        print(f"{name:>12}{len(shape.triangles):>12}{error:>12.1e}{wrong:>12d}")


def _points_within(case: FracturedWorld) -> np.ndarray:
    random = np.random.default_rng(1)
    corners = case.oracle.vertices[case.oracle.tetrahedra[random.integers(0, len(case.oracle.tetrahedra), POINTS)]]
    return np.einsum("nij,ni->nj", corners, random.dirichlet(np.ones(4), POINTS))


def _field(case: FracturedWorld, radius: float) -> tuple[int, float]:
    points = _points_within(case)
    owners = case.oracle.owner(points)
    scratch = make_scratch(1, len(case.oracle.tetrahedra), 8)
    wrong, error = 0, 0.0
    for fragment in case.oracle.fragment_ids:
        own = owners == fragment
        answers = [probe(case.geometry.pools, case.row(fragment), *p, 0.0, np.inf, scratch, 0)[:2] for p in points]
        wrong += sum((status == INSIDE) != mine for (status, _), mine in zip(answers, own, strict=True))
        if not own.any():
            continue
        measured = -np.array([distance for (_, distance), mine in zip(answers, own, strict=True) if mine])
        error = max(error, np.abs(measured - case.oracle.depth(fragment, points[own], ALL_KINDS)[0]).max())
    return wrong, error / radius


def _area(triangles: np.ndarray) -> float:
    return (
        0.5
        * np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1).sum()
    )


def _step_area(case: FracturedWorld) -> float:
    areas = dict.fromkeys((STEP, CRACK), 0.0)
    for fragment in case.oracle.fragment_ids:
        for polygon in case.oracle.surface_polygons(fragment, (STEP, CRACK)):
            fan = [(polygon.points[0], b, c) for b, c in zip(polygon.points[1:-1], polygon.points[2:], strict=True)]
            areas[polygon.kind] += _area(np.array(fan))
    return areas[STEP] / areas[CRACK]


def _mass_error(case: FracturedWorld, body: TetGeometry) -> float:
    registry = case.world.fragments()
    whole = CollisionWorld(SETTINGS)
    whole.add_body(case.messages[0][0])
    assert np.isclose(whole.fragments().masses[0], 2500.0 * tetrahedron_volumes(*body).sum())
    return abs(registry.masses.sum() / whole.fragments().masses[0] - 1.0)


def _change_of_others(case: FracturedWorld) -> float:
    world = CollisionWorld(SETTINGS)
    world.add_body(case.messages[0][0])
    masses: dict[int, float] = {}
    largest = 0.0
    for event in case.messages[1]:
        world.add_fracture(event)
        world.contacts(FragmentStates(1, event.sequence, np.zeros(0, int), np.zeros(0), np.zeros(0)))
        registry = world.fragments()
        now = dict(zip(registry.fragment_ids.tolist(), registry.masses.tolist(), strict=True))
        largest = max([largest, *(abs(now[f] / masses[f] - 1.0) for f in now if f in masses)])
        masses = now
    return largest


def _sample_shares(case: FracturedWorld) -> tuple[float, float]:
    """Crack samples that end before the crossing of their edge: how many, by which share of it at most."""
    oracle = case.oracle
    nodes, total, moved, most = len(oracle.vertices), 0, 0, 0.0
    for fragment in oracle.fragment_ids:
        row = case.row(fragment)
        tree = case.geometry.sphere_tree(row)
        at_crack = (tree.size == 1) & (tree.sample >= nodes)
        for sample, point in zip(tree.sample[at_crack], tree.center[at_crack], strict=True):
            edge, side = divmod(int(sample) - nodes, 2)
            ends = oracle.edges[edge]
            own, far = oracle.vertices[ends[side]], oracle.vertices[ends[1 - side]]
            plane = oracle.planes[tuple(ends.tolist())]
            crossing = (plane[3] - plane[:3] @ own) / (plane[:3] @ (far - own))
            short = crossing - np.linalg.norm(point - own) / np.linalg.norm(far - own)
            total, moved, most = total + 1, moved + (short > 0.01), max(most, short)
    return moved / total, most


def _wrong_directions(case: FracturedWorld, radius: float) -> float:
    """Share of contacts whose normal is more than 30 degrees off the one plane their two fragments share."""
    planes: dict[tuple[int, int], set[tuple]] = {}
    for (a, b), plane in case.oracle.planes.items():
        pair = (int(case.oracle.labels[a]), int(case.oracle.labels[b]))
        oriented = plane if pair[0] < pair[1] else -plane
        planes.setdefault((min(pair), max(pair)), set()).add(tuple(np.round(oriented + 0.0, 12).tolist()))
    wrong = total = 0
    for seed in range(5):
        answer = case.world.contacts(case.states(0.01 * radius, seed))
        normals = answer.normals.reshape(-1, 3)
        for i, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
            shared = planes.get(pair, set())
            if len(shared) != 1:
                continue
            own = normals[answer.pair_begin[i] : answer.pair_begin[i + 1]]
            total += len(own)
            wrong += int((own @ np.array(next(iter(shared)))[:3] < WRONG_WAY).sum())
    return wrong / total if total else float("nan")


def _triangle_field(shape: RigidShape) -> tuple[float, int]:
    geometry = CollisionGeometry()
    geometry.add_triangles(prepare_surface(*shape))
    random = np.random.default_rng(3)
    weights = random.dirichlet(np.ones(3), 1000)
    near = np.einsum("ij,ijk->ik", weights, shape.corners[random.integers(0, len(shape.corners), 1000)])
    points = near + random.normal(size=near.shape) * 10.0 ** random.uniform(-6, 0, (1000, 1))
    scratch = make_scratch(1, 1, 8)
    measured = np.array([probe(geometry.pools, 0, *p, np.inf, np.inf, scratch, 0)[1] for p in points])
    expected = true_distance(shape, points)
    return float(np.abs(np.abs(measured) - np.abs(expected)).max()), int((measured * expected < 0.0).sum())


if __name__ == "__main__":
    main()

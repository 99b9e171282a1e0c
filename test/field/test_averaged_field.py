"""The averaged field of Glondu 2014 against its slow twin, and its bounds against the exact truth."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest
from oracles.averaged_field import AveragedField
from oracles.fracture_patterns import disagreeing_event
from oracles.fragmented_body import ALL_KINDS, FragmentedBody
from scipy.interpolate import RegularGridInterpolator
from truth.contact_truth import Poses, pairs_of, sample_ids, surface_samples
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings
from worlds.hard_worlds import anywhere

from fracture_collision.core.field.elementary_queries import INSIDE
from fracture_collision.core.glondu2014.paper_pools import PaperPools
from fracture_collision.core.glondu2014.paper_probe import paper_probe
from fracture_collision.core.memory.pools import OWNER, Pools
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.geometry.generators import TetGeometry, ball, bowl, brick, plate, shell
from fracture_collision.records import BUDGET_EXHAUSTED, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

AVERAGED = Settings(threads=1, method="glondu2014")
SHAPES = {
    "ball": lambda: ball(1.0, 0.35),
    "brick": lambda: brick((2.0, 1.0, 0.8), 0.4),
    "shell": lambda: shell(1.0, 0.6, 0.5),
    "plate": lambda: plate(2.0, 0.3, 0.4, 0.2),
    "bowl": lambda: bowl(2.0, 0.2, 0.4, 0.6),
}
CASES = [(s, c) for s in SHAPES for c in ("flat", "curved")]
GENERATIONS = 3
ROUNDING = 1e-12  # of R, which is about 1 m for all shapes here


def _irregular(body: TetGeometry, edge: float = 0.4) -> TetGeometry:
    """Jittered nodes: in a regular mesh many are equally far from two surfaces."""
    random = np.random.default_rng(17)
    return body._replace(vertices=body.vertices + random.uniform(-0.03 * edge, 0.03 * edge, body.vertices.shape))


class Twins:
    """A world under the averaged field and its slow twin, broken side by side."""

    def __init__(self, case: FracturedWorld) -> None:
        body, self.events = case.messages[0][0], case.messages[1]
        self.oracle = FragmentedBody(body.vertices.reshape(-1, 3), body.tetrahedra.reshape(-1, 4))
        self.slow = AveragedField(self.oracle)
        self.world = CollisionWorld(AVERAGED)
        self.world.add_body(body)
        self.done = 0

    def break_next(self) -> int:
        event = self.events[self.done]
        self.done += 1
        self.world.add_fracture(event)
        self.world.contacts(FragmentStates(1, self.done, np.zeros(0, int), np.zeros(0), np.zeros(0)))
        return self.slow.apply(event)

    @property
    def pools(self):
        return self.world._registry.geometry.pools

    @property
    def node_field(self) -> np.ndarray:
        return self.paper.field.node_field

    @property
    def paper(self):
        return self.world.geometry.paper.pools


def pools_of(case: FracturedWorld) -> tuple[Pools, PaperPools]:
    return case.geometry.pools, case.geometry.paper.pools


def _case(shape: str, cracks: str, generations: int = GENERATIONS, seeds: int = 5) -> FracturedWorld:
    return fractured_world(_irregular(SHAPES[shape]()), seeds, generations, cracks == "curved", AVERAGED)


@pytest.fixture(scope="module", params=CASES, ids=["-".join(c) for c in CASES])
def case(request) -> FracturedWorld:
    return _case(*request.param)


@pytest.mark.slow
def test_five_generations_equal_the_slow_twin() -> None:
    """On meshes with enough layers for the fronts to propagate."""
    for body, cracks in ((ball(1.0, 0.25), "flat"), (ball(1.0, 0.25), "curved"), (brick((2.0, 1.4, 1.2), 0.2), "flat")):
        twins = Twins(fractured_world(_irregular(body, 0.2), 2, 5, cracks == "curved", AVERAGED))
        steps = []
        for _ in twins.events:
            steps.append(twins.break_next())
            _assert_equal(twins)
        assert len(steps) == 5 and max(steps) >= 8


def _assert_equal(twins: Twins) -> None:
    nodes = range(len(twins.oracle.vertices))
    distance = np.array([twins.slow.distance[v] for v in nodes])
    direction = np.array([twins.slow.direction[v] for v in nodes])
    assert np.abs(twins.node_field[:, 0] - distance).max() <= ROUNDING
    assert np.abs(twins.node_field[:, 1:4] - direction).max() <= 1e-9


def test_every_generation_equals_the_slow_twin_and_only_lowers_depths_of_what_broke(case: FracturedWorld) -> None:
    twins = Twins(case)
    before = None
    whole = dict(twins.slow.distance)
    for event in twins.events:
        twins.break_next()
        _assert_equal(twins)
        if before is not None:
            broken = np.isin(np.arange(len(before)), event.nodes)
            assert np.array_equal(twins.node_field[~broken, :4], before[~broken, :4])
            assert (twins.node_field[:, 0] <= before[:, 0]).all()
        before = twins.node_field.copy()
        assert (before[:, 0] >= 0.0).all()
        assert np.allclose(np.linalg.norm(before[:, 1:4], axis=1), 1.0, atol=1e-12)
    assert any(twins.slow.distance[v] < d for v, d in whole.items())


def test_the_field_of_a_whole_body_is_exact(case: FracturedWorld) -> None:
    """Before the first fracture: distances at the nodes and on the grid against brute force, outside negative."""
    whole = FragmentedBody(case.oracle.vertices, case.oracle.tetrahedra)
    interior = case.world._ledger.bodies[1].mesh.paper[0].interior[0]
    depth, nearest = whole.depth(1, whole.vertices)
    is_interior = interior.node_field[:, 0] > 0.0
    assert np.abs(interior.node_field[is_interior, 0] - depth[is_interior]).max(initial=0.0) <= ROUNDING
    assert np.abs(interior.node_field[:, 4:] - nearest).max() <= 1e-9
    assert np.array_equal(interior.node_field[~is_interior, 4:], whole.vertices[~is_interior])
    axes = [interior.origin[d] + interior.cell * np.arange(interior.dims[d]) for d in range(3)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    chosen = np.random.default_rng(2).choice(len(grid), 300, replace=False)
    distance, _ = whole.distance_to_surface(1, grid[chosen])
    expected = np.where(whole.owner(grid[chosen]) == 1, distance, -np.minimum(distance, np.sqrt(3.0) * interior.cell))
    assert np.abs(interior.depth[chosen] - expected).max() <= 1e-8 * interior.cell


def test_depth_is_eq_1_local_surfaces_and_the_grids_cap(case: FracturedWorld) -> None:
    twins = Twins(case)
    for _ in twins.events:
        twins.break_next()
    interior = case.world._ledger.bodies[1].mesh.paper[0].interior[0]
    axes = [interior.origin[d] + interior.cell * np.arange(interior.dims[d]) for d in range(3)]
    cap = RegularGridInterpolator(axes, interior.depth.reshape(interior.dims))
    points = anywhere(case, 200, seed=11)
    owners, tets = case.oracle.owner(points), case.oracle.locate(points)
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    capped, cut = 0, 0
    for x, fragment, t in zip(points, owners.tolist(), tets.tolist(), strict=True):
        status, distance, *rest = paper_probe(*pools_of(case), case.row(fragment), tuple(x), 0.0, np.inf, scratch)[:8]
        depth, direction = twins.slow.penetration(fragment, t, x)
        limit = max(float(cap(x)[0]), 0.0)
        assert status == INSIDE and distance <= 0.0
        assert abs(-distance - min(depth, limit)) <= 1e-11
        normal, witness = np.array(rest[:3]), np.array(rest[3:])
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        assert np.abs(witness - (x - distance * normal)).max() <= ROUNDING
        if limit < depth - 1e-9:
            capped += 1
            step = 1e-6 * interior.cell
            gradient = np.array([cap(x + step * e)[0] - cap(x - step * e)[0] for e in np.eye(3)])
            if np.linalg.norm(gradient) > 1e-3 * step:
                assert normal @ gradient / np.linalg.norm(gradient) < -0.999
        elif limit > depth + 1e-9:
            cut += int(case.geometry.pools.body.regions[t, OWNER] < 0)
            assert np.abs(normal - direction).max() <= 1e-6
    assert capped > 5 and cut > 5


def test_the_certain_depth_is_never_below_the_true_one(case: FracturedWorld) -> None:
    _assert_certain(case)


def _assert_certain(case: FracturedWorld) -> int:
    """Asserts that no bound is below the true depth; returns the number of points.

    The true depth is the distance to the nearest point of another owner.
    """
    points = anywhere(case, 400, seed=11)
    owners = case.oracle.owner(points)
    scratch = make_scratch(len(case.oracle.tetrahedra), 8)
    asked = 0
    for fragment in case.oracle.fragment_ids:
        own = points[owners == fragment]
        if not len(own):
            continue
        true, _ = case.oracle.depth(fragment, own, ALL_KINDS)
        pools, row = pools_of(case), case.row(fragment)
        most = [paper_probe(*pools, row, tuple(x), 0.0, np.inf, scratch).most_depth for x in own]
        assert (np.array(most) >= true - ROUNDING).all()
        asked += len(own)
    field = pools_of(case)[1].field.node_field
    for fragment in case.oracle.fragment_ids:
        nodes = np.flatnonzero(case.oracle.labels == fragment)
        inside, _ = case.oracle.depth(fragment, field[nodes, 4:], ALL_KINDS)
        assert inside.max() <= ROUNDING
    return asked


@pytest.mark.parametrize("shape", ["ball", "bowl"])
@pytest.mark.parametrize("seed", range(3))
def test_certain_points_survive_planes_that_agree_on_nothing(shape: str, seed: int) -> None:
    """Four generations of cracks in which every edge has its own plane, at a random angle and place."""
    make = partial(disagreeing_event, tilt=0.5, random=np.random.default_rng(seed))
    body = _irregular(SHAPES[shape]())
    assert _assert_certain(fractured_world(body, 3, 4, settings=AVERAGED, seed=seed, make=make)) == 400


@pytest.mark.parametrize(
    ("jitter", "most"),
    [(0.02, 0), (0.15, 100), *(pytest.param(*each, marks=pytest.mark.slow) for each in ((0.02, 100), (0.15, 0)))],
)
def test_no_unlisted_sample_is_deeper_than_the_bound(case: FracturedWorld, jitter: float, most: int) -> None:
    world = with_settings(case, AVERAGED._replace(max_work=most)) if most else case.world
    states = case.states(jitter, seed=1)
    answer, poses = world.contacts(states), Poses(states)
    assert bool(answer.status & BUDGET_EXHAUSTED) <= bool(most)
    listed, epsilon = pairs_of(answer), AVERAGED.penetration_tolerance
    witnesses = {"a": answer.points_a.reshape(-1, 3), "b": answer.points_b.reshape(-1, 3)}
    normals = answer.normals.reshape(-1, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert np.allclose(answer.gaps, ((witnesses["b"] - witnesses["a"]) * normals).sum(axis=1), atol=1e-12)
    # the witness is the sample moved by the gap along the normal, even off the surface
    assert np.allclose(witnesses["b"], witnesses["a"] + answer.gaps[:, None] * normals, atol=1e-9)
    ids = case.oracle.fragment_ids
    for i, a in enumerate(ids):
        for b in ids[i + 1 :]:
            rows, bound = listed.get((a, b), (slice(0, 0), epsilon * 1.05))
            for own, other in ((a, b), (b, a)):
                samples, numbers = surface_samples(case, own)
                points = poses.to_body(other, poses.to_world(own, samples))
                unlisted = points[~np.isin(sample_ids(own, other, numbers), answer.contact_ids[rows])]
                if len(unlisted):
                    assert case.oracle.depth(other, unlisted, ALL_KINDS)[0].max() <= bound


def test_fields_that_are_not_used_are_not_stored() -> None:
    """Our method stores neither trees nor an averaged field; an unbroken body stores no interior."""
    case = fractured_world(SHAPES["ball"](), 4, 1)
    paper = case.geometry.paper.pools
    assert len(paper.trees.entries) and not len(paper.field.node_field) and not len(paper.field.grid_depth)
    ours = with_settings(case, Settings(threads=1))
    ours.contacts(case.states())
    assert ours.geometry.paper is None and not ours._ledger.bodies[1].mesh.paper
    world = CollisionWorld(AVERAGED)
    world.add_body(case.messages[0][0])
    world.contacts(FragmentStates(1, 0, np.array([1]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])))
    assert not world._ledger.bodies[1].mesh.paper[0].interior
    assert not len(world.geometry.paper.pools.field.grid_depth)

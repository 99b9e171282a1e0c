"""The averaged field of Glondu 2014 against its slow twin, and its bounds against the exact truth."""

from __future__ import annotations

from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
import pytest
from oracles.averaged_field import AveragedField
from oracles.fracture_patterns import disagreeing_event
from oracles.fragmented_body import ALL_KINDS, FragmentedBody
from scipy.interpolate import RegularGridInterpolator
from truth.contact_truth import ContactTruth, Poses, check_pair, pairs_of
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
ROUNDING = 1e-12  # of R, which is about 1 m for all shapes here


def _irregular(body: TetGeometry, edge: float = 0.4) -> TetGeometry:
    """Jittered nodes: in a regular mesh many are equally far from two surfaces."""
    random = np.random.default_rng(17)
    return body._replace(vertices=body.vertices + random.uniform(-0.03 * edge, 0.03 * edge, body.vertices.shape))


class Twins(NamedTuple):
    """A world under the averaged field and its slow twin after the same events, and the field after each of these."""

    case: FracturedWorld
    slow: AveragedField
    fields: list[np.ndarray]  # (nodes, 7) of the world's nodes
    slow_fields: list[tuple[np.ndarray, np.ndarray]]  # distances and directions of the twin's
    whole: dict[int, float]  # distances of the twin's before the first event
    steps: list[int]  # of the fronts

    @property
    def interior(self):
        """The field of the unbroken body."""
        return self.case.world._ledger.bodies[1].mesh.paper[0].interior[0]


def broken_side_by_side(case: FracturedWorld) -> Twins:
    body, events = case.messages[0][0], case.messages[1]
    slow, world = AveragedField(FragmentedBody(body.vertices, body.tetrahedra)), CollisionWorld(AVERAGED)
    twins = Twins(case, slow, [], [], dict(slow.distance), [])
    world.add_body(body)
    nodes = range(len(slow.body.vertices))
    for event in events:
        world.add_fracture(event)
        world.contacts(FragmentStates(1, event.sequence, [], [], []))
        twins.steps.append(slow.apply(event))
        twins.fields.append(world.geometry.paper.pools.field.node_field.copy())
        twins.slow_fields.append(
            (np.array([slow.distance[v] for v in nodes]), np.array([slow.direction[v] for v in nodes]))
        )
    return twins


def pools_of(case: FracturedWorld) -> tuple[Pools, PaperPools]:
    return case.geometry.pools, case.geometry.paper.pools


@pytest.fixture(scope="module", params=CASES, ids="-".join)
def twins(request) -> Twins:
    shape, cracks = request.param
    body = _irregular(SHAPES[shape]())
    return broken_side_by_side(fractured_world(body, 5, 3, cracks == "curved", AVERAGED))


@pytest.mark.slow
def test_five_generations_equal_the_slow_twin() -> None:
    """On meshes with enough layers for the fronts to propagate."""
    for body, cracks in ((ball(1.0, 0.25), "flat"), (ball(1.0, 0.25), "curved"), (brick((2.0, 1.4, 1.2), 0.2), "flat")):
        twins = broken_side_by_side(fractured_world(_irregular(body, 0.2), 2, 5, cracks == "curved", AVERAGED))
        assert_equal(twins)
        assert len(twins.steps) == 5 and max(twins.steps) >= 8


def assert_equal(twins: Twins) -> None:
    for field, (distance, direction) in zip(twins.fields, twins.slow_fields, strict=True):
        assert np.abs(field[:, 0] - distance).max() <= ROUNDING
        assert np.abs(field[:, 1:4] - direction).max() <= 1e-9


def test_every_generation_equals_the_slow_twin_and_only_lowers_depths_of_what_broke(twins: Twins) -> None:
    assert_equal(twins)
    for event, before, after in zip(twins.case.messages[1][1:], twins.fields[:-1], twins.fields[1:], strict=True):
        broken = np.isin(np.arange(len(before)), event.nodes)
        assert np.array_equal(after[~broken, :4], before[~broken, :4])
        assert (after[:, 0] <= before[:, 0]).all()
    for field in twins.fields:
        assert (field[:, 0] >= 0.0).all()
        assert np.allclose(np.linalg.norm(field[:, 1:4], axis=1), 1.0, atol=1e-12)
    assert any(twins.slow.distance[v] < d for v, d in twins.whole.items())


def test_the_field_of_a_whole_body_is_exact(twins: Twins) -> None:
    """Before the first fracture: distances at the nodes and on the grid against brute force, outside negative."""
    whole, interior = FragmentedBody(twins.case.oracle.vertices, twins.case.oracle.tetrahedra), twins.interior
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


def test_depth_is_eq_1_local_surfaces_and_the_grids_cap(twins: Twins) -> None:
    case, interior = twins.case, twins.interior
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


def test_the_certain_depth_is_never_below_the_true_one(twins: Twins) -> None:
    _assert_certain(twins.case)


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
def test_no_unlisted_sample_is_deeper_than_the_bound(twins: Twins, jitter: float, most: int) -> None:
    case = twins.case
    world = with_settings(case, AVERAGED._replace(max_work=most)) if most else case.world
    states, truth = case.states(jitter, seed=1), ContactTruth(case)
    answer = world.contacts(states)
    assert bool(answer.status & BUDGET_EXHAUSTED) <= bool(most)
    listed, poses, epsilon = pairs_of(answer), Poses(states), AVERAGED.penetration_tolerance
    for pair in combinations(case.oracle.fragment_ids, 2):
        check = check_pair(truth, poses, answer, pair, listed, epsilon * 1.05)
        assert check.deepest_unlisted <= check.bound, (pair, check)
    # the witness is the sample moved by the gap along the normal, even off the surface
    normals, apart = answer.normals.reshape(-1, 3), (answer.points_b - answer.points_a).reshape(-1, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert np.allclose(answer.gaps, (apart * normals).sum(axis=1), atol=1e-12)
    assert np.allclose(apart, answer.gaps[:, None] * normals, atol=1e-9)


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

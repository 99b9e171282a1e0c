"""Contacts against the slow truth: depth, witness, what was left out, and what does not change the answer."""

from __future__ import annotations

import numpy as np
import pytest
from fractured_worlds import SETTINGS, FracturedWorld, fractured_world
from oracles.fragmented_body import ALL_KINDS
from rigid_shapes import noisy_ball
from scipy.spatial.transform import Rotation

from fracture_collision.core.fragment_trees import TREES
from fracture_collision.geometry.generators import ball, bowl, brick, shell
from fracture_collision.records import BUDGET_EXHAUSTED, CollisionBody, ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.contact_ids import contact_ids
from fracture_collision.world.settings import TRAVERSALS

SURFACE = ALL_KINDS
SHAPES = {
    "ball": lambda: ball(1.0, 0.4),
    "brick": lambda: brick((2.0, 1.0, 0.8), 0.4),
    "shell": lambda: shell(1.0, 0.8, 0.6),
    "bowl": lambda: bowl(2.0, 0.2, 0.4, 0.6),
}
SEARCHES = [(tree, traversal) for tree in TREES for traversal in TRAVERSALS]
DEFAULT_SEARCH = (SETTINGS.tree, SETTINGS.traversal)
QUICK = [("ball", "flat"), ("shell", "curved")]  # with every tree and traversal; the others with the default only
CASES = [
    pytest.param((s, c, search), id="-".join((s, c) if search == DEFAULT_SEARCH else (s, c, *search)),
                 marks=() if search == DEFAULT_SEARCH or (s, c) in QUICK else pytest.mark.slow)
    for search in (DEFAULT_SEARCH, *(other for other in SEARCHES if other != DEFAULT_SEARCH))
    for s in SHAPES for c in ("flat", "curved")
]  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    shape, cracks, (tree, traversal) = request.param
    settings = SETTINGS._replace(tree=tree, traversal=traversal)
    return fractured_world(SHAPES[shape](), seeds=5, generations=2, curved=cracks == "curved", settings=settings)


def _surface_samples(case: FracturedWorld, fragment: int) -> tuple[np.ndarray, np.ndarray]:
    tree = case.geometry.sphere_tree(case.row(fragment))
    leaves = (tree.size == 1) & (tree.on_surface == 1)
    return tree.center[leaves], tree.sample[leaves]


class Poses:
    def __init__(self, states: FragmentStates) -> None:
        ids = np.asarray(states.fragment_ids).tolist()
        self.rotation = dict(zip(ids, Rotation.from_quat(states.orientations.reshape(-1, 4)), strict=True))
        self.position = dict(zip(ids, states.positions.reshape(-1, 3), strict=True))

    def to_body(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return self.rotation[fragment].inv().apply(points - self.position[fragment])

    def to_world(self, fragment: int, points: np.ndarray) -> np.ndarray:
        return self.rotation[fragment].apply(points) + self.position[fragment]


def _true_depths(case: FracturedWorld, poses: Poses, own: int, other: int) -> np.ndarray:
    """Depth of every surface sample of `own` in `other`; minus infinity where it is not inside."""
    samples, _ = _surface_samples(case, own)
    points = poses.to_body(other, poses.to_world(own, samples))
    inside = case.oracle.owner(points) == other
    depth = np.full(len(points), -np.inf)
    if inside.any():
        depth[inside] = case.oracle.depth(other, points[inside], SURFACE)[0]
    return depth


def _ids(own: int, other: int, samples: np.ndarray) -> np.ndarray:
    out = np.empty(len(samples), np.uint64)
    contact_ids(np.full(len(samples), own), np.full(len(samples), other), samples.astype(np.int64), out)
    return out


def _pairs(answer: ContactConstraintArray) -> dict[tuple[int, int], tuple[slice, float]]:
    return {
        (int(a), int(b)): (
            slice(int(answer.pair_begin[i]), int(answer.pair_begin[i + 1])),
            answer.missed_depth_bound[i],
        )
        for i, (a, b) in enumerate(zip(answer.fragment_a, answer.fragment_b, strict=True))
    }


@pytest.mark.parametrize("jitter", [0.0, 0.02, 0.15])
def test_contacts_are_true_and_the_bound_holds(case: FracturedWorld, jitter: float) -> None:
    # In place, samples lie on edges that several tetrahedra share; where older planes disagree these have different
    # owners for such a point, and either is right. In general position one tetrahedron holds a point.
    if jitter == 0.0 and case.curved:
        jitter = 1e-4
    states = case.states(jitter, seed=1)
    answer, poses = case.world.contacts(states), Poses(states)
    settings = case.world.settings
    epsilon, near = settings.penetration_tolerance, settings.detection_tolerance  # R = 1 for all shapes here
    listed = _pairs(answer)
    assert list(listed) == sorted(listed)
    points = {"a": answer.points_a.reshape(-1, 3), "b": answer.points_b.reshape(-1, 3)}
    normals = answer.normals.reshape(-1, 3)
    assert np.allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-12)
    assert np.allclose(answer.gaps, ((points["b"] - points["a"]) * normals).sum(axis=1), atol=1e-12)
    assert len(set(answer.contact_ids.tolist())) == len(answer.contact_ids)
    ids = case.oracle.fragment_ids
    for i, a in enumerate(ids):
        for b in ids[i + 1 :]:
            rows, bound = listed.get((a, b), (slice(0, 0), epsilon))
            worst_unlisted = 0.0
            for own, other, mine, theirs in ((a, b, "a", "b"), (b, a, "b", "a")):
                depths = _true_depths(case, poses, own, other)
                samples, numbers = _surface_samples(case, own)
                number_of = {key: k for k, key in enumerate(_ids(own, other, numbers).tolist())}
                at = [number_of.get(key, -1) for key in answer.contact_ids[rows].tolist()]
                chosen = np.array([k for k in at if k >= 0], dtype=int)
                contact = np.array([k >= 0 for k in at], dtype=bool)
                unlisted = np.setdiff1d(np.arange(len(samples)), chosen)
                worst_unlisted = max(worst_unlisted, depths[unlisted].max(initial=0.0))
                if not len(chosen):
                    continue
                assert np.allclose(points[mine][rows][contact], poses.to_world(own, samples[chosen]), atol=1e-12)
                witness = poses.to_body(other, points[theirs][rows][contact])
                assert case.oracle.distance_to_surface(other, witness, SURFACE)[0].max() <= 1e-9
                inside = depths[chosen] > 1e-12
                gaps = answer.gaps[rows][contact]
                assert np.allclose(gaps[inside], -depths[chosen][inside], atol=1e-9)
                assert (gaps[~inside] >= -1e-9).all()
            assert worst_unlisted <= bound, f"pair {a}-{b}: a sample {worst_unlisted} deep is not listed; bound {bound}"
            assert (answer.gaps[rows] <= near + 1e-9).all()
            assert bound <= epsilon + 1e-9


def test_a_budget_makes_the_bound_grow_instead_of_lie(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=2)
    poses = Poses(states)
    for budget in (200, 1000, 4000):
        limited = fractured_like(case, case.world.settings._replace(visit_budget=budget))
        answer = limited.contacts(states)
        listed = _pairs(answer)
        if not answer.status & BUDGET_EXHAUSTED:
            continue
        for (a, b), (rows, bound) in listed.items():
            for own, other in ((a, b), (b, a)):
                depths = _true_depths(case, poses, own, other)
                is_listed = np.isin(_ids(own, other, _surface_samples(case, own)[1]), answer.contact_ids[rows])
                assert depths[~is_listed].max(initial=0.0) <= bound
        return
    pytest.fail("no budget was small enough to cut a search short")


def fractured_like(case: FracturedWorld, settings: Settings):
    """A world of the same bodies and events with other settings."""
    world = CollisionWorld(settings)
    for body in case.messages[0]:
        world.add_body(body)
    for event in case.messages[1]:
        world.add_fracture(event)
    return world


def _bytes(answer: ContactConstraintArray) -> bytes:
    return b"".join(np.asarray(field).tobytes() for field in answer)


def test_the_answer_is_the_same_bytes_for_any_number_of_threads(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=4)
    reference = _bytes(case.world.contacts(states))
    for threads in (2, 3, 8):
        assert _bytes(fractured_like(case, case.world.settings._replace(threads=threads)).contacts(states)) == reference


def test_a_full_list_does_not_depend_on_tree_or_traversal() -> None:
    """With room for every contact all searches list the same samples, in their own order."""
    case = fractured_world(SHAPES["bowl"](), seeds=6, generations=3, curved=True)
    states = case.states(0.03, seed=6)
    listed = []
    for tree, traversal in SEARCHES:
        settings = SETTINGS._replace(
            tree=tree, traversal=traversal, contacts_per_pair=100_000, detection_tolerance=0.05
        )
        answer = fractured_like(case, settings).contacts(states)
        by_id = np.argsort(answer.contact_ids)
        listed.append((answer.contact_ids[by_id].tolist(), answer.gaps[by_id].tolist(), answer.fragment_a.tolist()))
    assert len(listed[0][0]) > 500
    assert all(other == listed[0] for other in listed[1:])


@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_nodes_are_visited_in_the_order_of_the_traversal(traversal: str) -> None:
    """Every sample of a ball lies within the tolerance of a plane: contacts come in the order of the visits."""
    world = CollisionWorld(SETTINGS._replace(traversal=traversal, contacts_per_pair=1000, detection_tolerance=1.0))
    vertices, triangles = noisy_ball()
    world.add_body(CollisionBody(1, 1, vertices=vertices.ravel(), triangles=triangles.ravel()))
    world.add_body(CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    answer = world.contacts(FragmentStates(1, 0, np.array([1]), np.array([0, 0, -0.5]), np.array([0.0, 0.0, 0.0, 1.0])))
    tree = world._registry.geometry.sphere_tree(world._registry.row_of(1))
    level, samples = [0], [tree.sample[0]]
    while level:
        children = [_children(tree.size, entry) for entry in level]
        if traversal == "alternating":
            rounds = range(max(map(len, children)))
            following = [(n, c[k]) for k in rounds for n, c in zip(level, children, strict=True) if k < len(c)]
        else:
            following = [(n, child) for n, c in zip(level, children, strict=True) for child in c]
        samples += [tree.sample[child] for n, child in following if tree.sample[child] != tree.sample[n]]
        level = [child for _, child in following if tree.size[child] > 1]
    assert len(samples) == len(vertices)
    assert answer.contact_ids.tolist() == _ids(1, 2, np.array(samples)).tolist()


def _children(size: np.ndarray, entry: int) -> list[int]:
    children, child = [], entry + 1
    while child < entry + size[entry]:
        children.append(child)
        child += int(size[child])
    return children


def test_the_answer_has_no_memory(case: FracturedWorld) -> None:
    """Other states, and states of earlier registries, in between change nothing."""
    states = case.states(0.05, seed=4)
    reference = _bytes(case.world.contacts(states))
    digest = case.world.fragments().digest
    whole = FragmentStates(1, 0, np.array([1]), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    case.world.contacts(case.states(0.2, seed=9))
    assert len(case.world.contacts(whole).gaps) == 0
    assert case.world.fragments().fragment_ids.tolist() == [1]
    assert _bytes(case.world.contacts(states)) == reference
    assert case.world.fragments().digest == digest


def test_order_of_the_named_fragments_does_not_matter(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=4)
    back = FragmentStates(
        states.step, states.fracture_sequence, states.fragment_ids[::-1],
        states.positions.reshape(-1, 3)[::-1].ravel(), states.orientations.reshape(-1, 4)[::-1].ravel(),
    )  # fmt: skip
    assert _bytes(case.world.contacts(back)) == _bytes(case.world.contacts(states))

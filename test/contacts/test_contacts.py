"""Contacts against brute force: depth, witness, omissions, and independence of irrelevant inputs."""

from __future__ import annotations

import numpy as np
import pytest
from truth.contact_truth import (
    COARSE_SHAPES,
    FRAMES,
    SHAPES,
    ContactTruth,
    Poses,
    assert_true,
    check_all_pairs,
    check_pair,
    pairs_of,
    sample_ids,
)
from worlds.fractured_worlds import SETTINGS, FracturedWorld, fractured_world, tree_of, with_settings
from worlds.gate_world import record_bytes
from worlds.rigid_shapes import noisy_ball

from fracture_collision.records import BUDGET_EXHAUSTED, CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld, PaperSettings
from fracture_collision.world.settings import CHOICES

SEARCHES = [(tree, traversal) for tree in CHOICES["tree"] for traversal in CHOICES["traversal"]]
DEFAULT_SEARCH = SETTINGS.paper[1:]
SHELLS = [("shell", "curved", search) for search in SEARCHES]
CASES = [
    pytest.param((s, c, search), id="-".join((s, c) if search == DEFAULT_SEARCH else (s, c, *search)),
                 marks=() if search == DEFAULT_SEARCH or (s, c, search) in SHELLS else pytest.mark.slow)
    for search in (DEFAULT_SEARCH, *(other for other in SEARCHES if other != DEFAULT_SEARCH))
    for s in COARSE_SHAPES for c in ("flat", "curved")
]  # fmt: skip


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    shape, cracks, (tree, traversal) = request.param
    settings = SETTINGS._replace(paper=PaperSettings("exact", tree, traversal))
    return fractured_world(COARSE_SHAPES[shape](), seeds=5, generations=2, curved=cracks == "curved", settings=settings)


def test_contacts_are_true_and_none_is_missed(case: FracturedWorld) -> None:
    truth = ContactTruth(case)
    for frame in FRAMES.values():
        checks = check_all_pairs(truth, frame(truth, 1))
        assert sum(check.contacts for check in checks) > 0
        assert_true(checks, SETTINGS.penetration_tolerance)


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("cracks", ["flat", "curved"])
@pytest.mark.parametrize("shape", ["torus", "bowl", "l_block", "shell", "bunny"])
def test_contacts_of_concave_bodies_are_true_in_many_frames(shape: str, cracks: str) -> None:
    truth = ContactTruth(fractured_world(SHAPES[shape](), seeds=6, generations=3, curved=cracks == "curved"))
    for frame in FRAMES.values():
        for seed in range(20):
            assert_true(check_all_pairs(truth, frame(truth, seed)), SETTINGS.penetration_tolerance)


def test_the_bound_holds_for_any_limit_of_work(case: FracturedWorld) -> None:
    states = case.states(0.05, seed=2)
    truth, poses = ContactTruth(case), Poses(states)
    for most in (20, 100, 400):
        limited = with_settings(case, case.world.settings._replace(max_work=most))
        answer = limited.contacts(states)
        listed = pairs_of(answer)
        if not answer.status & BUDGET_EXHAUSTED:
            continue
        epsilon = case.world.settings.penetration_tolerance
        for pair in listed:
            check = check_pair(truth, poses, answer, pair, listed, epsilon)
            assert check.deepest_unlisted <= check.bound, (pair, check)
        return
    pytest.fail("no limit was small enough to cut a search short")


@pytest.mark.parametrize("case", SHELLS, indirect=True)
def test_answers_do_not_depend_on_threads_order_or_earlier_steps(case: FracturedWorld) -> None:
    """Nor on states of earlier registries in between."""
    states = case.states(0.05, seed=4)
    reference, digest = record_bytes(case.world.contacts(states)), case.world.fragments().digest
    for threads in (2, 3, 8):
        other = with_settings(case, case.world.settings._replace(threads=threads))
        assert record_bytes(other.contacts(states)) == reference
    case.world.contacts(case.states(0.2, seed=9))
    assert len(case.world.contacts(FragmentStates(1, 0, [1], [[0.0, 0.0, 0.0]], [[0.0, 0.0, 0.0, 1.0]])).gaps) == 0
    assert case.world.fragments().fragment_ids.tolist() == [1]
    back = states._replace(
        fragment_ids=states.fragment_ids[::-1], positions=states.positions.reshape(-1, 3)[::-1],
        orientations=states.orientations.reshape(-1, 4)[::-1],
    )  # fmt: skip
    assert record_bytes(case.world.contacts(back)) == reference
    assert case.world.fragments().digest == digest


def test_a_full_list_does_not_depend_on_tree_or_traversal() -> None:
    """With room for every contact, all searches list the same samples, each in its own order."""
    case = fractured_world(COARSE_SHAPES["bowl"](), seeds=6, generations=3, curved=True)
    states = case.states(0.03, seed=6)
    listed = []
    for tree, traversal in SEARCHES:
        variant = PaperSettings("exact", tree, traversal)
        settings = SETTINGS._replace(paper=variant, contacts_per_pair=100_000, detection_tolerance=0.05)
        answer = with_settings(case, settings).contacts(states)
        by_id = np.argsort(answer.contact_ids)
        listed.append((answer.contact_ids[by_id].tolist(), answer.gaps[by_id].tolist(), answer.fragment_a.tolist()))
    assert len(listed[0][0]) > 500
    assert all(other == listed[0] for other in listed[1:])


@pytest.mark.parametrize("traversal", CHOICES["traversal"])
def test_nodes_are_visited_in_the_order_of_the_traversal(traversal: str) -> None:
    """Every sample of a ball lies within the tolerance of a plane: contacts come in the order of the visits."""
    vertices, triangles = noisy_ball()
    wanted = len(vertices)
    variant = PaperSettings("exact", traversal=traversal)
    world = CollisionWorld(SETTINGS._replace(paper=variant, contacts_per_pair=wanted, detection_tolerance=1.0))
    world.add_body(CollisionBody(1, 1, vertices=vertices.ravel(), triangles=triangles.ravel()))
    world.add_body(CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    answer = world.contacts(FragmentStates(1, 0, np.array([1]), np.array([0, 0, -0.5]), np.array([0.0, 0.0, 0.0, 1.0])))
    tree = tree_of(world.geometry, world._registry.row_of(1))
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
    assert answer.contact_ids.tolist() == sample_ids(1, 2, np.array(samples)).tolist()


def _children(size: np.ndarray, entry: int) -> list[int]:
    children, child = [], entry + 1
    while child < entry + size[entry]:
        children.append(child)
        child += int(size[child])
    return children

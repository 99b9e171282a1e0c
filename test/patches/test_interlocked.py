"""Concave bodies of few triangles that pierce each other, against all their edges and faces."""

from __future__ import annotations

import numpy as np
import pytest
from oracles.pierced_triangles import all_pierced
from scipy.spatial.transform import Rotation
from worlds.gate_world import rigid
from worlds.rigid_shapes import RigidShape
from worlds.sampled_worlds import ForgetfulWorld

from benchmarks.peers.judging.least_translation import least_translation
from benchmarks.random_pairs import triangle_bodies
from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.lookahead.motion import Motion
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.pair import Step
from fracture_collision.core.pair.narrow_phase import Scene
from fracture_collision.core.patches.interlocked import part_interlocked
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.neighbour_lists import NO_SLOTS
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.records import ContactConstraintArray
from fracture_collision.world import CollisionWorld, FragmentStates, Settings

SETTINGS = Settings()


SHAPES = triangle_bodies()


def contacts_of(first: str, second: str, turns: np.ndarray, offset: np.ndarray) -> ContactConstraintArray:
    world = CollisionWorld(SETTINGS)
    for i, name in enumerate((first, second), 1):
        world.add_body(rigid(i, RigidShape(SHAPES[name].vertices, SHAPES[name].faces)))
    return world.contacts(FragmentStates(1, 0, np.array([1, 2]), np.append(np.zeros(3), offset), turns.ravel()))


def placed(name: str, turn: np.ndarray, offset: np.ndarray) -> np.ndarray:
    """Corners (t, 3, 3) of the triangles."""
    return Rotation.from_quat(turn).apply(SHAPES[name].vertices)[SHAPES[name].faces] + offset


def test_a_needle_through_a_plate_has_contacts_along_one_direction() -> None:
    """No corner of either is inside the other."""
    upright = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
    answer = contacts_of("plate", "needle", upright, np.array([0.47, 0.1, 0.05]))
    normals = answer.normals.reshape(-1, 3)
    assert len(normals) >= 2
    # out over the nearest edge of the plate, by the rest of its width and the needle's radius
    assert np.abs(normals - [1.0, 0.0, 0.0]).max() < 0.2
    assert -answer.gaps.min() == pytest.approx(0.04, rel=0.05)


def test_bodies_of_one_direction_are_made_disjoint_by_the_deepest_contact() -> None:
    """A hook that lies 4 mm deep on a plate of 30 mm, at all places of it."""
    for x in np.linspace(-0.3, 0.3, 7):
        turns = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 1.0]])
        answer = contacts_of("plate", "hook", turns, np.array([x, 0.0, 0.1 + 0.015 - 0.004]))
        np.testing.assert_allclose(answer.normals.reshape(-1, 3), [[0.0, 0.0, 1.0]] * len(answer.gaps), atol=1e-12)
        assert len(answer.gaps) >= 4 and answer.gaps.min() == pytest.approx(-0.004, abs=1e-12)
        assert answer.missed_depth_bound[0] == pytest.approx(0.004, rel=1e-3)


def test_the_contacts_of_a_pair_part_it() -> None:
    """Every pair that pierces is listed with a contact or a bound.

    Moved by the least translation that satisfies the contacts, no edge passes through a face: of 99 % of pairs.
    """
    random, names, left = np.random.default_rng(100), list(SHAPES), []
    through = 0
    while through < 150:
        first, second = random.choice(names, 2)
        turns, offset = Rotation.random(2, random_state=random).as_quat(), random.normal(0.0, 0.25, 3)
        a, b = placed(first, turns[0], np.zeros(3)), placed(second, turns[1], offset)
        if not all_pierced(a, b):
            continue
        through += 1
        answer = contacts_of(first, second, turns, offset)
        deepest = max(-answer.gaps.min(initial=0.0), answer.missed_depth_bound.max(initial=0.0))
        assert len(answer.missed_depth_bound) == 1 and deepest > 0.0, (first, second)
        x = least_translation(answer.normals.reshape(-1, 3), -answer.gaps)
        x *= 1.0 + 1e-3 * min(mesh.extents.max() for mesh in (SHAPES[first], SHAPES[second])) / np.linalg.norm(x)
        if all_pierced(a, b + x):
            left.append((first, second))
    assert len(left) <= 0.01 * through, left


def test_what_is_kept_of_a_pair_does_not_change_an_answer() -> None:
    """Two hooks, a torus and a can creep around each other; a world that forgets says the same."""
    names, random = ("hook", "torus", "hook", "can"), np.random.default_rng(3)
    worlds = []
    for kind in (CollisionWorld, ForgetfulWorld):
        world = kind(SETTINGS)
        for i, name in enumerate(names, 1):
            world.add_body(rigid(i, RigidShape(SHAPES[name].vertices, SHAPES[name].faces)))
        worlds.append(world)
    turns = Rotation.random(4, random_state=random)
    places = np.array([(0.0, 0.0, 0.0), (0.35, 0.1, 0.0), (0.1, 0.45, 0.1), (0.3, 0.3, 0.35)])
    pushes, spins = random.normal(0.0, 2e-4, (4, 3)), random.normal(0.0, 2e-4, (4, 3))
    listed = 0
    for step in range(120):
        # faster and faster: lists last long at first, then for no step
        pace = 1.05**step / 20.0
        turns, places = Rotation.from_rotvec(pace * spins) * turns, places + pace * pushes
        states = FragmentStates(step + 1, 0, np.arange(1, 5), places.ravel(), turns.as_quat().ravel())
        kept, fresh = (world.contacts(states) for world in worlds)
        for column in ("fragment_a", "fragment_b", "pair_begin", "gaps", "normals", "points_a", "missed_depth_bound"):
            np.testing.assert_array_equal(getattr(kept, column), getattr(fresh, column), err_msg=f"{column} {step}")
        listed += int((worlds[0]._remembered.slots.lists.close.counts >= 0).sum())
    assert listed > 100


class _Observed(CollisionWorld):
    """Keeps the Scene of its last answer."""

    def _scene(self, step: Step, motion: Motion) -> Scene:
        self.scene = super()._scene(step, motion)
        return self.scene


def test_a_contact_ahead_says_nothing_of_what_pierces_now() -> None:
    """Two hooks reach around each other and are apart; one turns fast, so a contact ahead has a deep gap now."""
    world = _Observed(SETTINGS)
    for i in (1, 2):
        world.add_body(rigid(i, RigidShape(SHAPES["hook"].vertices, SHAPES["hook"].faces)))
    turns = np.array([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0]])
    answer = world.contacts(FragmentStates(1, 0, np.array([1, 2]), np.array([0, 0, 0, 0.45, 0.2, 0.0]), turns.ravel()))
    assert len(answer.gaps) == 0
    scene = world.scene
    assert scene.whole is not None
    point = np.array([[0.2, 0.1, 0.0]])
    found = PairContacts(
        np.array([1]), np.zeros(1), np.zeros(1, np.int64), np.zeros(1, np.uint8), point, point,
        np.array([[-1.0, 0.0, 0.0]]), np.array([-0.15]), np.array([[0, 0]]),
    )  # fmt: skip
    work = NO_SLOTS.lists, np.array([-1]), np.array([0])
    rule = Rule(8, 16, SETTINGS.penetration_tolerance, SETTINGS.detection_tolerance)
    for ahead, changes in ((0, True), (1, False)):
        parted, changed = part_interlocked(
            scene.geometry, scene.whole, (scene.step, scene.motion), work, rule, (found, np.array([ahead])),
            ((make_scratch(0, 0),), Crew(1)),
        )  # fmt: skip
        assert (len(changed) > 0) == changes
        assert np.array_equal(parted.gaps, found.gaps) != changes

"""Memory between steps makes the next step faster but never different: the same bytes without it."""

from __future__ import annotations

import numpy as np
import pytest
from numba import njit
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_messages, with_settings
from worlds.gate_world import assert_same_bytes
from worlds.hard_worlds import tetrahedral_body
from worlds.sampled_worlds import ForgetfulWorld

from fracture_collision.core.memory.pair import Pair
from fracture_collision.core.pair.narrow_phase import NOTHING_REMEMBERED
from fracture_collision.core.search.neighbour_lists import displacement
from fracture_collision.core.separation.oriented_boxes import box_clearance
from fracture_collision.geometry.generators import ball, brick, shell
from fracture_collision.records import BOX, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings

TWINS = (CollisionWorld, Settings(threads=2)), (ForgetfulWorld, Settings(threads=1))
SHAPES = {"ball": (ball(1.0, 0.35), False), "shell": (shell(1.0, 0.8, 0.5), True)}
WALK = 0.0004  # [R] per step: a list lasts about ten steps
JUMP = 0.03  # [R] a step that invalidates every list


def random_turns(random: np.random.Generator, count: int, size: float) -> Rotation:
    """Rotations by about `size`."""
    return Rotation.from_rotvec(random.uniform(-size, size, (count, 3)))


def world_around(case: FracturedWorld, world: CollisionWorld) -> CollisionWorld:
    """The fragments, a rigid box and an unbroken body beside them, on a ground plane."""
    with_messages(world, case)
    other = brick((1.0, 1.0, 0.5), 0.25)
    world.add_body(tetrahedral_body(other, 2000))
    world.add_body(CollisionBody(2001, 2001, primitive=SolidPrimitive(BOX, (0.8, 0.8, 0.4))))
    world.add_body(CollisionBody(2002, 2002, plane=np.array([0.0, 0.0, 1.0, 1.001]), is_static=True))
    return world


@pytest.mark.parametrize(("shape", "contacts_per_pair"), [("shell", 2), ("ball", 8), ("shell", 40)])
def test_answers_with_neighbour_lists_equal_those_of_searches(shape, contacts_per_pair) -> None:
    body, curved = SHAPES[shape]
    case = fractured_world(body, 9, generations=2, curved=curved)
    worlds = [
        world_around(case, kind(settings._replace(contacts_per_pair=contacts_per_pair))) for kind, settings in TWINS
    ]
    random = np.random.default_rng(5)
    ids = np.array([*case.oracle.fragment_ids, 2000, 2001])
    n = len(ids)
    positions = random.uniform(-0.01, 0.01, (n, 3))
    positions[-2:] = (0.0, 0.0, 1.24), (1.38, 0.0, 0.0)
    turns = random_turns(random, n, 0.01)
    visits, listed, kept = np.zeros(2), 0, 0
    for step in range(1, 41):
        size = JUMP if step % 17 == 0 else 0.0 if step % 5 == 0 else WALK
        # some stay in place, and pairs of these keep their contacts
        move = np.flatnonzero(random.random(n) < (1.0 if step % 3 else 0.4))
        positions[move] += random.uniform(-size, size, (len(move), 3))
        if size:
            turns[move] = random_turns(random, len(move), size) * turns[move]
        states = FragmentStates(step, case.generations, ids, positions.ravel(), turns.as_quat().ravel())
        answers = [world.contacts(states) for world in worlds]
        assert_same_bytes(*answers)
        visits += [world.last_visits for world in worlds]
        slots, answer = worlds[0]._remembered
        listed = max(listed, int((slots.lists.counts > 0).sum()))
        kept = max(kept, int((answer.pair_of_slot >= 0).sum()))
        if step % 7 == 0:
            for field in answers[0]:  # callers may overwrite an answer
                if isinstance(field, np.ndarray):
                    field[:] = 7
    assert listed > 10 and kept > 10
    assert visits[0] < visits[1]


def test_a_fracture_and_a_step_back_change_nothing() -> None:
    body, _ = SHAPES["ball"]
    case = fractured_world(body, 6, generations=3)
    listed, searched = (with_messages(kind(settings), case) for kind, settings in TWINS)
    oldest = {0: [1]}
    for event in case.messages[1]:
        living = oldest[event.sequence - 1]
        oldest[event.sequence] = [f for f in living if f != event.fragment_id] + event.new_fragment_ids.tolist()
    # forward, and back to an earlier registry, as when a bag is played twice
    for step, sequence in enumerate([0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 1, 1, 1, 2, 2, 3], 1):
        ids = np.array(oldest[sequence])
        shift = 1e-5 * step * np.outer(np.arange(len(ids)), [1.0, -1.0, 0.5])
        upright = np.tile([0.0, 0.0, 0.0, 1.0], len(ids))
        states = FragmentStates(step, sequence, ids, shift.ravel(), upright)
        assert_same_bytes(listed.contacts(states), searched.contacts(states))


def test_nothing_is_remembered_where_the_work_is_limited() -> None:
    body, _ = SHAPES["ball"]
    case = fractured_world(body, 9)
    world = with_settings(case, Settings(threads=2, max_work=200))
    answers = [world.contacts(case.states(0.005)) for _ in range(4)]
    assert_same_bytes(answers[0], answers[-1])
    assert world._remembered is NOTHING_REMEMBERED


def test_boxes_are_no_nearer_than_their_clearance() -> None:
    """Against the exact distance, by least squares over both boxes."""
    random = np.random.default_rng(4)
    apart = 0
    for _ in range(400):
        low = random.uniform(-1.0, 0.0, (2, 3))
        boxes = np.hstack([low, low + random.uniform(0.05, 1.0, (2, 3))])
        rotation, translation = Rotation.random(random_state=random).as_matrix(), random.uniform(-1.5, 1.5, 3)
        nearest = lsq_linear(
            np.hstack([rotation, -np.eye(3)]), -translation, (boxes[:, :3].ravel(), boxes[:, 3:].ravel()), tol=1e-14
        )
        distance = np.sqrt(2.0 * nearest.cost)
        asked = random.choice([0.0, 0.1])
        clearance = clearance_of(boxes[0], boxes[1], rotation, translation, asked)
        assert clearance <= distance * (1.0 + 1e-6) + 1e-7
        assert clearance == 0.0 or clearance > asked
        apart += clearance > 0.0
    assert 100 < apart < 390


@njit
def clearance_of(box_a, box_b, rotation, translation, distance):
    return box_clearance(box_a, box_b, rotation, translation, distance)


def test_no_point_moves_farther_than_its_bound() -> None:
    case = fractured_world(SHAPES["shell"][0], 5, curved=True)
    a, b = (case.row(f) for f in case.oracle.fragment_ids[:2])
    pools, random = case.geometry.pools, np.random.default_rng(2)
    for size in (1e-4, 1e-2, 1.0, 3.0):
        before, now = (_relative_poses(random, size) for _ in range(2))
        kept = np.array([np.append(turn.ravel(), shift) for turn, shift in zip(*before, strict=True)])
        bound, farthest = displacement(pools, Pair(a, b, *now), kept), 0.0
        for side, f in enumerate((a, b)):
            box = pools.fragment.box[f]
            points = box[:3] + random.random((200, 3)) * (box[3:] - box[:3])
            moved = points @ (now[0][side] - before[0][side]).T + now[1][side] - before[1][side]
            farthest = max(farthest, np.linalg.norm(moved, axis=1).max())
        assert farthest <= bound * (1.0 + 1e-12)
        assert bound < 3.0 * farthest  # the bound is useful


def _relative_poses(random: np.random.Generator, size: float) -> tuple[np.ndarray, np.ndarray]:
    """Rotations (2, 3, 3) and translations (2, 3) from one frame to another and back."""
    rotation = random_turns(random, 1, size)[0].as_matrix()
    translation = random.uniform(-size, size, 3)
    return np.array([rotation, rotation.T]), np.array([translation, -rotation.T @ translation])


def test_lists_do_not_change_what_touches_without_a_detection_tolerance() -> None:
    """A sample exactly on the other's surface is at distance 0: a list searches beyond that, and must not list it."""
    worlds = [kind(settings._replace(detection_tolerance=0.0)) for kind, settings in TWINS]
    for world in worlds:
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 1.0), 0.5), 1))
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 1.0), 0.5), 2))
    random = np.random.default_rng(1)
    ids, upright = np.array([1, 2]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
    for step in range(60):
        # flush at every other step, and beside that a little off
        shift = np.array([0.25, 0.0, 1.0]) + (step % 2) * random.choice([-(2.0**-12), 0.0, 2.0**-12], 3)
        states = FragmentStates(1, 0, ids, np.append(np.zeros(3), shift), upright)
        assert_same_bytes(*(world.contacts(states) for world in worlds))

"""Fragments, a ball and a block that fly at random; where they are later."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.geometry.generators import ball, shell
from fracture_collision.records import (
    BOX,
    SPHERE,
    CollisionBody,
    ContactConstraintArray,
    FragmentStates,
    SolidPrimitive,
)
from fracture_collision.world import CollisionWorld, Settings
from worlds.fractured_worlds import FracturedWorld, fractured_world, with_messages

AHEAD = 0.02  # [s]
SETTINGS = Settings(threads=1, lookahead=AHEAD)
BALL, BLOCK, FLOOR = 3000, 3001, 3002
CASES = ("ball", "shell, curved")


def thrown_case(name: str) -> FracturedWorld:
    """One of CASES, broken; R is 1 m."""
    if name == "ball":
        return fractured_world(ball(1.0, 0.35), 5)
    return fractured_world(shell(1.0, 0.8, 0.35), 5, curved=True)


def with_others(
    case: FracturedWorld, settings: Settings, kind: type[CollisionWorld] = CollisionWorld
) -> CollisionWorld:
    world = with_messages(kind(settings), case)
    world.add_body(CollisionBody(BALL, BALL, primitive=SolidPrimitive(SPHERE, (0.3,)), density=1000.0))
    world.add_body(CollisionBody(BLOCK, BLOCK, primitive=SolidPrimitive(BOX, (0.5, 0.4, 0.3)), density=1000.0))
    world.add_body(CollisionBody(FLOOR, FLOOR, plane=np.array([0.0, 0.0, 1.0, 2.5]), is_static=True))
    return world


def thrown(case: FracturedWorld, seed: int, spin: float) -> FragmentStates:
    """All fragments, a ball and a block, packed closely and moving at random: 4 to 40 % of R in AHEAD."""
    random = np.random.default_rng(seed)
    pieces = case.states(0.0)
    ids = np.append(pieces.fragment_ids, [BALL, BLOCK]).astype(np.uint32)
    n = len(ids)
    centers = np.concatenate([case.world.fragments().centers_of_mass.reshape(-1, 3), np.zeros((2, 3))])
    known = case.world.fragments().fragment_ids.tolist()
    centers = np.array([centers[known.index(i)] if i in known else np.zeros(3) for i in ids.tolist()])
    places = np.concatenate([0.1 * centers[:-2], random.normal(0.0, 1.2, (2, 3))])
    turns = Rotation.from_rotvec(random.normal(0.0, 0.1, (n, 3)))
    linear = random.normal(size=(n, 3))
    linear *= random.uniform(2.0, 20.0, (n, 1)) / np.linalg.norm(linear, axis=1)[:, None]
    return FragmentStates(
        pieces.step + seed, pieces.fracture_sequence, ids, places.ravel(), turns.as_quat().ravel(), linear.ravel(),
        random.normal(0.0, spin, (n, 3)).ravel(),
    )  # fmt: skip


def later(world: CollisionWorld, states: FragmentStates, t: float) -> FragmentStates:
    """The states after `t` [s]: centres of mass move straight, and each body rotates about its own."""
    registry = world.fragments()
    centers = dict(zip(registry.fragment_ids.tolist(), registry.centers_of_mass.reshape(-1, 3), strict=True))
    arms = np.array([centers[i] for i in states.fragment_ids.tolist()])
    turns = Rotation.from_quat(states.orientations.reshape(-1, 4))
    spins = states.angular_velocities.reshape(-1, 3)
    offset = turns.apply(arms)
    linear = states.linear_velocities.reshape(-1, 3) + np.cross(spins, offset)
    after = Rotation.from_rotvec(spins * t) * turns
    places = states.positions.reshape(-1, 3) + offset + t * linear - after.apply(arms)
    return states._replace(positions=places.ravel(), orientations=after.as_quat().ravel())


def rows_of(answer: ContactConstraintArray) -> dict[tuple[int, int], slice]:
    pairs = zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)
    begin = answer.pair_begin.tolist()
    return {pair: slice(begin[k], begin[k + 1]) for k, pair in enumerate(pairs) if begin[k + 1] > begin[k]}

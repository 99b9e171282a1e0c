"""Piles of fragments: many copies of one broken body, dropped into a box by Bullet until they come to rest.

Dropped, because a query's time depends on the number of neighbours and on how deep they overlap: fragments placed at
random in a box with a slight overlap meet in corners, fragments at rest meet in faces. The hulls that Bullet drops are
coarse, so that thousands fall in a minute; with flat cracks, whose fragments are convex, they almost equal them.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pybullet
from scipy.spatial.transform import Rotation

from benchmarks.peers.worlds import DENSITY, EDGES, World, empty_states, hull_points, make_world, volume
from fracture_collision.geometry.generators import geodesic_sphere
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

# The reference sphere of Glondu et al. 2014, Fig. 11 (5,212 nodes), in 20 pieces with flat cracks.
BODY = "ball20"
SPREAD = 1.15  # initial distance of a body's pieces from its centre, relative to their original distance
SPACING = 2.4  # [R] between the bodies' centres at the start
TIME_STEP = 1.0 / 100.0  # [s]
STEPS = 160  # the longest fall ends before step 100
MARGIN = 0.002  # [R] by which Bullet keeps hulls apart; its default, 0.04, would leave hardly a pair in contact
# All lengths of the resting pile are scaled by this factor, so that fragments in contact overlap by some thousandths
# of R, as in a simulation, and do not stay apart by Bullet's margin.
PRESSED = 0.99
DIRECTIONS = geodesic_sphere(3)[0]  # in which a coarse hull is exact


class Pile(NamedTuple):
    bodies: list[CollisionBody]
    events: list[FractureEvent]
    states: FragmentStates


def broken_body() -> World:
    """The same body, and so the same piles, whether or not the other libraries are installed."""
    return make_world(BODY, EDGES)


def copy_of(source: World, k: int) -> tuple[CollisionBody, FractureEvent]:
    """The k-th copy, k = 0, 1 ..., with ids of its own; its fracture is the (k + 1)-th event."""
    ids = _first_id(source, k) + 1 + np.arange(len(source.event.new_fragment_ids))
    body = source.body._replace(body_id=k + 1, fragment_id=_first_id(source, k))
    return body, source.event._replace(
        sequence=k + 1, body_id=k + 1, fragment_id=body.fragment_id, new_fragment_ids=ids.astype(np.uint32)
    )


def _first_id(source: World, k: int) -> int:
    return 1 + k * (1 + len(source.event.new_fragment_ids))


def world_of(pile: Pile, settings: Settings) -> CollisionWorld:
    """A world with all bodies and fractures applied."""
    world = CollisionWorld(settings)
    for body in pile.bodies:
        world.add_body(body)
    for event in pile.events:
        world.add_fracture(event)
    world.contacts(empty_states(len(pile.events)))
    return world


def make_pile(source: World, count: int, seed: int = 1, pressed: float = PRESSED) -> Pile:
    """`count` fragments of as many copies of `source` as needed; the last copy's others take no part.

    pressed: see PRESSED; a smaller value makes more contacts.
    """
    copies = math.ceil(count / len(source.fragments))
    bodies, events = zip(*(copy_of(source, k) for k in range(copies)), strict=True)
    ids = np.concatenate([event.new_fragment_ids for event in events])[:count]
    centres = np.tile([f.centre for f in source.fragments], (copies, 1))[:count]
    positions, rotations = _dropped(source, count, np.random.default_rng(seed))
    origins = pressed * positions - rotations.apply(centres)
    states = FragmentStates(1, copies, ids, origins.ravel(), rotations.as_quat().ravel())
    return Pile(list(bodies), list(events), states)


def _dropped(source: World, count: int, random: np.random.Generator) -> tuple[np.ndarray, Rotation]:
    """Centres (count, 3) [m] and orientations of the fragments at rest."""
    copies = math.ceil(count / len(source.fragments))
    across = math.ceil(copies ** (1 / 3))
    client = pybullet.connect(pybullet.DIRECT)
    pybullet.setPhysicsEngineParameter(fixedTimeStep=TIME_STEP, deterministicOverlappingPairs=1, physicsClientId=client)
    pybullet.setGravity(0.0, 0.0, -9.81, physicsClientId=client)
    _box(across * SPACING, client)
    fragments = [(_coarse_hull(f.mesh, client), DENSITY * volume(f.mesh), f.centre) for f in source.fragments]
    turns = Rotation.random(copies, random_state=random)
    bodies = []
    for k in range(copies):
        cell = np.array([k % across, k // across % across, k // across**2])
        middle = SPACING * (cell + [0.5 - 0.5 * across, 0.5 - 0.5 * across, 0.5])
        for shape, mass, centre in fragments[: count - len(bodies)]:
            start = middle + SPREAD * turns[k].apply(centre)
            body = pybullet.createMultiBody(
                mass, shape, -1, start.tolist(), turns[k].as_quat().tolist(), physicsClientId=client
            )
            pybullet.changeDynamics(body, -1, collisionMargin=MARGIN, physicsClientId=client)
            bodies.append(body)
    for _ in range(STEPS):
        pybullet.stepSimulation(physicsClientId=client)
    poses = [pybullet.getBasePositionAndOrientation(b, physicsClientId=client) for b in bodies]
    pybullet.disconnect(physicsClientId=client)
    return np.array([p for p, _ in poses]), Rotation.from_quat([q for _, q in poses])


def _box(side: float, client: int) -> None:
    """A floor at z = 0 and four walls, `side` [m] apart."""
    for normal in ((0, 0, 1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)):
        shape = pybullet.createCollisionShape(pybullet.GEOM_PLANE, planeNormal=normal, physicsClientId=client)
        position = -0.5 * side * np.array(normal) * (normal[2] == 0)
        pybullet.createMultiBody(0.0, shape, basePosition=position.tolist(), physicsClientId=client)


def _coarse_hull(mesh, client: int) -> int:
    points = hull_points(mesh)
    chosen = points[np.unique((points @ DIRECTIONS.T).argmax(axis=0))]
    return pybullet.createCollisionShape(pybullet.GEOM_MESH, vertices=chosen.tolist(), physicsClientId=client)

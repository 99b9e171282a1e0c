"""Load every kernel of the service: from numba's cache in a second, by compiling in a minute or two.

Runs one small scene with all kinds of shapes, a fracture, and every query.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fracture_collision import world as service
from fracture_collision.geometry.generators import TetGeometry, brick, l_block
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.records import BOX, SPHERE, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world.settings import Settings

BAR = brick((1.0, 0.5, 0.5), 0.5)


def compile_kernels(progress: Callable[[str], None]) -> None:
    """Run the small scene; `progress` is called with a description before each stage.

    What `method: glondu2014` needs is compiled where it is first used.
    """
    progress("bodies: mesh preprocess, samples (1 of 3)")
    world = _of_all_shapes()
    progress("contacts: broad phase, search, exact field (2 of 3)")
    world.contacts(_states(1, 0, np.array([1, 2, 7])))
    progress("fracture: crack polygons, samples, masses (3 of 3)")
    _break(world)
    for step in (2, 3, 4):  # full search, lists built, query through the lists
        world.contacts(_states(step, 2, np.array([2, 5, 7, 8, 9])))
    world.change_settings(world.settings._replace(lookahead=0.01))
    for step in (5, 6):
        world.contacts(_states(step, 2, np.array([2, 5, 7, 8, 9])))
    world.change_settings(world.settings._replace(lookahead=0.0))
    world.contacts(_states(7, 2, np.array([2, 5, 7, 8, 9, 10])))  # the last is concave, and deep in others
    world.fragments()
    world.fragment_mesh(5)
    world.geometry.keep_only(np.arange(3))  # the garbage collection; this world ends here


def compile_contacts(progress: Callable[[str], None]) -> None:
    """The part of compile_kernels that has most of them, without fractures."""
    progress("contacts")
    world, ids = _of_all_shapes(), np.array([1, 2, 7, 10])
    for step, lookahead in ((1, 0.0), (2, 0.0), (3, 0.01)):
        world.change_settings(world.settings._replace(lookahead=lookahead))
        world.contacts(_states(step, 0, ids))


def compile_fractures(progress: Callable[[str], None]) -> None:
    """The other part: fractures, and what a fracture is told."""
    progress("fractures")
    world = service.CollisionWorld(Settings(threads=2))
    world.add_body(_tetrahedral_body(1, BAR))
    _break(world)
    world.fragments()
    world.fragment_mesh(5)
    world.geometry.keep_only(np.arange(1))


def _of_all_shapes() -> service.CollisionWorld:
    # a fracture with the averaged field uses all kernels of the exact field, and more
    world = service.CollisionWorld(Settings(threads=2))
    world.add_body(_tetrahedral_body(1, BAR))
    world.add_body(_tetrahedral_body(10, l_block((1.0, 1.0, 0.5), (0.5, 0.5), 0.5)))
    world.add_body(CollisionBody(2, 2, primitive=SolidPrimitive(SPHERE, (0.3,))))
    world.add_body(CollisionBody(3, 3, primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)), is_static=True))
    world.add_body(CollisionBody(4, 4, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    world.add_body(_wedge(5, 7))
    return world


def _break(world: service.CollisionWorld) -> None:
    """Break body 1 twice; the second crack meets the first: tetrahedra shared by three fragments."""
    world.add_fracture(_flat_crack(BAR, 1, 1, np.ones(len(BAR.vertices), dtype=bool), 0, 0.1, (5, 6)))
    world.add_fracture(_flat_crack(BAR, 2, 6, BAR.vertices[:, 0] > 0.1, 1, 0.05, (8, 9)))


def compile_inspection_kernels() -> None:
    """Load the kernels of the inspection views, which the service itself never loads."""
    from fracture_collision.world.inspection import field_on_plane

    world = service.CollisionWorld(Settings(threads=1))
    world.add_body(_tetrahedral_body(1, BAR))
    field_on_plane(world, world.present(_states(1, 0, np.array([1]))), 1, 0.0, finest=2)


def _tetrahedral_body(number: int, geometry: TetGeometry) -> CollisionBody:
    return CollisionBody(number, number, vertices=geometry.vertices, tetrahedra=geometry.tetrahedra)


def _wedge(body_id: int, fragment_id: int) -> CollisionBody:
    """A rigid body of triangles alone."""
    vertices = np.array([0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.4, 0.0, 0.0, 0.0, 0.4])
    triangles = np.array([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    return CollisionBody(body_id, fragment_id, vertices=vertices, triangles=triangles)


def _states(step: int, sequence: int, ids: np.ndarray) -> FragmentStates:
    count = len(ids)
    # all but the first move a little from step to step: equal states would not be searched again
    moved = np.where(np.arange(count) > 0, 1e-4 * step, 0.0)
    positions = np.column_stack([np.linspace(0.0, 0.1, count), moved, np.full(count, 0.2)])
    return FragmentStates(step, sequence, ids, positions, np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)))


def _flat_crack(
    body: TetGeometry,
    sequence: int,
    fragment_id: int,
    own: np.ndarray,
    axis: int,
    offset: float,
    new_ids: tuple[int, int],
) -> FractureEvent:
    """A crack across an axis, off the nodes; `own` (n,) marks the nodes of the fragment that breaks."""
    side = body.vertices[:, axis] > offset
    edges = unique_edges(body.tetrahedra)
    edges = edges[own[edges].all(axis=1) & (side[edges[:, 0]] != side[edges[:, 1]])]
    towards = np.where(side[edges[:, 1]], 1.0, -1.0)
    planes = np.zeros((len(edges), 4))
    planes[:, axis], planes[:, 3] = towards, towards * offset
    nodes = np.flatnonzero(own)
    return FractureEvent(
        sequence, 1, fragment_id, np.array(new_ids), nodes, side[nodes].astype(np.int64), edges, planes
    )

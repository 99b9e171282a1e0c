"""Cavities of a closed surface: the gate's verdict against solid angles, and the cost of many cavities."""

from __future__ import annotations

from time import process_time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds.gate_world import rigid
from worlds.rigid_shapes import RigidShape, cube, noisy_ball, together, winding_number

from fracture_collision.core.mesh.ray_crossings import windings_of_others
from fracture_collision.world import CollisionWorld, InvalidMessage
from fracture_collision.world.gates.surface_gate import check_surface

TETRAHEDRON = RigidShape(
    np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def cavity(shape: RigidShape, size: float, at: np.ndarray) -> RigidShape:
    return RigidShape(size * shape.vertices + at, shape.triangles[:, ::-1])


def accepts(shape: RigidShape) -> bool:
    try:
        CollisionWorld().add_body(rigid(1, shape))
    except InvalidMessage as error:
        assert error.kind == "bad_mesh", error
        return False
    return True


def pieces_of(*shapes: RigidShape) -> np.ndarray:
    return np.repeat(np.arange(len(shapes)), [len(shape.triangles) for shape in shapes])


def test_windings_in_line_with_corners_and_edges() -> None:
    """A lattice of cavities whose corners line up with each other along axes and diagonals."""
    cube_of = cube()
    at = np.stack(np.meshgrid(*[np.arange(5) / 5.0 - 0.4] * 3), axis=-1).reshape(-1, 3)
    shapes = cube_of, *(cavity(cube_of, 0.1, x) for x in at)
    whole, piece = together(*shapes), pieces_of(*shapes)
    corners = whole.corners
    first = np.unique(piece, return_index=True)[1]
    found = windings_of_others(corners, piece, corners[first, 0], np.arange(len(shapes)))
    assert found.tolist() == [0] + [1] * len(at)
    assert accepts(whole)


def test_verdicts_equal_those_of_solid_angles() -> None:
    random, verdicts = np.random.default_rng(5), []
    outer = noisy_ball()
    for _ in range(40):
        at = random.uniform(-0.9, 0.9, (2, 3))
        inner = [cavity(TETRAHEDRON, 0.05, x) for x in at]
        shapes = outer, *inner
        points = np.array([shape.corners[0, 0] for shape in inner])
        around = [winding_number(together(outer, inner[1 - k]).corners, points[k][None])[0] for k in range(2)]
        verdicts.append(accepts(together(*shapes)))
        assert verdicts[-1] == all(0.5 < w < 1.5 for w in around)
    assert 5 < sum(verdicts) < 35


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(4, 12), st.integers(4, 30))
def test_random_triangles_are_rejected(seed: int, vertices: int, triangles: int) -> None:
    random = np.random.default_rng(seed)
    soup = RigidShape(random.normal(size=(vertices, 3)), random.integers(0, vertices, (triangles, 3)))
    assert not accepts(soup)


def test_the_cost_of_a_cavity_does_not_grow_with_their_number() -> None:
    """Comparing all pairs took 9 s of processor time, casting rays 0.03 s."""
    at = np.stack(np.meshgrid(*[np.arange(15) / 15.0 - 0.48] * 3), axis=-1).reshape(-1, 3)[:3000]
    sizes = np.random.default_rng(1).uniform(0.02, 0.04, len(at))
    shapes = [cube(), *(cavity(TETRAHEDRON, size, x) for size, x in zip(sizes, at, strict=True))]
    shape, nested = together(*shapes), together(*shapes, cavity(TETRAHEDRON, 0.003, at[-1] + 0.002))
    check_surface(*cube())  # loads kernels
    begun = process_time()
    check_surface(shape.vertices, shape.triangles)
    with pytest.raises(InvalidMessage, match="triangle 12012 is inside out and no cavity"):
        check_surface(nested.vertices, nested.triangles)
    assert process_time() - begun < 2.0

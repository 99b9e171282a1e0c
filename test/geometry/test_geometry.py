"""Generated and meshed bodies: volumes, topology, orientation, conformity, quality, determinism."""

from __future__ import annotations

import builtins
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from worlds import rigid_shapes

from fracture_collision.geometry.generators import (
    TetGeometry,
    ball,
    bowl,
    brick,
    l_block,
    piggy_bank,
    plate,
    shell,
    torus,
)
from fracture_collision.geometry.sampled_bodies import sampled_ball, sampled_shell
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.geometry.surface_files import tetrahedralize_surface
from fracture_collision.geometry.tetrahedra import (
    EDGE_VERTICES,
    boundary_triangles,
    face_neighbours,
    tetrahedron_edges,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.geometry.vase import PROFILE, vase

SHAPES = {
    "ball": lambda h: ball(0.05, 0.05 * h),
    "shell": lambda h: shell(0.1, 0.08, 0.1 * h),
    "brick": lambda h: brick((0.2, 0.1, 0.05), 0.1 * h),
    "plate": lambda h: plate(0.25, 0.006, 0.125 * h, 0.02),
    "flat plate": lambda h: plate(0.25, 0.03, 0.125 * h, 0.0, layers=1),
    "bowl": lambda h: bowl(0.2, 0.006, 0.1 * h, 0.06),
    "hemispherical bowl": lambda h: bowl(0.2, 0.02, 0.1 * h, 0.1),
    "torus": lambda h: torus(0.1, 0.04, 0.1 * h),
    "l_block": lambda h: l_block((0.2, 0.15, 0.06), (0.13, 0.07), 0.1 * h),
}
# Of two closed surfaces, without and with a handle; of one without: 2.
EULER_CHARACTERISTIC = {"shell": 4, "torus": 0, "piggy_bank": 4, "sampled_shell": 4}
every_shape = pytest.mark.parametrize("name", SHAPES)
PIG = LENGTH, PIG_WALL, _ = 0.25, 0.01, 0.0085
VASE = HEIGHT, WALL, _ = 0.3, 0.008, 0.015
# What has walls and bumps of its own, or no edge length.
OTHERS = {
    "piggy_bank": lambda: piggy_bank(*PIG),
    "vase": lambda: vase(*VASE),
    "vase of one layer": lambda: vase(1.0, 0.05, 0.1, 1),
    "vase of three layers": lambda: vase(0.1, 0.001, 0.004, 3),
    "sampled_ball": lambda: sampled_ball(1.0, 4, 100),
    "sampled_shell": lambda: sampled_shell(1.0, 0.85, 10, 7, 4000),
    "bunny": bunny,
}


def euler_characteristic(triangles: np.ndarray) -> int:
    edges = np.unique(np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0)
    return len(np.unique(triangles)) - len(edges) + len(triangles)


def assert_valid(mesh: TetGeometry) -> None:
    assert mesh.vertices.dtype == np.float64 and mesh.vertices.flags.c_contiguous
    assert mesh.tetrahedra.dtype == np.int32 and mesh.tetrahedra.flags.c_contiguous
    assert np.array_equal(np.unique(mesh.tetrahedra), np.arange(len(mesh.vertices)))
    assert tetrahedron_volumes(*mesh).min() > 0.0
    # Conforming: no two vertices at one place, no face shared by three (raises), and the boundary closed without any
    # vertex of it inside one of its triangles' edges, which a hanging node would leave open.
    assert len(np.unique(np.round(mesh.vertices, 12), axis=0)) == len(mesh.vertices)
    triangles = boundary_triangles(mesh.tetrahedra)
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    assert {tuple(e) for e in directed} == {(b, a) for a, b in directed}
    # Outward and watertight: the divergence theorem gives the volume of the tetrahedra.
    a, b, c = (mesh.vertices[triangles[:, i]] for i in range(3))
    enclosed = np.einsum("ij,ij->", np.cross(a, b), c) / 6.0
    assert enclosed == pytest.approx(tetrahedron_volumes(*mesh).sum(), rel=1e-12)


@every_shape
@pytest.mark.parametrize("relative_edge", [0.5, 0.13])
def test_mesh_is_valid(name: str, relative_edge: float) -> None:
    mesh = SHAPES[name](relative_edge)
    assert_valid(mesh)
    assert euler_characteristic(boundary_triangles(mesh.tetrahedra)) == EULER_CHARACTERISTIC.get(name, 2)
    if relative_edge < 0.5:
        assert_no_slivers(mesh)


def assert_no_slivers(mesh: TetGeometry) -> None:
    edges = unique_edges(mesh.tetrahedra)
    length = np.linalg.norm(mesh.vertices[edges[:, 0]] - mesh.vertices[edges[:, 1]], axis=1)
    longest = length[tetrahedron_edges(mesh.tetrahedra, edges)].max(axis=1)
    regular = 6.0 * np.sqrt(2.0) * tetrahedron_volumes(*mesh) / longest**3
    assert regular.min() > 0.05  # 1 for a regular tetrahedron; a third of a thin plate's prism is the flattest


@pytest.mark.parametrize("name", OTHERS)
def test_other_meshes_are_valid_and_equal_arguments_give_equal_bytes(name: str) -> None:
    mesh, again = OTHERS[name](), OTHERS[name]()
    assert_valid(mesh)
    assert euler_characteristic(boundary_triangles(mesh.tetrahedra)) == EULER_CHARACTERISTIC.get(name, 2)
    assert mesh.vertices.tobytes() == again.vertices.tobytes()
    assert mesh.tetrahedra.tobytes() == again.tetrahedra.tobytes()


BOWL_OUTER = (0.1**2 + 0.06**2) / 0.12
CLOSED_FORM = {
    "ball": 4.0 / 3.0 * np.pi * 0.05**3,
    "shell": 4.0 / 3.0 * np.pi * (0.1**3 - 0.08**3),
    "brick": 0.2 * 0.1 * 0.05,
    "plate": np.pi * 0.125**2 * 0.006,  # thickness is measured along z
    "flat plate": np.pi * 0.125**2 * 0.03,
    # a spherical sector of the cap's opening angle between the two spheres
    "bowl": 2.0 * np.pi / 3.0 * (BOWL_OUTER**3 - (BOWL_OUTER - 0.006) ** 3) * 0.06 / BOWL_OUTER,
    "hemispherical bowl": 2.0 * np.pi / 3.0 * (0.1**3 - 0.08**3),
    "torus": 2.0 * np.pi**2 * 0.1 * 0.04**2,
    "l_block": (0.2 * 0.15 - 0.13 * 0.07) * 0.06,
}


@every_shape
def test_volume_converges_to_the_closed_form(name: str) -> None:
    errors = [abs(tetrahedron_volumes(*SHAPES[name](h)).sum() / CLOSED_FORM[name] - 1.0) for h in (0.2, 0.1, 0.05)]
    if name in ("brick", "l_block"):
        assert max(errors) < 1e-12
        return
    # second order in the edge length: each halving leaves about a quarter
    assert errors[2] < 0.02
    assert errors[1] < 0.35 * errors[0] and errors[2] < 0.35 * errors[1]


def test_the_stored_bunny_has_its_size() -> None:
    mesh = bunny(0.2)
    assert 1500 <= len(mesh.vertices) <= 2500
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    assert (high - low).max() == pytest.approx(0.2, rel=1e-12) and np.allclose(low, -high, atol=1e-15)
    # of the surface it was made from: volume 0.83235 where the longest side is 1.97467
    assert tetrahedron_volumes(*bunny(1.974674)).sum() == pytest.approx(0.832353, rel=2e-3)


@pytest.fixture(scope="module")
def pig() -> TetGeometry:
    return piggy_bank(*PIG)


def test_a_piggy_bank_stands_on_four_legs_and_is_symmetric(pig: TetGeometry) -> None:
    points = pig.vertices.reshape(3, -1, 3)[2]  # the outermost layer
    low = points[points[:, 2] < points[:, 2].min() + 0.004]
    quadrants = {(x > 0.0, y > 0.0) for x, y, _ in low}
    assert len(quadrants) == 4
    # legs, ears, snout and tail extend beyond the belly
    belly = points[np.abs(points[:, 0]) < 0.01]
    assert points[:, 2].min() < belly[:, 2].min() - 0.01
    assert np.ptp(points[:, 1]) == pytest.approx(2.0 * points[:, 1].max(), rel=0.02)


def test_the_wall_has_its_thickness_away_from_bumps(pig: TetGeometry) -> None:
    layers = pig.vertices.reshape(3, -1, 3)
    thickness = np.linalg.norm(layers[2] - layers[0], axis=1)
    assert thickness.min() == pytest.approx(PIG_WALL, rel=0.1)
    assert np.mean(thickness < 1.3 * PIG_WALL) > 0.3


def test_a_vase_stands_and_has_its_size() -> None:
    points = vase(*VASE).vertices
    low, high = points.min(axis=0), points.max(axis=0)
    assert low[2] == pytest.approx(0.0, abs=1e-12) and high[2] == pytest.approx(HEIGHT, rel=0.01)
    standing = points[points[:, 2] < 1e-9]
    assert np.hypot(*standing[:, :2].T).max() > 0.08 * HEIGHT, "a foot, not a point"
    widest = 2.0 * PROFILE[:, 0].max() * (HEIGHT - WALL) + WALL
    assert high[0] - low[0] == pytest.approx(widest, rel=0.02)


def test_the_volume_of_a_vase_is_that_of_a_thin_wall() -> None:
    """Pappus: the wall's middle line turned about the axis, times the wall. The polygon of 36 corners lacks 0.5 %."""
    mesh = vase(*VASE)
    r, z = (PROFILE * (HEIGHT - WALL)).T
    area = (2.0 * np.pi * 0.5 * (r[1:] + r[:-1]) * np.hypot(np.diff(r), np.diff(z))).sum()
    volume = tetrahedron_volumes(mesh.vertices, mesh.tetrahedra).sum()
    assert volume == pytest.approx(area * WALL, rel=0.02)


@pytest.mark.parametrize(
    ("words", "make"),
    [
        ("radius: -1.0", lambda: ball(-1.0, 0.1)),
        ("edge_length: nan", lambda: ball(1.0, float("nan"))),
        ("tetrahedra, more than", lambda: ball(1.0, 1e-4)),
        ("tetrahedra, more than", lambda: brick((1.0, 1.0, 1.0), 1e-9)),
        ("inner_radius: 2.0 m is not below", lambda: shell(1.0, 2.0, 0.1)),
        ("needs three lengths", lambda: brick((1.0, 2.0), 0.1)),
        ("z: 0.0 is not", lambda: brick((1.0, 2.0, 0.0), 0.1)),
        ("rim_height", lambda: plate(0.2, 0.01, 0.02, -0.01)),
        ("layers: 0", lambda: plate(0.2, 0.01, 0.02, 0.01, layers=0)),
        ("a hemisphere", lambda: bowl(0.2, 0.01, 0.02, 0.11)),
        ("no hollow", lambda: bowl(0.2, 0.1, 0.02, 0.1)),
        ("no hole is left", lambda: torus(0.1, 0.1, 0.02)),
        ("leaves nothing", lambda: l_block((0.2, 0.1, 0.1), (0.1, 0.1), 0.02)),
        ("needs two lengths", lambda: l_block((0.2, 0.1, 0.1), (0.1, 0.1, 0.1), 0.02)),
        ("longest_side: 0.0", lambda: bunny(0.0)),
        ("length: 0.0 is not a positive length", lambda: piggy_bank(0.0, 0.01, 0.01)),
        ("wall: 0.1 m leaves no hollow", lambda: piggy_bank(0.25, 0.1, 0.01)),
        ("edge_length", lambda: piggy_bank(0.25, 0.01, float("nan"))),
        ("more than", lambda: piggy_bank(0.25, 0.01, 1e-6)),
        ("layers: 0 is not at least 1", lambda: piggy_bank(0.25, 0.01, 0.01, 0)),
        ("height: 0.0 is not a positive length", lambda: vase(0.0, 0.008, 0.015)),
        ("wall: 0.02 m leaves no hollow", lambda: vase(0.3, 0.02, 0.015)),
        ("layers: 0 is not at least 1", lambda: vase(0.3, 0.008, 0.015, 0)),
        ("edge_length: gives", lambda: vase(0.3, 0.008, 1e-5)),
        ("inner_radius", lambda: sampled_shell(1.0, 1.0, 4, 4, 10)),
        ("radius", lambda: sampled_ball(-1.0, 4, 10)),
    ],
)
def test_invalid_arguments_are_rejected_with_an_explanation(words: str, make) -> None:
    with pytest.raises(ValueError, match=words):
        make()


def test_connectivity_of_a_small_mesh_against_brute_force() -> None:
    mesh = ball(1.0, 0.4)
    tets = mesh.tetrahedra
    edges = unique_edges(tets)
    assert edges.dtype == np.int32
    expected = sorted({tuple(sorted((int(t[i]), int(t[j])))) for t in tets for i, j in EDGE_VERTICES})
    assert [tuple(e) for e in edges.tolist()] == expected
    rows = tetrahedron_edges(tets, edges)
    assert np.array_equal(edges[rows], np.sort(tets[:, EDGE_VERTICES], axis=2))
    neighbours = face_neighbours(tets)
    faces = {}
    for t, tet in enumerate(tets):
        for i in range(4):
            faces.setdefault(frozenset(np.delete(tet, i).tolist()), []).append(t)
    for t, tet in enumerate(tets):
        for i in range(4):
            others = [o for o in faces[frozenset(np.delete(tet, i).tolist())] if o != t]
            assert neighbours[t, i] == (others[0] if others else -1)
    with pytest.raises(ValueError, match="not among them"):
        tetrahedron_edges(tets, edges[1:])
    with pytest.raises(ValueError, match="more than two"):
        face_neighbours(np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 1, 2, 5]]))


TORUS = rigid_shapes.torus(0.1, 0.04, 32, 16)


def test_any_closed_surface_through_the_mesher(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pytetwild", exc_type=ModuleNotFoundError)
    a, b, c = (TORUS.corners[:, i] for i in range(3))
    enclosed = np.einsum("ij,ij->", np.cross(a, b), c) / 6.0
    monkeypatch.chdir(tmp_path)
    mesh = tetrahedralize_surface(*TORUS, 0.03)
    assert not list(tmp_path.iterdir())
    assert_valid(mesh)
    assert euler_characteristic(boundary_triangles(mesh.tetrahedra)) == 0
    assert tetrahedron_volumes(*mesh).sum() == pytest.approx(enclosed, rel=0.01)
    to_the_ring = np.linalg.norm(mesh.vertices[:, :2], axis=1) - 0.1
    assert np.hypot(to_the_ring, mesh.vertices[:, 2]).max() < 0.04 + 1e-3 * np.linalg.norm([0.28, 0.28, 0.08])


def test_surfaces_without_volume_are_rejected() -> None:
    vertices, triangles = TORUS
    with pytest.raises(ValueError, match="holes .* 3 edges lack"):
        tetrahedralize_surface(vertices, triangles[1:], 0.03)
    with pytest.raises(ValueError, match="clockwise"):
        tetrahedralize_surface(vertices, triangles[:, ::-1], 0.03)
    with pytest.raises(ValueError, match="index 600"):
        tetrahedralize_surface(vertices, np.vstack((triangles, [[0, 1, 600]])), 0.03)


def test_a_missing_mesher_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    import_module = builtins.__import__

    def without_mesher(name: str, *args, **kwargs):
        if name == "pytetwild":
            raise ModuleNotFoundError("No module named 'pytetwild'", name=name)
        return import_module(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without_mesher)
    with pytest.raises(ModuleNotFoundError, match="pip install"):
        tetrahedralize_surface(*TORUS, 0.03)


@settings(deadline=None)  # the first compiles
@given(arrays(np.float32, st.tuples(st.integers(0, 40), st.integers(1, 4)), elements=st.sampled_from([-1, -0.0, 0, 3])))
def test_unique_rows_equal_those_of_numpy(rows: np.ndarray) -> None:
    chosen, kind = unique_rows(rows)
    expected, inverse = np.unique(rows + 0.0, axis=0, return_inverse=True)  # + 0.0: one zero
    assert np.array_equal(np.sort(chosen), chosen) and len(chosen) == len(expected)
    of_numpy = inverse.ravel()[chosen]  # numpy's number of each kind
    assert np.array_equal(rows[chosen], expected[of_numpy])
    assert np.array_equal(of_numpy[kind], inverse.ravel())
    assert all(first == np.flatnonzero(kind == number)[0] for number, first in enumerate(chosen))

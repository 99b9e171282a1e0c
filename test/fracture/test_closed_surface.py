"""Published fragment surfaces: closed, oriented, of the fragment's volume; the package's own readers accept them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from worlds.fractured_worlds import DENSITY, fractured_world

from fracture_collision.fracture import planes
from fracture_collision.geometry.generators import ball, bowl, brick, l_block, piggy_bank, plate, shell, torus
from fracture_collision.geometry.sampled_bodies import sampled_ball, sampled_shell
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.geometry.surface_files import read_surface
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.geometry.vase import vase
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.simulation.config.shapes import MESHES
from fracture_collision.viewer.pictures.body_mesh import mesh_of_fragment
from fracture_collision.viewer.pictures.gltf import glb_of_mesh
from fracture_collision.viewer.pictures.palette import Paint
from fracture_collision.world import CollisionWorld

BODIES = {
    "ball": ball(0.1, 0.03),
    "shell": shell(0.1, 0.08, 0.03),
    "brick": brick((0.2, 0.1, 0.06), 0.03),
    "plate": plate(0.25, 0.008, 0.02, 0.018),
    "bowl": bowl(0.2, 0.01, 0.02, 0.06),
    "torus": torus(0.1, 0.04, 0.02),
    "l_block": l_block((0.2, 0.2, 0.05), (0.1, 0.1), 0.03),
    "sampled_ball": sampled_ball(0.1, 4, 200),
    "sampled_shell": sampled_shell(0.1, 0.08, 8, 6, 900),
    "bunny": bunny(),
    "piggy_bank": piggy_bank(0.2, 0.01, 0.02),
    "vase": vase(0.2, 0.008, 0.02),
}
LENGTH_ERROR = 1e-6  # of the body's longest side: single precision, and triangles thinner than this
READ_BACK = 3  # fragments a body
WHITE = Paint((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), 0.0)


def surface_of(world: CollisionWorld, fragment_id: int) -> tuple[trimesh.Trimesh, np.ndarray]:
    """As published, nothing merged; which triangles are on cracks."""
    mesh = world.fragment_mesh(fragment_id)
    vertices = mesh.vertices.reshape(-1, 3).astype(float)
    return trimesh.Trimesh(vertices, mesh.triangles.reshape(-1, 3), process=False), mesh.is_crack


def masses_of(world: CollisionWorld, events: int) -> dict[int, float]:
    world.contacts(FragmentStates(9, events, [], [], []))
    registry = world.fragments()
    return dict(zip(registry.fragment_ids.tolist(), registry.masses.tolist(), strict=True))


def test_every_shape_of_scenes_is_among_the_bodies() -> None:
    assert set(MESHES) == {*BODIES, "stored_mesh"}


@pytest.mark.parametrize("curved", [False, True], ids=["flat", "curved"])
@pytest.mark.parametrize("shape", BODIES)
def test_surfaces_are_closed_and_read_back(shape: str, curved: bool, tmp_path: Path) -> None:
    body = BODIES[shape]
    broken = fractured_world(body, 7, generations=2, curved=curved)
    size, outside = float(np.ptp(body.vertices, axis=0).max()), 0.0
    masses = masses_of(broken.world, 2)
    assert len(masses) > 7
    for count, (fragment_id, mass) in enumerate(masses.items()):
        surface, is_crack = surface_of(broken.world, fragment_id)
        assert surface.is_watertight and surface.is_winding_consistent
        assert abs(surface.volume - mass / DENSITY) < LENGTH_ERROR * size * surface.area
        outside += surface.area_faces[~is_crack].sum()
        if count >= READ_BACK:
            continue
        surface.export(tmp_path / "fragment.stl")
        shown = mesh_of_fragment(broken.world.fragment_mesh(fragment_id))
        (tmp_path / "fragment.glb").write_bytes(glb_of_mesh(shown, WHITE))
        for file in ("fragment.stl", "fragment.glb"):
            read = read_surface(tmp_path / file, None)
            assert len(read.triangles) == len(surface.faces)
            assert trimesh.Trimesh(*read, process=False).volume == pytest.approx(surface.volume, rel=1e-5)
        CollisionWorld().add_body(CollisionBody(1, 1, vertices=surface.vertices, triangles=surface.faces))
    whole = trimesh.Trimesh(body.vertices, boundary_triangles(body.tetrahedra), process=False).area
    assert outside == pytest.approx(whole, rel=1e-5)


@pytest.mark.parametrize("place", [0.0, 1e-12])
def test_cracks_through_nodes_leave_closed_surfaces(place: float) -> None:
    """Crossings coincide with nodes, and parts of tetrahedra have no volume."""
    for shape in ("ball", "brick", "l_block", "sampled_ball"):
        mesh = BODIES[shape]
        body = CollisionBody(1, 1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra, density=DENSITY)
        event = planes(body, normals=[(0.0, 0.0, 1.0), (1.0, 0.0, 0.0)], offsets=[place, 0.0], first_new_id=10)
        world = CollisionWorld()
        world.add_body(body)
        world.add_fracture(event)
        for fragment_id, mass in masses_of(world, 1).items():
            surface, _ = surface_of(world, fragment_id)
            assert surface.is_watertight and surface.is_winding_consistent
            assert abs(surface.volume - mass / DENSITY) < LENGTH_ERROR * 0.2 * surface.area


def test_a_whole_body_keeps_its_boundary() -> None:
    body = BODIES["torus"]
    world = CollisionWorld()
    world.add_body(CollisionBody(1, 1, vertices=body.vertices, tetrahedra=body.tetrahedra))
    surface, is_crack = surface_of(world, 1)
    assert np.array_equal(surface.triangles, body.vertices[boundary_triangles(body.tetrahedra)].astype(np.float32))
    assert not is_crack.any()

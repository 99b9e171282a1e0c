"""Cylinders, cones and capsules: their surfaces, masses, and contacts where a newcomer tries them first."""

import numpy as np
import pytest
import trimesh

from fracture_collision.geometry.round_solids import capsule, cone, cylinder
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import CONE, CYLINDER, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.simulation.scene.scene import parse_scene
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings

H, R = 0.3, 0.1
STILL = np.array([[0.0, 0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("make", "volume", "tolerance"),
    [
        (cylinder, np.pi * R * R * H, 1e-12),
        (cone, np.pi * R * R * H / 3.0, 1e-12),
        (capsule, np.pi * R * R * (H + 4.0 / 3.0 * R), 4e-4),
    ],
)
def test_surfaces_are_closed_convex_and_near_the_round_ones(make, volume, tolerance) -> None:
    vertices, triangles = make(H, R)
    mesh = trimesh.Trimesh(vertices, triangles, process=False)
    assert mesh.is_watertight and mesh.is_winding_consistent and trimesh.convex.is_convex(mesh)
    assert mesh.volume == pytest.approx(volume, rel=tolerance)
    for points in (vertices, mesh.triangles_center):
        if make is cylinder:
            side = np.abs(points[:, 2]) < 0.5 * H - 1e-9
            off = np.hypot(*points[side, :2].T) - R
        elif make is cone:
            slant = np.array([H, R]) / np.hypot(H, R)
            off = (np.column_stack((np.hypot(*points[:, :2].T), points[:, 2])) - (R, -0.5 * H)) @ slant
            off = off[points[:, 2] > -0.5 * H + 1e-9]
        else:
            z = np.clip(points[:, 2], -0.5 * H, 0.5 * H)
            off = np.linalg.norm(points - np.column_stack((np.zeros((len(z), 2)), z)), axis=1) - R
        assert np.abs(off).max(initial=0.0) < (4e-4 if make is not capsule else 8e-4) * R


@pytest.mark.parametrize("kind", [CYLINDER, CONE])
def test_a_primitive_on_a_plane_has_its_mass_and_a_contact(kind: int) -> None:
    world = CollisionWorld(Settings())
    world.add_body(CollisionBody(1, 1, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    world.add_body(CollisionBody(2, 2, primitive=SolidPrimitive(kind, (H, R)), density=1000.0))
    contacts = world.contacts(FragmentStates(1, 0, np.array([2]), np.array([[0.0, 0.0, 0.5 * H - 1e-4]]), STILL))
    assert contacts.gaps == pytest.approx(np.full(len(contacts.gaps), -1e-4), abs=1e-12) and len(contacts.gaps) >= 3
    mass = 1000.0 * np.pi * R * R * H / (1.0 if kind == CYLINDER else 3.0)
    assert world.fragments().masses[1] == pytest.approx(mass, rel=1e-12)


def test_dimensions_are_checked() -> None:
    world = CollisionWorld(Settings())
    with pytest.raises(InvalidMessage, match=r"primitive.dimensions: 1 numbers, not 2, the height and the radius"):
        world.add_body(CollisionBody(1, 1, primitive=SolidPrimitive(CYLINDER, (H,))))


@pytest.mark.parametrize(
    ("shape", "rotation", "height"),
    [
        ({"cylinder": {"height": 0.2, "radius": R}}, [0, 0, 0], 0.1),
        ({"cylinder": {"height": 0.2, "radius": R}}, [90, 0, 0], R),
        ({"cone": {"height": 0.2, "radius": R}}, [0, 0, 0], 0.1),
        ({"capsule": {"straight_length": 0.2, "radius": R}}, [90, 0, 0], R),
    ],
)
def test_a_round_body_comes_to_rest_on_a_box(shape: dict, rotation: list, height: float) -> None:
    material = {"density": 1000.0, "friction": 0.5, "restitution": 0.0, "rolling_arm": 0.001}
    scene = {
        "seed": 0, "gravity": [0, 0, -9.81], "time_step": 0.0025, "duration": 1.5, "materials": {"m": material},
        "bodies": [
            {"name": "table", "material": "m", "static": True, "shape": {"box": {"size": [1, 1, 0.2]}}},
            {"name": "it", "material": "m", "shape": shape, "position": [0, 0, 0.15 + height], "rotation": rotation},
        ],
    }  # fmt: skip
    with Lockstep(parse_scene(scene, "round")) as run:
        reports = [step.report for step in run]
        at = run.simulation.begin_step().states.positions[0]
    assert reports[-1].max_speed < 1e-6
    assert at == pytest.approx([0.0, 0.0, 0.1 + height], abs=4e-4)  # a rest gap is 0.1 to 0.2 mm

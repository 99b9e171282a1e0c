"""Scene files: the plates scene as shipped, and errors for invalid scenes."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import pytest

from fracture_collision.simulation.scene.scene import SceneError, collision_body, load_scene, parse_scene
from fracture_collision.simulation.simulation import Simulation

VALID = {
    "seed": 1, "gravity": [0.0, 0.0, -9.81], "time_step": 0.01, "duration": 1.0,
    "materials": {"stone": {"density": 2000.0, "friction": 0.5, "fracture": {"strength": 1.0, "minimum_mass": 0.1}}},
    "bodies": [
        {"name": "ground", "material": "stone", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}},
        {"name": "brick", "material": "stone", "shape": {"brick": {"size_xyz": [0.2, 0.1, 0.1], "edge_length": 0.05}}},
    ],
}  # fmt: skip


def test_the_plates_scene():
    scene = load_scene("plates")
    assert scene.name == "plates"
    plates = [body for body in scene.bodies if body.shape.kind == "plate"]
    balls = [body for body in scene.bodies if body.shape.kind == "sphere"]
    assert len(plates) == 4
    assert len(balls) >= 4
    assert all(body.material.fracture is not None for body in plates)
    record = collision_body(7, plates[0])
    assert (record.body_id, record.fragment_id) == (7, 7)
    assert np.ptp(record.vertices.reshape(-1, 3), axis=0)[0] == pytest.approx(0.25)
    assert record.tetrahedra.max() < len(record.vertices) // 3


def test_start_bodies_are_returned_on_every_call_and_announced_once():
    simulation = Simulation(parse_scene(VALID, "said"))
    first, again = simulation.start_bodies(), simulation.start_bodies()
    assert [body.name for body in first] == [body.name for body in again] == ["ground", "brick"]
    assert simulation.begin_step().bodies == []
    simulation.close()


def test_a_scene_by_path_is_the_scene_by_name():
    by_name = load_scene("plates")
    by_path = load_scene(Path(__file__).parents[2] / "config" / "scenes" / "plates.yaml")
    assert by_path.bodies[4].position.tolist() == by_name.bodies[4].position.tolist()
    with pytest.raises(SceneError, match="no scene 'nowhere'"):
        load_scene("nowhere")


def test_defaults_and_steps():
    scene = parse_scene(VALID, "valid")
    assert scene.step_count == 100
    assert scene.bodies[1].material.restitution == 0.0
    assert scene.bodies[1].orientation.tolist() == [0.0, 0.0, 0.0, 1.0]


DELETE = object()


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("time_step",), 0.0, "time_step: needs more than 0"),
        (("time_step",), "soon", "time_step: needs a finite number, got 'soon'"),
        (("gravity",), [0.0, 1.0], "gravity: needs 3 numbers"),
        (("gravity",), [0.0, 1.0, float("nan")], "gravity.2: needs a finite number"),
        (("seed",), -1, "seed: needs a whole number"),
        (("duration",), DELETE, "duration: missing"),
        (("wind",), 3, "wind: unknown field"),
        (("solver",), {"sweeps": 3}, "solver.sweeps: unknown field"),
        (("materials", "stone", "friction"), -0.5, "materials.stone.friction: needs at least 0"),
        (("materials", "stone", "restitution"), 1.5, "materials.stone.restitution: needs at most 1"),
        (("materials", "stone", "fracture", "strength"), DELETE, "materials.stone.fracture.strength: missing"),
        (("materials", "stone", "fracture", "pattern"), {"seed": 2}, "materials.stone.fracture.pattern.seed: unknown"),
        (("bodies",), [], "bodies: needs a list"),
        (("bodies", 0, "static"), False, r"bodies\[0\].static: a plane cannot move"),
        (("bodies", 0, "static"), "yes", r"bodies\[0\].static: needs true or false"),
        (("bodies", 0, "shape", "plane", "coefficients"), [0, 0, 2, 0], r"plane.coefficients: the normal"),
        (("bodies", 1, "material"), "glass", r"bodies\[1\].material: 'glass' is none of stone"),
        (("bodies", 1, "name"), "ground", "bodies: the name 'ground' occurs 2 times"),
        (("bodies", 1, "shape"), {"cone": {}}, r"bodies\[1\].shape: needs just one of"),
        (("bodies", 1, "shape"), {"sphere": {"radius": 0}}, r"bodies\[1\].shape.sphere.radius: needs more than 0"),
        (("bodies", 1, "shape", "brick", "edge_length"), -1.0, r"bodies\[1\].shape.brick.edge_length"),
        (("bodies", 1, "shape", "brick", "edge_length"), "x", r"bodies\[1\].shape.brick"),
        (("bodies", 1, "shape", "brick", "size"), 3, r"bodies\[1\].shape.brick.size: unknown field"),
    ],
)  # fmt: skip
def test_errors_name_the_field(path, value, words):
    content = copy.deepcopy(VALID)
    place = content
    for key in path[:-1]:
        place = place[key]
    if value is DELETE:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    with pytest.raises(SceneError, match=words):
        parse_scene(content, "broken")


def test_a_file_that_is_not_yaml(tmp_path):
    path = tmp_path / "broken.yaml"
    path.write_text("bodies: [", encoding="utf-8")
    with pytest.raises(SceneError, match="not YAML"):
        load_scene(path)
    path.write_text("- 1", encoding="utf-8")
    with pytest.raises(SceneError, match="scene: needs fields"):
        load_scene(path)

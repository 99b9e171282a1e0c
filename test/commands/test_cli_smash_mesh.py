"""`fracture-collision smash --mesh`: the scene made from a user's mesh, and errors for unusable meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
import yaml
from click.testing import CliRunner

from fracture_collision.cli.smash import _filled, _own_scene, smash
from fracture_collision.geometry.generators import TetGeometry, ball
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import own_body_scene
from fracture_collision.world import Settings


def scene_of(mesh: TetGeometry, folder: Path) -> Path:
    np.savez(folder / "mesh.npz", vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    (folder / "scene.yaml").write_text(yaml.safe_dump(own_body_scene(Path("mesh.npz"), mesh)))
    return folder / "scene.yaml"


@pytest.mark.parametrize("radius", [0.02, 0.15, 2.0])
def test_meshes_of_any_size_fall_and_break(tmp_path: Path, radius: float) -> None:
    scene = load_scene(scene_of(ball(radius, radius / 5.0), tmp_path))
    fragments = []
    with Lockstep(scene, Settings(threads=1)) as lockstep:
        while not lockstep.simulation.finished and max(fragments, default=1) < 5:
            fragments.append(lockstep.step().report.fragments)
    assert fragments[0] <= 2 and max(fragments) >= 5


def test_a_surface_is_filled(tmp_path: Path) -> None:
    file = tmp_path / "ring.obj"
    trimesh.creation.torus(0.5, 0.2).export(file)
    scene = load_scene(_own_scene(_filled(file, 0.4), tmp_path / "out", tmp_path))
    body = scene.bodies[1]
    assert np.ptp(body.shape.mesh.vertices, axis=0).max() == pytest.approx(0.4, rel=0.02)
    assert len(body.shape.mesh.vertices) > 100


def test_a_scene_written_by_smash_can_be_run_again(tmp_path: Path) -> None:
    """Even though the new run replaces the earlier run's outputs."""
    old, new = tmp_path / "old", tmp_path / "new"
    old.mkdir()
    new.mkdir()
    scene_of(ball(0.1, 0.05), old)
    copied = _own_scene(None, old, new)
    assert copied == new / "scene.yaml"
    for file in old.iterdir():
        file.unlink()
    assert len(load_scene(copied).bodies) == 3


def test_a_mesh_with_holes_is_rejected_with_an_explanation(tmp_path: Path) -> None:
    file = tmp_path / "open.obj"
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    trimesh.Trimesh(box.vertices, box.faces[2:], process=False).export(file)
    result = CliRunner().invoke(smash, ["--mesh", str(file), "--out", str(tmp_path / "out")])
    assert result.exit_code == 2
    words = " ".join(result.output.split())
    assert "edges with only one face: the surface has holes, the first between (" in words
    assert not (tmp_path / "out").exists()

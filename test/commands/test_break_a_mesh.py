"""examples/break_a_mesh.py as a user runs it: with the package's mesh, a mesh file and, with a mesher, a surface."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh

from fracture_collision.geometry.generators import ball

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "break_a_mesh.py"


def pairs_of(*arguments: Path) -> dict[tuple[int, int], tuple[int, float, float]]:
    """For each pair printed the number of its contacts, their deepest gap and the bound [mm]."""
    done = subprocess.run([sys.executable, EXAMPLE, *arguments], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    row = r"fragments (\d+) and (\d+): (\d+) contacts, deepest gap (\S+) mm; unlisted to (\S+) mm"
    return {
        (int(a), int(b)): (int(count), float(gap), float(bound))
        for a, b, count, gap, bound in re.findall(row, done.stdout)
    }


def assert_broken(pairs: dict[tuple[int, int], tuple[int, float, float]]) -> None:
    with_floor = {pair: found for pair, found in pairs.items() if pair[0] == 2}
    between = {pair: found for pair, found in pairs.items() if pair[0] != 2}
    assert min(gap for _, gap, _ in with_floor.values()) == pytest.approx(-1.0, abs=0.01)
    assert len(between) >= 7 and all(count >= 3 for count, _, _ in between.values())
    assert all(abs(gap) < 1e-3 and bound < 1e-3 for _, gap, bound in between.values())


def test_it_has_ten_statements_or_so() -> None:
    assert len(EXAMPLE.read_text().splitlines()) <= 25


def test_it_breaks_the_mesh_of_the_package_and_a_file(tmp_path: Path) -> None:
    assert_broken(pairs_of())
    mesh = ball(50.0, 10.0)
    np.savez(tmp_path / "ball.npz", vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    assert_broken(pairs_of(tmp_path / "ball.npz"))


def test_it_breaks_a_surface(tmp_path: Path) -> None:
    trimesh.creation.torus(0.5, 0.2).export(tmp_path / "ring.stl")
    assert_broken(pairs_of(tmp_path / "ring.stl"))

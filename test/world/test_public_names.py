"""The public API: what a user imports exists, is documented, and does not need ROS."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module

import pytest

import fracture_collision

PACKAGES = ("world", "fracture", "meshing")


@pytest.mark.parametrize("package", PACKAGES)
def test_every_public_name_exists_and_is_documented(package: str) -> None:
    module = import_module(f"fracture_collision.{package}")
    assert module.__doc__ and module.__all__ == sorted(module.__all__, key=lambda name: (not name.isupper(), name))
    for name in module.__all__:
        value = getattr(module, name)
        assert isinstance(value, int) or (value.__doc__ and "Alias for" not in value.__doc__), name
        for field in getattr(value, "_fields", ()):
            assert "Alias for field" not in getattr(value, field).__doc__, (name, field)


def test_a_star_import_brings_the_packages() -> None:
    assert set(PACKAGES) | {"__version__"} == set(fracture_collision.__all__)
    script = "import sys; from fracture_collision import *; assert world.CollisionWorld, fracture.voronoi;"
    script += " assert not [name for name in sys.modules if name.split('.')[0] in ('rclpy', 'pybullet')]"
    subprocess.run([sys.executable, "-c", script], check=True, timeout=120)

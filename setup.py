"""Adds what pyproject.toml cannot say: the extras, of which `ros` names a folder of this checkout, and shared files."""

from __future__ import annotations

import os
from pathlib import Path

from setuptools import setup

ROOT = Path(__file__).resolve().parent
# `make wheel` sets it: its wheels are to be installed elsewhere, the messages from a wheel beside this one.
EXTRAS = ("cli", "bags", "viewer", "meshing", "mesher", "mujoco", "bullet")
MESSAGES = "fracture-collision-msgs"
FOR_RELEASE = "FRACTURE_COLLISION_RELEASE" in os.environ


def requirements(name: str) -> list[str]:
    """The requirements in a file of requirements/, one per line, and in those that it names."""
    found: list[str] = []
    for line in (ROOT / "requirements" / name).read_text().splitlines():
        words = line.split("#")[0].strip()
        found += requirements(words.removeprefix("-r ")) if words.startswith("-r ") else [words] if words else []
    return list(dict.fromkeys(found))


def shared_files() -> list[tuple[str, list[str]]]:
    """What `fracture_collision.share` looks for, below the environment as colcon installs it."""
    files = sorted(file for folder in ("config", "launch") for file in Path(folder).rglob("*") if file.is_file())
    files = [file for file in files if "__pycache__" not in file.parts]
    return [(str(Path("share", "fracture_collision", file.parent)), [str(file)]) for file in files]


setup(
    data_files=shared_files(),
    extras_require={
        **{name: requirements(f"{name}.in") for name in EXTRAS},
        "ros": [
            *requirements("ros.in"), *requirements("nodes.in"),
            MESSAGES if FOR_RELEASE else f"{MESSAGES} @ {(ROOT / 'messages').as_uri()}",
        ],
    },
)

"""Files of a scene, read as plain data: sizes are bounded before anything is built, and every error is a SceneError."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fracture_collision.plain_yaml import YamlError, load_yaml
from fracture_collision.simulation.config.scene_fields import SceneError

MAX_SCENE_BYTES = 1_000_000
MAX_TRACK_BYTES = 20_000_000  # hours of a hand, at one row per step


def read_text(file: Path, most_bytes: int) -> str:
    """The text of a regular file of at most `most_bytes`; raises SceneError."""
    try:
        if not file.is_file():  # a device or a pipe may never end
            raise SceneError(f"{file}: no such file")
        with file.open("rb") as stream:
            data = stream.read(most_bytes + 1)
    except (OSError, ValueError) as error:
        raise error if isinstance(error, SceneError) else SceneError(f"{file}: {error}") from error
    if len(data) > most_bytes:
        raise SceneError(f"{file}: more than {most_bytes} bytes")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise SceneError(f"{file}: not UTF-8: {error}") from error


def read_yaml(file: Path) -> Any:
    """Content of a YAML file: mappings, lists, texts and numbers, no objects; raises SceneError."""
    try:
        return load_yaml(read_text(file, MAX_SCENE_BYTES))
    except YamlError as error:
        raise SceneError(f"{file}: {error}") from error

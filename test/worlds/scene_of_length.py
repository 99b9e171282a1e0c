"""A scene of config/scenes with a given duration."""

from __future__ import annotations

from pathlib import Path

import yaml

from fracture_collision.share import share_directory


def scene_of_length(name: str, seconds: float, folder: Path) -> Path:
    """A new file in `folder`."""
    content = yaml.safe_load((share_directory() / "config" / "scenes" / f"{name}.yaml").read_text())
    file = folder / f"{name}_of_{seconds:g}_s.yaml"
    file.write_text(yaml.safe_dump(content | {"duration": seconds}))
    return file

"""The tables of docs/scenes.md: the fields of scene files, from the parser itself.

Usage: python -m fracture_collision.simulation.scene.scene_reference docs/scenes.md
"""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from inspect import signature
from pathlib import Path
from typing import Any

from fracture_collision.share import share_directory
from fracture_collision.simulation.config.scene_fields import Entry, Fields, SceneError, recorded
from fracture_collision.simulation.config.shapes import KINDS, MAKERS, SHAPES, parse_shape
from fracture_collision.simulation.scene.scene import parse_scene

NAME = "NAME"
# A scene in which the parser reads every field, given or not; what must be given has the least it can have.
EVERYTHING: dict[str, Any] = {
    "materials": {NAME: {"density": 1.0, "friction": 0.5, "fracture": {"strength": 1.0, "minimum_mass": 0.0}}},
    "bodies": [{"name": "stone", "material": NAME, "shape": {"sphere": {"radius": 1.0}}}],
    "hand": {"track": [[0.0, 0.0, 0.0, 1.0, "stone"], [1.0, 0.0, 0.0, 1.0, ""]]},
    "robot": {
        "material": NAME, "urdf": str(share_directory() / "config" / "robots" / "lbr_iiwa.urdf"),
        "motors": [
            {"joint": "lbr_iiwa_joint_1", "torque": 1.0, "position": [[0.0, 0.0]]},
            {"joint": "lbr_iiwa_joint_2", "torque": 1.0, "velocity": [[0.0, 0.0]]},
        ],
    },
    "time_step": 0.01,
    "duration": 1.0,
}
PRIMITIVES = {
    "plane": {"coefficients": [0, 0, 1, 0]}, "box": {"size": [1, 1, 1]}, "sphere": {"radius": 1},
}  # fmt: skip
TITLES = {
    "": "The scene",
    "solver": "solver",
    f"materials.{NAME}": f"materials: {NAME}",
    f"materials.{NAME}.fracture": f"materials: {NAME}: fracture",
    f"materials.{NAME}.fracture.pattern": f"materials: {NAME}: fracture: pattern",
    "bodies[]": "bodies: each",
    "hand": "hand",
    "robot": "robot",
    "robot.motors[]": "robot: motors: each",
}
TABLES = "## The scene\n"  # where the tables of docs/scenes.md begin


def scene_entries() -> list[Entry]:
    """All fields but those of shapes, each once, by the full names of EVERYTHING with `[]` for any index."""
    with recorded() as found:
        parse_scene(EVERYTHING, NAME)
    entries: dict[str, Entry] = {}
    for entry in found:
        path = re.sub(r"\[\d+\]", "[]", entry.path)
        if ".shape." not in path:
            entries.setdefault(path, entry._replace(path=path))
    return list(entries.values())


def shape_entries(kind: str) -> list[Entry]:
    """The fields of one kind of shape, under their own names."""
    with recorded() as found:
        # A mesh is not made: what its function needs is there, but no number.
        fields = dict.fromkeys(signature(MAKERS[kind]).parameters) if kind in MAKERS else PRIMITIVES[kind]
        with suppress(SceneError):
            parse_shape(Fields({kind: fields}, "shape"), {})
    prefix = f"shape.{kind}."
    return [entry._replace(path=entry.path[len(prefix) :]) for entry in found if entry.path.startswith(prefix)]


def reference(document: str) -> str:
    """The document with the present tables."""
    parts = [document.split(TABLES)[0].rstrip("\n") + "\n"]
    entries = scene_entries()
    for prefix, title in TITLES.items():
        own = [e for e in entries if _parent(e.path) == prefix]
        parts.append(f"## {title}\n\n" + _table(own))
    parts.append(
        "## shape\n\nA body has just one of these. All but the first six are meshes of tetrahedra, and can break.\n"
    )
    for kind in KINDS:
        parts.append(f"### {kind}\n\n{_sentence(SHAPES[kind])}\n\n" + _table(shape_entries(kind)))
    return "\n".join(parts)


def _parent(path: str) -> str:
    return path.rpartition(".")[0]


def _table(entries: list[Entry]) -> str:
    rows = ["| field | value | default | range | meaning |", "|---|---|---|---|---|"]
    for entry in entries:
        name = entry.path.rpartition(".")[2]
        unit, words = re.fullmatch(r"(?:\[([^\]]+)\] ?)?(.*)", entry.words).groups()  # type: ignore[union-attr]
        value = f"{entry.kind} [{unit}]" if unit else entry.kind
        rows.append(f"| `{name}` | {value} | {_default(entry)} | {entry.limits} | {words} |")
    return "\n".join(rows) + "\n"


def _default(entry: Entry) -> str:
    if entry.default is ...:
        return "required"
    if entry.default is None or entry.default == {}:
        return ""
    if isinstance(entry.default, bool):
        return str(entry.default).lower()
    if isinstance(entry.default, tuple):
        return "[" + ", ".join(f"{x:g}" for x in entry.default) + "]"
    return entry.default if isinstance(entry.default, str) else f"{entry.default:g}"


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text[0].upper() + text[1:].rstrip(".") + "."


if __name__ == "__main__":
    file = Path(sys.argv[1])
    file.write_text(reference(file.read_text(encoding="utf-8")), encoding="utf-8")

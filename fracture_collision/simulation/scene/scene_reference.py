"""The fields of scene files as a document, from the parser itself: docs/scenes.md.

Usage: python -m fracture_collision.simulation.scene.scene_reference > docs/scenes.md
"""

from __future__ import annotations

import re
from contextlib import suppress
from inspect import signature
from typing import Any

from fracture_collision.simulation.actors.arm import JOINTS
from fracture_collision.simulation.config.scene_fields import Entry, Fields, SceneError, recorded
from fracture_collision.simulation.config.shapes import KINDS, MESHES, SHAPES, parse_shape
from fracture_collision.simulation.scene.scene import parse_scene

NAME = "NAME"
# A scene in which the parser reads every field, given or not; what must be given has the least it can have.
EVERYTHING: dict[str, Any] = {
    "materials": {NAME: {"density": 1.0, "friction": 0.5, "fracture": {"strength": 1.0, "minimum_mass": 0.0}}},
    "bodies": [{"name": "stone", "material": NAME, "shape": {"sphere": {"radius": 1.0}}}],
    "hand": {"track": [[0.0, 0.0, 0.0, 1.0, "stone"], [1.0, 0.0, 0.0, 1.0, ""]]},
    "arm": {"material": NAME, "swing": [[0.0] * (1 + JOINTS)]},
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
    "arm": "arm",
}
HEAD = """# Scene files

A scene is a YAML file: bodies, their places and materials, and what is thrown at them. `fracture-collision scene FILE`
runs it, `fracture-collision play --scene FILE` plays it, and `fracture-collision scenes` lists those of the package, in
`config/scenes/`. An unknown field, a missing one or one out of range is an error that names it.

Units are metres, seconds, kilograms and degrees; the world's z axis points up. Positions are those of body frames.
YAML aliases (`&plate`, `<<: *plate`) serve for bodies that are alike. Of the package's scenes,
[plates.yaml](../config/scenes/plates.yaml) gives reasons for its values, [bunnies.yaml](../config/scenes/bunnies.yaml)
has a hand, [vase.yaml](../config/scenes/vase.yaml) an arm, and
[reference_sphere.yaml](../config/scenes/reference_sphere.yaml) has variants: `NAME:VARIANT` is the scene with the
changes that `variants` lists.

The smallest scene:

```yaml
time_step: 0.005
duration: 1.0
materials:
  stone: {density: 2500.0, friction: 0.5, fracture: {strength: 0.5, minimum_mass: 0.01}}
bodies:
  - {name: ground, material: stone, static: true, shape: {plane: {coefficients: [0.0, 0.0, 1.0, 0.0]}}}
  - {name: ball, material: stone, shape: {ball: {radius: 0.1, edge_length: 0.02}}, position: [0.0, 0.0, 1.0]}
```

The tables are made from the parser: `python -m fracture_collision.simulation.scene.scene_reference`.
"""


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
        fields = dict.fromkeys(signature(MESHES[kind]).parameters) if kind in MESHES else PRIMITIVES[kind]
        with suppress(SceneError):
            parse_shape(Fields({kind: fields}, "shape"), {})
    prefix = f"shape.{kind}."
    return [entry._replace(path=entry.path[len(prefix) :]) for entry in found if entry.path.startswith(prefix)]


def reference() -> str:
    """The document."""
    parts = [HEAD]
    entries = scene_entries()
    for prefix, title in TITLES.items():
        own = [e for e in entries if _parent(e.path) == prefix]
        parts.append(f"## {title}\n\n" + _table(own))
    parts.append(
        "## shape\n\nA body has just one of these. All but the first three are meshes of tetrahedra, and can break.\n"
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
    return f"{entry.default:g}"


def _sentence(text: str) -> str:
    text = " ".join(text.split())
    return text[0].upper() + text[1:].rstrip(".") + "."


if __name__ == "__main__":
    print(reference(), end="")

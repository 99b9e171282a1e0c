"""docs/scenes.md is what the parser says, and the parser says it of every field."""

from __future__ import annotations

import math
from inspect import signature

import pytest
import yaml

from benchmarks.snippets import DOCS, blocks
from fracture_collision.simulation.config.scene_fields import Fields, SceneError, recorded
from fracture_collision.simulation.config.shapes import KINDS, MAKERS, parse_shape
from fracture_collision.simulation.scene.scene import load_scene, parse_scene, scene_files
from fracture_collision.simulation.scene.scene_reference import (
    EVERYTHING,
    PRIMITIVES,
    TITLES,
    reference,
    scene_entries,
    shape_entries,
)


def test_the_document_is_made_from_the_parser() -> None:
    hint = "python -m fracture_collision.simulation.scene.scene_reference docs/scenes.md"
    document = (DOCS / "scenes.md").read_text(encoding="utf-8")
    assert document == reference(document), hint


def test_every_field_of_the_package_s_scenes_is_in_it() -> None:
    known = {(path.rpartition(".")[2]) for path in (e.path for e in scene_entries())}
    known |= {e.path for kind in KINDS for e in shape_entries(kind)} | set(KINDS)
    text = reference("")
    with recorded() as found:
        for file in scene_files():
            load_scene(file.path)
    assert len(found) > 500
    for entry in found:
        name = entry.path.rpartition(".")[2]
        assert name in known, entry
        assert f"| `{name}` |" in text or f"### {name}\n" in text
        assert entry.words, entry


def test_every_section_has_fields() -> None:
    parents = {e.path.rpartition(".")[0] for e in scene_entries()}
    assert parents == set(TITLES)


def test_the_ranges_are_those_that_the_parser_keeps() -> None:
    for entry in scene_entries():
        if entry.kind not in ("number", "whole number") or ".shape" in entry.path:
            continue
        edges = {"at least 0": -1, "more than 0": 0, "at least 0, at most 1": 1.5}
        with pytest.raises(SceneError, match=entry.path.replace("[]", r"\[0\]")):
            parse_scene(with_value(EVERYTHING, entry.path, edges[entry.limits]), "x")


def with_value(content: object, path: str, value: object) -> object:
    head, _, rest = path.partition(".")
    if head.endswith("[]"):
        items = content[head[:-2]]
        return {**content, head[:-2]: [with_value(items[0], rest, value), *items[1:]]}
    return {**content, head: with_value(content.get(head, {}), rest, value) if rest else value}


VALID = {"size_xyz": [1.0, 1.0, 1.0], "notch_xy": [0.5, 0.5], "inner_radius": 0.5, "minor_radius": 0.3, "wall": 0.05,
         "thickness": 0.1, "rim_height": 0.1, "depth": 0.4, "edge_length": 0.3, "frequency": 2, "outer_frequency": 3,
         "inner_frequency": 2, "interior_points": 30, "layers": 2}  # fmt: skip


@pytest.mark.parametrize("kind", [kind for kind in MAKERS if kind != "stored_mesh"])
def test_the_functions_of_shapes_keep_the_ranges_that_are_listed(kind: str) -> None:
    entries = shape_entries(kind)
    assert [e.path for e in entries] == list(signature(MAKERS[kind]).parameters)
    fields = {e.path: VALID.get(e.path, 1.0) for e in entries}
    parse_shape(Fields({kind: fields}, "shape"), {})
    for entry in entries:
        for bad in {"more than 0": [0, -1, math.inf], "at least 0": [-1], "at least 1": [0]}.get(entry.limits, []):
            wrong = [bad] * len(fields[entry.path]) if isinstance(fields[entry.path], list) else bad
            with pytest.raises(SceneError, match="^shape." + kind):
                parse_shape(Fields({kind: fields | {entry.path: wrong}}, "shape"), {})


def test_the_smallest_scene_is_one() -> None:
    (block,) = (b for b in blocks(DOCS / "scenes.md") if b.language == "yaml")
    content = yaml.safe_load(block.text)
    assert len(parse_scene(content, "smallest").bodies) == 2
    for key in content:
        with pytest.raises(SceneError, match=f"^{key}: missing; it is: "):
            parse_scene({k: v for k, v in content.items() if k != key}, "smaller")


def test_an_unknown_field_is_answered_with_a_known_one() -> None:
    with pytest.raises(SceneError, match=r"gravitiy: unknown field; did you mean gravity\?"):
        parse_scene({**EVERYTHING, "gravitiy": [0, 0, 0]}, "x")
    with pytest.raises(SceneError, match="shape.sphere.corners: unknown field; there are radius"):
        parse_shape(Fields({"sphere": {**PRIMITIVES["sphere"], "corners": 3}}, "shape"), {})

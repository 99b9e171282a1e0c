"""Invalid settings raise clear errors; the warm-up compiles every kernel of a fracture."""

from __future__ import annotations

import json

import pytest
from worlds.gate_world import REFERENCE, made_world

from fracture_collision.core.fracture import crack_surfaces
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.settings import settings_text
from fracture_collision.world.warm_up import compile_kernels


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contacts_per_pair", 0), ("penetration_tolerance", -0.1), ("detection_tolerance", 2.0), ("threads", -1),
        ("visit_budget", -5), ("max_bodies", -1), ("field", "guessed"),
        ("penetration_tolerance", float("nan")), ("tree", "grown"), ("traversal", "random"),
    ],
)  # fmt: skip
def test_a_setting_out_of_range_is_rejected_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        CollisionWorld(Settings()._replace(**{name: value}))


def test_the_warm_up_compiles_what_only_a_second_fracture_needs() -> None:
    said: list[str] = []
    compile_kernels(said.append)
    assert len(said) == 3
    assert crack_surfaces.rebuild_surfaces.signatures


def test_answers_and_registries_say_what_they_were_made_with() -> None:
    world = made_world(Settings(threads=1, lookahead=0.02))
    assert world.contacts(REFERENCE).lookahead == world.contacts(REFERENCE._replace(step=9)).lookahead == 0.02
    told = json.loads(world.fragments().settings)
    assert told["lookahead"] == 0.02 and told["surfaces"] == "edges" and told["contacts_per_pair"] == 8
    world.change_settings(Settings(threads=1, surfaces="sampled"))
    assert world.contacts(REFERENCE).lookahead == 0.0
    assert json.loads(world.fragments().settings)["surfaces"] == "sampled"


def test_equal_settings_have_equal_texts() -> None:
    """Whatever numbers they are given by; on one line, with all digits."""
    text = settings_text(Settings(lookahead=0, visit_budget=True, detection_tolerance=1))
    assert '"lookahead": 0.0,' in text and '"visit_budget": 1,' in text and '"detection_tolerance": 1.0,' in text
    assert "\n" not in text
    assert json.loads(settings_text(Settings(lookahead=1.0 / 120.0)))["lookahead"] == 1.0 / 120.0

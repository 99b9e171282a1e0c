"""Invalid settings raise clear errors; the warm-up compiles every kernel of a fracture."""

from __future__ import annotations

import json

import pytest

from fracture_collision.core.fracture import crack_surfaces
from fracture_collision.world import CollisionWorld, PaperSettings, Settings
from fracture_collision.world.settings import for_step, settings_text
from fracture_collision.world.warm_up import compile_kernels


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contacts_per_pair", 0), ("penetration_tolerance", -0.1), ("detection_tolerance", 2.0), ("threads", -1),
        ("max_work", 0), ("max_bodies", -1), ("method", "guessed"), ("penetration_tolerance", float("nan")),
    ],
)  # fmt: skip
def test_a_setting_out_of_range_is_rejected_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        CollisionWorld(Settings()._replace(**{name: value}))


@pytest.mark.parametrize("name", PaperSettings._fields)
def test_an_unknown_variant_of_the_paper_is_rejected_by_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: 'grown' is not one of"):
        CollisionWorld(Settings(method="glondu2014", paper=PaperSettings()._replace(**{name: "grown"})))


def test_a_setting_without_effect_is_rejected() -> None:
    with pytest.raises(ValueError, match="lookahead: 0.01 has no effect"):
        CollisionWorld(Settings(method="glondu2014", lookahead=0.01))
    with pytest.raises(ValueError, match="paper: its variants are those of method glondu2014"):
        CollisionWorld(Settings(paper=PaperSettings(tree="plain")))
    assert for_step(0.01, {"method": "glondu2014"}).lookahead == 0.0
    assert for_step(0.01, {}).lookahead == 0.01 and for_step(0.01, {"lookahead": 0.0}).lookahead == 0.0


def test_the_warm_up_compiles_what_only_a_second_fracture_needs() -> None:
    said: list[str] = []
    compile_kernels(said.append)
    assert len(said) == 3
    assert crack_surfaces.rebuild_surfaces.signatures


def test_equal_settings_have_equal_texts() -> None:
    """Whatever numbers they are given by; on one line, with all digits."""
    text = settings_text(Settings(lookahead=0, max_work=True, detection_tolerance=1))
    assert '"lookahead": 0.0,' in text and '"max_work": 1,' in text and '"detection_tolerance": 1.0,' in text
    assert "\n" not in text
    assert json.loads(settings_text(Settings(lookahead=1.0 / 120.0)))["lookahead"] == 1.0 / 120.0

"""Invalid settings raise clear errors; the warm-up compiles every kernel of a fracture."""

from __future__ import annotations

import pytest

from fracture_collision.core.fracture import crack_surfaces
from fracture_collision.world import CollisionWorld, Settings
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

"""The scenes that everybody tries first, of benchmarks.elementary, end as they should."""

from __future__ import annotations

import pytest

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import SCENES, Setting, scene_of

KINDS = ("box", "brick1", "brick2")


def faults(name: str, setting: Setting) -> list[str]:
    return list(SCENES[name].faults(run(scene_of(name, SCENES[name], setting), setting.scale, setting.turn)))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(name, kind, marks=pytest.mark.slow if kind == "brick2" else ())
        for name in SCENES for kind in KINDS[: 3 if SCENES[name].has_kinds else 1]
    ],
)  # fmt: skip
def test_an_elementary_scene_ends_as_it_should(name: str, kind: str) -> None:
    assert not faults(name, Setting(kind))


@pytest.mark.parametrize("name", [name for name in SCENES if name.startswith(("drop", "stack", "slide", "overhang"))])
@pytest.mark.parametrize("setting", [Setting("triangles"), Setting("box", turn=1.0)], ids=["triangles", "turned"])
def test_it_does_so_with_triangles_and_off_the_axes(name: str, setting: Setting) -> None:
    assert not faults(name, setting)


@pytest.mark.parametrize("name", [name for name in SCENES if name.startswith("slide")])
@pytest.mark.parametrize("step", [pytest.param(0.001, marks=pytest.mark.slow), 0.01])
def test_a_slide_over_seams_loses_nothing_at_other_steps(name: str, step: float) -> None:
    assert not faults(name, Setting("box", step=step))


@pytest.mark.parametrize(
    ("name", "kind"),
    [("dominoes", "box"), ("dominoes", "brick1"), *((name, "box") for name in ("coin", "chain", "ball in a bowl"))],
)
def test_blows_cost_no_time_and_give_no_energy_at_long_steps(name: str, kind: str) -> None:
    """Bodies wait for the rest of a step of 10 ms in which they touch, and make up for it."""
    assert not faults(name, Setting(kind, step=0.01))

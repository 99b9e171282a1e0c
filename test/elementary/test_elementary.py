"""The scenes that everybody tries first, of benchmarks.elementary, end as they should."""

from __future__ import annotations

import pytest

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import SCENES, Setting, scene_of

KINDS = ("box", "brick1", "brick2")
# Of tetrahedra or triangles, boxes differ in how contacts are found: these scenes have all their kinds.
OF_BRICKS = ("drop", "stack", "slide a plate", "overhang", "0.7 m in a wall", "boxes half in each other", "dominoes")
VARIED = [name for name in SCENES if name.startswith(("drop", "stack", "slide", "overhang"))]


def faults(name: str, setting: Setting) -> list[str]:
    return list(SCENES[name].faults(run(scene_of(name, SCENES[name], setting), setting.scale, setting.turn)))


def is_slow(name: str, kind: str) -> bool:
    return kind == "brick2" or (kind != "box" and not name.startswith(OF_BRICKS))


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param(name, kind, marks=pytest.mark.slow if is_slow(name, kind) else ())
        for name in SCENES for kind in KINDS[: 3 if SCENES[name].has_kinds else 1]
    ],
)  # fmt: skip
def test_an_elementary_scene_ends_as_it_should(name: str, kind: str) -> None:
    assert not faults(name, Setting(kind))


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow if is_slow(name, "triangles") else ()) for name in VARIED]
)
@pytest.mark.parametrize("setting", [Setting("triangles"), Setting("box", turn=1.0)], ids=["triangles", "turned"])
def test_it_does_so_with_triangles_and_off_the_axes(name: str, setting: Setting) -> None:
    assert not faults(name, setting)


@pytest.mark.parametrize("name", [name for name in VARIED if name.startswith("slide")])
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

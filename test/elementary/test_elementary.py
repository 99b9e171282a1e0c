"""The scenes that everybody tries first, of benchmarks.elementary, end as they should."""

from __future__ import annotations

import pytest

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import SCENES, Setting, scene_of


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("kind", ["box", "brick1", "brick2"])
def test_an_elementary_scene_ends_as_it_should(name: str, kind: str) -> None:
    trace = run(scene_of(name, SCENES[name], Setting(kind)))
    assert not list(SCENES[name].faults(trace))


@pytest.mark.parametrize("name", [name for name in SCENES if name.startswith("slide")])
@pytest.mark.parametrize("step", [0.001, 0.01])
def test_a_slide_over_seams_loses_nothing_at_other_steps(name: str, step: float) -> None:
    trace = run(scene_of(name, SCENES[name], Setting("box", step=step)))
    assert not list(SCENES[name].faults(trace))

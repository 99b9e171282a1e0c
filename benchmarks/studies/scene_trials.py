"""Runs of whole scenes as trials, timed or not; several studies share them."""

from __future__ import annotations

from typing import Any

from benchmarks.studies.study import Trial
from fracture_collision.scene_run import SceneRun
from fracture_collision.simulation.scene import Scene, load_scene
from fracture_collision.simulation.scene_changes import with_curvature
from fracture_collision.world import Settings

# The paper's times are of one core.
ONE_THREAD = Settings(threads=1)
# Of PatternSettings, as in porcelain.
CURVATURE = {"flat": 0.0, "curved": 0.25}


def scene_trial(
    name: str,
    cracks: str = "flat",
    settings: Settings = ONE_THREAD,
    seed: int | None = None,
    duration: float | None = None,
    is_timed: bool = True,
    count_colliding: bool = False,
) -> Trial:
    """A run of a scene, at most `duration` [s] of it; finds the report of `scene_run.SceneRun`.

    Counting all colliding points fills caches that the next step's query would have to fill: no matter for the
    figures, but such a run's times are none.
    """
    if is_timed and count_colliding:
        raise ValueError("a run that counts colliding points cannot be timed")
    words = f"{name}, {cracks} cracks" + (", counting" if count_colliding else "")
    return Trial(run_scene, (name, cracks, settings, seed, duration, count_colliding), words, is_timed)


def scene_with(name: str, cracks: str, duration: float | None = None) -> Scene:
    """The scene with all cracks `flat` or `curved`, not longer than `duration` [s]."""
    scene = with_curvature(load_scene(name), CURVATURE[cracks])
    return scene if duration is None else scene._replace(duration=min(duration, scene.duration))


def run_scene(
    name: str, cracks: str, settings: Settings, seed: int | None, duration: float | None, count_colliding: bool
) -> dict[str, Any]:
    with SceneRun(scene_with(name, cracks, duration), settings, seed, count_colliding) as run:
        for _ in run:
            pass
        return run.report()

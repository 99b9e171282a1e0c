"""Runs of whole scenes as trials, timed or untimed; shared by several studies."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.studies.study import StudyError, Trial
from fracture_collision.run_report import summaries
from fracture_collision.scene_run import SceneRun
from fracture_collision.simulation.scene.scene import Scene, load_scene
from fracture_collision.simulation.scene.scene_changes import with_curvature
from fracture_collision.world import PaperSettings, Settings

# The paper's times are for one core.
ONE_THREAD = Settings(threads=1)
# The paper's method, with exact distances.
PAPERS = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))
# In PatternSettings, as in porcelain.
CURVATURE = {"flat": 0.0, "curved": 0.25}


def scene_trial(
    name: str,
    cracks: str = "flat",
    settings: Settings = ONE_THREAD,
    seed: int | None = None,
    duration: float | None = None,
    is_timed: bool = True,
    count_colliding: bool = False,
    repeats: int = 1,
) -> Trial:
    """A run of a scene, at most `duration` [s] of it; its result is the report of `scene_run.SceneRun`.

    Each step's times are its minimum over `repeats` equal runs, which excludes interference from other programs; the
    worst is that of all runs.

    Counting all colliding points fills caches that the next step's query would have to fill: this does not affect the
    counts, but the times of such a run are invalid.
    """
    if is_timed and count_colliding:
        raise ValueError("a run that counts colliding points cannot be timed")
    words = f"{name}, {cracks} cracks" + (", counting" if count_colliding else "")
    return Trial(run_scene, (name, cracks, settings, seed, duration, count_colliding, repeats), words, is_timed)


def scene_with(name: str, cracks: str, duration: float | None = None) -> Scene:
    """The scene with all cracks `flat` or `curved`, not longer than `duration` [s]."""
    scene = with_curvature(load_scene(name), CURVATURE[cracks])
    return scene if duration is None else scene._replace(duration=min(duration, scene.duration))


def in_words(repeats: int) -> str:
    """Describes the times of such trials."""
    if repeats == 1:
        return "Times are from one run."
    return f"Averages are of each step's shortest time in {repeats} equal runs; worst is the longest step of all runs."


def run_scene(
    name: str,
    cracks: str,
    settings: Settings,
    seed: int | None,
    duration: float | None,
    count_colliding: bool,
    repeats: int,
) -> dict[str, Any]:
    reports = []
    for _ in range(repeats):
        with SceneRun(scene_with(name, cracks, duration), settings, seed, count_colliding) as run:
            for _ in run:
                pass
            reports.append(run.report())
    return with_shortest_times(reports)


def with_shortest_times(reports: list[dict[str, Any]]) -> dict[str, Any]:
    """The first of the reports of equal runs, with the minimum of each step's times, and the worst of all runs."""
    first = reports[0]
    if any(report["digest"] != first["digest"] for report in reports):
        raise StudyError(f"{first['scene']}: equal runs took different courses")
    times = [name for name in first["summary"] if name.endswith("_ms")]
    shortest = {name: np.min([report[name] for report in reports], axis=0).tolist() for name in times}
    summary = summaries(shortest)
    for name in summary:
        summary[name] |= {"worst": max(report["summary"][name]["worst"] for report in reports)} if summary[name] else {}
    return first | shortest | {"summary": first["summary"] | summary}

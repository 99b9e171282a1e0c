"""Fig. 12: contacts, colliding points, pairs and times in two runs, and whether fractures slow queries down."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    RED,
    finish,
    mark_paper,
    new_figure,
    running_median,
)
from benchmarks.studies.scene_trials import in_words, scene_trial
from benchmarks.studies.study import Study, StudyError, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.run_report import PAPER

SCENES = ("drop_bunnies", "bricks")
COLUMNS = ("contacts", "pairs", "fragments", "fractures", "total_ms", "collision_ms", "physics_ms", "update_ms",
           "fracture_ms")  # fmt: skip
NEIGHBOURS = 10  # steps on either side of a fracture with which its query is compared
SMOOTH = 9  # steps of the running median in the plot


class Size(NamedTuple):
    cracks: tuple[str, ...]
    scenes: tuple[str, ...] = SCENES
    duration: float | None = None  # [s]
    repeats: int = 1  # per timed run


def trials(size: Size) -> list[Trial]:
    return [
        trial for scene in size.scenes for cracks in size.cracks for trial in _trials(size, scene, cracks)
    ]


def _trials(size: Size, scene: str, cracks: str) -> tuple[Trial, Trial]:
    """One timed, one that counts."""
    return (
        scene_trial(scene, cracks, duration=size.duration, repeats=size.repeats),
        scene_trial(scene, cracks, duration=size.duration, is_timed=False, count_colliding=True),
    )


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    steps: list[Row] = []
    summary: list[Row] = []
    for scene in size.scenes:
        for cracks in size.cracks:
            timed, counted = (results[trial] for trial in _trials(size, scene, cracks))
            if timed["digest"] != counted["digest"]:
                raise StudyError(f"{scene}: two equal runs took different courses")
            own = []
            for i in range(len(timed["step"])):
                row: dict[str, Any] = {"scene": scene, "cracks": cracks, "time": timed["time"][i]}
                row |= {name: timed[name][i] for name in COLUMNS}
                row["colliding_points"] = counted["colliding_points"][i]
                own.append(row)
            steps += own
            summary.append({"scene": scene, "cracks": cracks, "repeats": size.repeats} | _summary(Table({}, own)))
    return {"": summary, "steps": steps}


def _summary(steps: Table) -> dict[str, Any]:
    at_fractures, elsewhere = spikes(steps)
    row: dict[str, Any] = {"fractures": int(steps.column("fractures").sum())}
    for name in ("contacts", "colliding_points", "pairs"):
        row |= {f"{name}_average": steps.column(name).mean(), f"{name}_worst": int(steps.column(name).max())}
    row["steps_after_fractures"] = len(at_fractures)
    for words, ratios in (("after_fracture", at_fractures), ("elsewhere", elsewhere)):
        for q, quantile in (("median", 0.5), ("90", 0.9), ("worst", 1.0)):
            row[f"{words}_ms_ratio_{q}"] = float(np.quantile(ratios, quantile)) if len(ratios) else None
    return row


def spikes(steps: Table) -> tuple[np.ndarray, np.ndarray]:
    """The query time of each step over the median of its neighbourhood: at first steps after a fracture, and at others.

    The neighbourhood excludes first steps after fractures.
    """
    collision, first = steps.column("collision_ms"), steps.column("update_ms") > 0.0
    touching = steps.column("contacts") > 0
    ratios = np.full(len(collision), np.nan)
    for i in np.flatnonzero(touching):
        around = np.arange(max(i - NEIGHBOURS, 0), min(i + NEIGHBOURS + 1, len(collision)))
        around = around[(around != i) & ~first[around] & touching[around]]
        if len(around) >= NEIGHBOURS:
            ratios[i] = collision[i] / np.median(collision[around])
    known = np.isfinite(ratios)
    return ratios[known & first], ratios[known & ~first]


def draw(tables: Mapping[str, Table]) -> Figure:
    """Like the paper's: statistics and times of each scene, flat cracks."""
    steps = tables["steps"].where(cracks="flat")
    scenes = steps.values("scene")
    figure, axes = new_figure(2, len(scenes), sharex="col", width=5.2 * len(scenes) + 0.4)
    for (counts, times), scene in zip(axes.T, scenes, strict=True):
        own = steps.where(scene=scene)
        time, first = own.column("time"), own.column("update_ms") > 0.0
        for name, words, colour in (
            ("colliding_points", "colliding points", RED), ("contacts", "contacts", GREEN),
            ("pairs", "close pairs", BLUE),
        ):  # fmt: skip
            counts.plot(time, np.maximum(own.column(name), 1.0), color=colour, linewidth=1.2, label=words)
        paper = PAPER.get(scene, {})
        if "contacts" in paper:
            mark_paper(counts, paper["contacts"][0], f"contacts, average {paper['contacts'][0]:,}")
            mark_paper(counts, paper["contacts"][1], f"contacts, worst {paper['contacts'][1]:,}", ":")
        for name, words, colour in (
            ("total_ms", "whole step", BLUE), ("collision_ms", "collision", RED), ("physics_ms", "physics", "black"),
        ):  # fmt: skip
            values = np.maximum(own.column(name), 1e-2)
            times.plot(time, values, color=colour, linewidth=0.6, alpha=0.25)
            times.plot(time, running_median(values, SMOOTH), color=colour, linewidth=1.3, label=words)
        broke = own.column("fracture_ms") > 0.0
        times.plot(time[broke], own.column("fracture_ms")[broke], "^", color=GREEN, markersize=5, label="fracture")
        times.plot(time[first], own.column("update_ms")[first], "o", color=ORANGE, markersize=4, label="update")
        if "total_ms" in paper:
            mark_paper(times, paper["total_ms"][0], f"whole step, average {paper['total_ms'][0]:g} ms")
            mark_paper(times, paper["total_ms"][1], f"whole step, worst {paper['total_ms'][1]:g} ms", ":")
        times.set_yscale("log")
        times.set_ylim(bottom=0.1)
        counts.set_yscale("log")
        finish(counts, f"{scene}: what there is to do", "", "number a step", "lower right")
        finish(times, f"{scene}: times", "simulated time [s]", "milliseconds per step", None)
        times.legend(fontsize=7, loc="lower right", ncols=2, framealpha=0.85)
    return figure


def draw_spikes(tables: Mapping[str, Table]) -> Figure:
    """How much longer a step's query takes than its neighbours', after a fracture and elsewhere."""
    steps = tables["steps"]
    scenes = steps.values("scene")
    figure, (axes,) = new_figure(1, len(scenes), sharey=True, width=5.2 * len(scenes) + 0.4)
    for panel, scene in zip(axes, scenes, strict=True):
        for cracks, style in zip(steps.values("cracks"), ("-", "--"), strict=False):
            for words, ratios, colour in zip(
                ("first after a fracture", "all others"), spikes(steps.where(scene=scene, cracks=cracks)),
                (RED, GREY), strict=True,
            ):  # fmt: skip
                ratios = np.sort(ratios)
                share = 100.0 * (1.0 - np.arange(len(ratios)) / max(len(ratios), 1))
                panel.step(
                    ratios, share, style, where="pre", color=colour, label=f"{words}, {cracks} cracks: {len(ratios)}"
                )
        panel.axvline(1.0, color=PURPLE, linewidth=0.9)
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.set_ylim(0.05, 150.0)
        panel.set_xticks([0.5, 1, 2, 5, 10], ["0.5", "1", "2", "5", "10"])
        panel.minorticks_off()
        finish(panel, scene, "query time of a step over the median of the steps about it", "", "lower left")
    axes[0].set_ylabel("steps with at least this ratio [%]")
    return figure


def section(tables: Mapping[str, Table]) -> str:
    rows = tables[""].rows
    statistics = []
    for row in rows:
        paper = PAPER.get(row["scene"], {}).get("contacts", (None, None)) if row["cracks"] == "flat" else (None, None)
        statistics.append((
            f"{row['scene']}, {row['cracks']}", number(row["fractures"]),
            *(average_and_worst(row, name) for name in ("contacts", "colliding_points", "pairs")),
            f"{number(paper[0])} / {number(paper[1])}" if paper[0] else "–",
        ))  # fmt: skip
    ratios = [
        (
            f"{row['scene']}, {row['cracks']}, {words}",
            *(number(row[f"{name}_ms_ratio_{q}"]) for q in ("median", "90", "worst")),
        )
        for row in rows
        for name, words in (("after_fracture", "first step after a fracture"), ("elsewhere", "all other steps"))
    ]
    return f"""\
Contacts are those that the service listed. Colliding points are all that it could have listed, counted in a second,
identical run. Average / worst per step:

{markdown_table(("scene, cracks", "fractures", "contacts", "colliding points", "close pairs", "paper's contacts"),
                statistics)}
Spikes at fractures: the query time of a step divided by the median of the {2 * NEIGHBOURS} steps around it. The first
query after a fracture tests new surfaces and more pairs than the steps before. The other steps show the noise of the
machine. {in_words(rows[0]["repeats"])}

{markdown_table(("query time / its neighbours'", "median", "90 %", "worst"), ratios)}"""


STUDY = Study(
    "fig12", "Statistics per step, and spikes at fractures (Fig. 12)",
    Size(("flat",)), Size(("flat", "curved"), repeats=3),
    trials, tables, {"": draw, "spikes": draw_spikes}, section,
)  # fmt: skip

"""Tables 1 to 3: sizes, statistics and times of the five scenes, with flat and with curved cracks."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import BLUE, GREY, ORANGE, finish, new_figure
from benchmarks.studies.scene_trials import in_words, scene_trial
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.run_report import PAPER

SCENES = ("piggy_bank", "drop_bunnies", "bricks", "plates", "bunnies")
SIZES = ("object", "bodies", "triangles", "tetrahedra", "points", "interior_points")
TOTALS = ("triangles_before", "triangles_after", "fragments")
SUMMARIES = ("contacts", "colliding_points", "pairs", "total_ms", "collision_ms", "physics_ms", "update_ms",
             "fracture_ms")  # fmt: skip
# Scenes in which colliding points are counted; the paper has no counts for its interactive scenes.
COUNTED = ("piggy_bank", "drop_bunnies", "bricks")


class Size(NamedTuple):
    curved: tuple[str, ...]  # scenes that also run with curved cracks
    counted: tuple[str, ...]  # kinds of cracks for which colliding points are counted
    scenes: tuple[str, ...] = SCENES
    duration: float | None = None  # [s]
    repeats: int = 1  # per timed run

    @property
    def runs(self) -> list[tuple[str, str]]:
        """Scene and cracks."""
        kinds = [(scene, cracks) for scene in self.scenes for cracks in ("flat", "curved")]
        return [(scene, cracks) for scene, cracks in kinds if cracks == "flat" or scene in self.curved]


def trials(size: Size) -> list[Trial]:
    counted = [_counting(size, *run) for run in size.runs if _is_counted(size, *run)]
    return [_timed(size, *run) for run in size.runs] + counted


def _timed(size: Size, scene: str, cracks: str) -> Trial:
    return scene_trial(scene, cracks, duration=size.duration, repeats=size.repeats)


def _counting(size: Size, scene: str, cracks: str) -> Trial:
    return scene_trial(scene, cracks, duration=size.duration, is_timed=False, count_colliding=True)


def _is_counted(size: Size, scene: str, cracks: str) -> bool:
    return scene in COUNTED and cracks in size.counted


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    rows: list[Row] = []
    for scene, cracks in size.runs:
        report = results[_timed(size, scene, cracks)]
        summary = dict(report["summary"])
        if _is_counted(size, scene, cracks):
            summary["colliding_points"] = results[_counting(size, scene, cracks)]["summary"]["colliding_points"]
        row: dict[str, Any] = {"scene": scene, "cracks": cracks, "steps": len(report["step"]), "repeats": size.repeats}
        row |= {name: " + ".join(str(one[name]) for one in report["sizes"]) for name in SIZES}
        row |= {name: report["totals"][name] for name in TOTALS}
        row["fractures"] = sum(report["fractures"])
        row["time_step"] = report["totals"]["time_step_ms"] / 1e3
        for name in SUMMARIES:
            found = summary.get(name, {})
            row |= {f"{name}_average": found.get("average"), f"{name}_worst": found.get("worst")}
        rows.append(row)
    return {"": rows}


def draw(tables: Mapping[str, Table]) -> Figure:
    """The whole step of each scene, next to the paper's."""
    table = tables[""]
    scenes = table.values("scene")
    figure, ((axes,),) = new_figure(1, 1, width=9.0, height=3.8)
    for k, (cracks, colour) in enumerate((("flat", BLUE), ("curved", ORANGE))):
        own = {row["scene"]: row for row in table.where(cracks=cracks).rows}
        at = [i + 0.27 * (k - 1) for i, scene in enumerate(scenes) if scene in own]
        axes.bar(at, [own[s]["total_ms_average"] for s in scenes if s in own], 0.25, color=colour,
                 label=f"average, {cracks} cracks")  # fmt: skip
        axes.plot(at, [own[s]["total_ms_worst"] for s in scenes if s in own], "v", color=colour,
                  markeredgecolor="black", label=f"worst, {cracks} cracks")  # fmt: skip
    told = [(i + 0.27, PAPER[s]["total_ms"]) for i, s in enumerate(scenes) if "total_ms" in PAPER.get(s, {})]
    axes.bar([at for at, _ in told], [paper[0] for _, paper in told], 0.25, color=GREY, label="paper, average")
    axes.plot([at for at, _ in told], [paper[1] for _, paper in told], "v", color=GREY, markeredgecolor="black",
              label="paper, worst")  # fmt: skip
    axes.set_yscale("log")
    axes.set_xticks(np.arange(len(scenes)), scenes)
    finish(axes, "whole step", "", "milliseconds", None)
    handles, words = axes.get_legend_handles_labels()
    handles, words = zip(*sorted(zip(handles, words, strict=True), key=lambda one: one[1]), strict=True)
    axes.legend(handles, words, fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.06), frameon=False)
    return figure


def section(tables: Mapping[str, Table]) -> str:
    rows = tables[""].rows
    sizes = {row["scene"]: (row["scene"], *(_cell(row[name]) for name in SIZES)) for row in rows}
    statistics, times = [], []
    for row in rows:
        name = f"{row['scene']}, {row['cracks']}"
        paper = PAPER.get(row["scene"], {})
        statistics.append((
            name, number(row["triangles_before"]), _beside(row["triangles_after"], paper.get("triangles_after")),
            _beside(row["fragments"], paper.get("fragments")), number(row["fractures"]),
            average_and_worst(row, "contacts") + _paper(paper.get("contacts")),
            average_and_worst(row, "colliding_points"), average_and_worst(row, "pairs"),
        ))  # fmt: skip
        times.append((
            name, number(1e3 * row["time_step"]), average_and_worst(row, "total_ms") + _paper(paper.get("total_ms")),
            *(average_and_worst(row, f"{part}_ms") for part in ("collision", "physics", "update", "fracture")),
        ))  # fmt: skip
    return f"""\
The paper's figures are in brackets where its text gives them; its tables are images. Its times are from one core of a
Core i7-2600 at 3.4 GHz: a limit to stay below, not a comparison of code. Our times are on one thread too, with the
default settings and without lookahead.
{in_words(rows[0]["repeats"])}

**Table 1:** sizes of the objects

{markdown_table(("scene", "object", "bodies", "triangles", "tetrahedra", "points", "interior points"), sizes.values())}
**Table 2:** statistics, average / worst per step

{markdown_table(("scene, cracks", "triangles before", "after", "fragments", "fractures", "contacts", "colliding points",
                 "close pairs"), statistics)}
**Table 3:** ms per step, average / worst; update and fracture computation in the steps that have them

{markdown_table(("scene, cracks", "time step", "whole step", "collision detection", "physics", "update",
                 "fracture computation"), times)}"""


def _cell(value: Any) -> str:
    return f"{value:,}" if isinstance(value, int) else str(value)


def _paper(pair: tuple[float | None, float | None] | None) -> str:
    if pair is None:
        return ""
    return f" ({' / '.join(number(value) for value in pair if value is not None)})"


def _beside(value: Any, paper: tuple[float | None, float | None] | None) -> str:
    return number(value) + _paper(paper)


STUDY = Study(
    "tables", "The five scenes (Tables 1 to 3)",
    Size(("piggy_bank",), ("flat",), repeats=3),
    Size(SCENES, ("flat", "curved"), repeats=3),
    trials, tables, {"": draw}, section,
)  # fmt: skip

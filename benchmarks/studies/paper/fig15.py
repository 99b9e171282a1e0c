"""Fig. 15: field and tree updated at a fracture against rebuilt ones, on one trajectory of the piggy bank.

D is the distance field, S the sphere tree. The paper's updated D is the `averaged` field; its exact one, which the
paper recomputes at each fracture, is here the `exact` field, which is evaluated per query. S is the restructured tree,
or one rebuilt from scratch on the samples of the new surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import BLUE, GREEN, ORANGE, RED, finish, new_figure
from benchmarks.studies.replay import MILLI, Answers, replay_trial, summary_of_answers
from benchmarks.studies.scene_trials import PAPERS
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.world import PaperSettings

SCENE = "piggy_bank"
COMBINATIONS = {
    "D updated, S updated": PAPERS._replace(paper=PaperSettings(field="averaged")),
    "D updated, S rebuilt": PAPERS._replace(paper=PaperSettings(field="averaged", tree="rebuilt")),
    "D exact, S updated": PAPERS,
    "D exact, S rebuilt": PAPERS._replace(paper=PaperSettings(field="exact", tree="rebuilt")),
}
# Overlapping lines stay distinguishable by their widths.
COLOURS = dict(zip(COMBINATIONS, (BLUE, ORANGE, GREEN, RED), strict=True))
WIDTHS = dict(zip(COMBINATIONS, (5.0, 5.0, 2.4, 2.4), strict=True))
WINDOW = 5  # steps averaged in each row of the table of steps


class Size(NamedTuple):
    repeats: int
    cracks: tuple[str, ...]
    duration: float | None = None  # [s]


def trials(size: Size) -> list[Trial]:
    return [_trial(size, cracks) for cracks in size.cracks]


def _trial(size: Size, cracks: str) -> Trial:
    return replay_trial(SCENE, cracks, size.duration, tuple(COMBINATIONS.values()), size.repeats)


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    summary: list[Row] = []
    steps: list[Row] = []
    for cracks in size.cracks:
        names = {"cracks": cracks, "repeats": size.repeats}
        for name, answers in zip(COMBINATIONS, results[_trial(size, cracks)], strict=True):
            summary.append(names | {"combination": name} | summary_of_answers(answers))
            steps += windows(answers, load_scene(SCENE).time_step, {"cracks": cracks, "combination": name})
    return {"": summary, "steps": steps}


def windows(answers: Answers, time_step: float, names: dict[str, Any]) -> list[Row]:
    """Means over WINDOW steps."""
    rows = []
    for begin in range(0, len(answers.query), WINDOW):
        those = slice(begin, begin + WINDOW)
        rows.append(names | {
            "time": begin * time_step,
            "visits": answers.visits[those].mean(),
            "contacts": answers.contacts[those].mean(),
            "query_ms": MILLI * answers.query[those].mean(),
            "update_ms": MILLI * answers.update[those].max(),
        })  # fmt: skip
    return rows


def draw(tables: Mapping[str, Table]) -> Figure:
    steps = tables["steps"]
    kinds = steps.values("cracks")
    figure, axes = new_figure(len(kinds), 3, width=13.0)
    for row, cracks in zip(axes, kinds, strict=True):
        for name in steps.values("combination"):
            own = steps.where(cracks=cracks, combination=name)
            how = {"color": COLOURS[name], "linewidth": WIDTHS[name], "label": name}
            row[0].plot(own.column("time"), own.column("query_ms"), **how)
            row[1].plot(own.column("time"), own.column("visits") / 1e3, **how)
        summary = tables[""].where(cracks=cracks)
        names = summary.values("combination")
        at = np.arange(len(names))
        row[2].barh(at, summary.column("update_ms_average"), color=[COLOURS[name] for name in names])
        row[2].plot(summary.column("update_ms_worst"), at, "d", color="black", markersize=5, label="worst")
        row[2].set_yticks(at, names, fontsize=8)
        row[2].invert_yaxis()
        finish(row[0], f"query, {cracks} cracks", "simulated time [s]", f"milliseconds, mean of {WINDOW} steps")
        finish(row[1], f"visited nodes, {cracks} cracks", "simulated time [s]", "thousand a step", None)
        finish(row[2], f"update at a fracture, {cracks} cracks", "milliseconds, average")
        row[0].set_ylim(bottom=0.0)
        row[1].set_ylim(bottom=0.0)
    return figure


def section(tables: Mapping[str, Table]) -> str:
    rows = [
        (
            f"{row['combination']}; {row['cracks']}", average_and_worst(row, "query_ms"),
            average_and_worst(row, "visits"), number(row["visit_ns"]), average_and_worst(row, "contacts"),
            average_and_worst(row, "update_ms"),
        )
        for row in tables[""].rows
    ]  # fmt: skip
    fractures, repeats = tables[""].rows[0]["fractures"], tables[""].rows[0]["repeats"]
    return f"""\
The piggy bank falls once. Its states and events ({fractures} steps with fractures) are then replayed with different
settings, so that all runs process the same queries. D is the distance field: updated as in the paper (`averaged`) or
exact (`exact`, evaluated at each query point: no field is rebuilt). S is the sphere tree: restructured, or rebuilt on
the new surface. Contacts are the paper's: of samples only, with the nearest normal. Averages are of each step's
shortest time in {repeats} interleaved runs, worst is the longest of all runs. Average / worst:

{markdown_table(("field and tree; cracks", "query, ms", "visited nodes per step", "ns per visit", "contacts",
                 "update, ms"), rows)}"""


STUDY = Study(
    "fig15", "Updating against rebuilding (Fig. 15)", Size(3, ("flat",), 0.8), Size(5, ("flat", "curved")),
    trials, tables, {"": draw}, section,
)  # fmt: skip

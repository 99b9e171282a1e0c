"""Fig. 17: the bunnies with old and new restructuring and traversal, and with the number of contacts fixed at 8."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import BLUE, GREEN, ORANGE, PURPLE, RED, finish, new_figure, running_median
from benchmarks.studies.replay import replay_trial, summary_of_answers
from benchmarks.studies.scene_trials import PAPERS, in_words, scene_trial
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.run_report import PAPER, summary_of

SCENE = "drop_bunnies"
NEW, OLD, FIXED = "new tree, new traversal", "old tree, old traversal", "new, 8 contacts fixed"
METHODS = {
    NEW: PAPERS,
    "new tree, old traversal": PAPERS._replace(paper=PAPERS.paper._replace(traversal="queue")),
    "old tree, new traversal": PAPERS._replace(paper=PAPERS.paper._replace(tree="plain")),
    OLD: PAPERS._replace(paper=PAPERS.paper._replace(tree="plain", traversal="queue")),
    FIXED: PAPERS._replace(contacts_per_pair=8, penetration_tolerance=1.0),
}
COLOURS = dict(zip(METHODS, (BLUE, GREEN, ORANGE, RED, PURPLE), strict=True))
# Contacts per step, average and worst (7.4).
PAPERS_CONTACTS = {NEW: PAPER[SCENE]["contacts"], OLD: (1235, 3245), FIXED: (755, 1974)}
SMOOTH = 15  # steps of the running median in the plot
EVERY = 3  # steps per row of the table of steps


class Size(NamedTuple):
    methods: tuple[str, ...]  # each runs the scene
    cracks: tuple[str, ...]
    duration: float | None  # [s] of the runs
    replayed: float | None  # [s] of one run, replayed by all methods
    replays: int  # per method
    repeats: int = 1  # per run


def trials(size: Size) -> list[Trial]:
    runs = [_run(size, method, cracks) for cracks in size.cracks for method in size.methods]
    return runs + [_replay(size, cracks) for cracks in size.cracks]


def _run(size: Size, method: str, cracks: str) -> Trial:
    return scene_trial(SCENE, cracks, METHODS[method], duration=size.duration, repeats=size.repeats)


def _replay(size: Size, cracks: str) -> Trial:
    return replay_trial(SCENE, cracks, size.replayed, tuple(METHODS.values()), size.replays)


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    runs: list[Row] = []
    steps: list[Row] = []
    replays: list[Row] = []
    for cracks in size.cracks:
        for method in size.methods:
            report = results[_run(size, method, cracks)]
            row: dict[str, Any] = {"cracks": cracks, "repeats": size.repeats, "method": method}
            row["fragments"] = report["fragments"][-1]
            for name in ("contacts", "visits", "pairs", "total_ms", "collision_ms", "physics_ms", "update_ms"):
                found = report["summary"][name]
                row |= {f"{name}_average": found.get("average"), f"{name}_worst": found.get("worst")}
            depths = -1e3 * np.minimum(report["deepest_gap"], 0.0)
            found = summary_of(depths)
            runs.append(row | {"deepest_mm_average": found["average"], "deepest_mm_worst": found["worst"]})
            smooth = {n: running_median(report[n], SMOOTH) for n in ("total_ms", "collision_ms", "contacts", "visits")}
            steps += [
                {"cracks": cracks, "method": method, "time": report["time"][i]} | {n: v[i] for n, v in smooth.items()}
                for i in range(0, len(report["time"]), EVERY)
            ]
        for method, answers in zip(METHODS, results[_replay(size, cracks)], strict=True):
            replays.append({"cracks": cracks, "repeats": size.replays, "method": method} | summary_of_answers(answers))
    return {"": runs, "steps": steps, "replay": replays}


def draw(tables: Mapping[str, Table]) -> Figure:
    steps = tables["steps"]
    kinds = steps.values("cracks")
    figure, axes = new_figure(len(kinds), 4, width=15.5)
    for row, cracks in zip(axes, kinds, strict=True):
        for method in steps.where(cracks=cracks).values("method"):
            own = steps.where(cracks=cracks, method=method)
            how = {"color": COLOURS[method], "linewidth": 1.3, "label": method}
            row[0].plot(own.column("time"), own.column("total_ms"), **how)
            row[1].plot(own.column("time"), own.column("visits") / 1e3, **how)
            row[2].plot(own.column("time"), own.column("contacts"), **how)
        for method, (average, _) in PAPERS_CONTACTS.items():
            row[2].axhline(
                average, color=COLOURS[method], linestyle="--", linewidth=1.0, label=f"paper's average: {average:,}"
            )
        finish(row[0], f"whole step, {cracks} cracks", "simulated time [s]", "milliseconds", "upper left")
        finish(row[1], f"visited nodes, {cracks} cracks", "simulated time [s]", "thousand a step", None)
        finish(row[2], f"contacts, {cracks} cracks", "simulated time [s]", "contacts a step", None)
        row[2].legend(
            *zip(*[(h, t) for h, t in zip(*row[2].get_legend_handles_labels(), strict=True) if t.startswith("paper")],
                 strict=True), fontsize=8, loc="upper left",
        )  # fmt: skip
        replayed = tables["replay"].where(cracks=cracks)
        at = np.arange(len(replayed.rows))
        row[3].barh(at, replayed.column("query_ms_average"), color=[COLOURS[one["method"]] for one in replayed.rows])
        row[3].set_yticks(at, [one["method"].replace(", ", ",\n") for one in replayed.rows], fontsize=8)
        row[3].invert_yaxis()
        finish(row[3], f"query on one course, {cracks} cracks", "milliseconds per step, average", "", None)
        for panel in row[:3]:
            panel.set_ylim(0.0, 1.3 * panel.get_ylim()[1])
    return figure


def section(tables: Mapping[str, Table]) -> str:
    runs = []
    for row in tables[""].rows:
        paper = PAPERS_CONTACTS.get(row["method"])
        runs.append((
            f"{row['method']}; {row['cracks']}", average_and_worst(row, "contacts"),
            f"{paper[0]:,} / {paper[1]:,}" if paper else "–", average_and_worst(row, "visits"),
            average_and_worst(row, "collision_ms"), average_and_worst(row, "total_ms"),
            average_and_worst(row, "update_ms"), average_and_worst(row, "deepest_mm"),
        ))  # fmt: skip
    replays = [
        (
            f"{row['method']}; {row['cracks']}", average_and_worst(row, "contacts"), average_and_worst(row, "visits"),
            average_and_worst(row, "query_ms"), average_and_worst(row, "update_ms"),
        )
        for row in tables["replay"].rows
    ]  # fmt: skip
    return f"""\
New: trees restructured at fractures (6.2), children of different parents visited first (5.3). Old: the paper's earlier
version [27] (`tree: plain`, `traversal: queue`). Fixed: 8 contacts per pair, however deep the others are. Contacts are
of samples only, and each method runs its own simulation, as in the paper. {in_words(tables[""].rows[0]["repeats"])}
Average / worst per step; depths are those of the listed contacts:

{markdown_table(("method; cracks", "contacts", "paper's contacts", "visited nodes", "collision, ms", "whole step, ms",
                 "update, ms", "deepest, mm"), runs)}
The paper's whole step takes {PAPER[SCENE]["total_ms"][0]} ms on average and {PAPER[SCENE]["total_ms"][1]} ms at worst.

All methods on the trajectory of the new ones, {tables["replay"].rows[0]["steps"]} steps with close pairs. Averages are
of each step's shortest time in {tables["replay"].rows[0]["repeats"]} interleaved runs, worst is the longest of all:

{markdown_table(("method; cracks", "contacts", "visited nodes", "query, ms", "update, ms"), replays)}
On one course, all trees and traversals list nearly the same contacts: those deeper than ε are listed in whatever order
they are found (5.2), and the order decides only which of the others fill up the limit. So the new tree saves no
contacts here, and its restructured spheres cost {_more_visits(tables["replay"])} % more visits than the old tree's.
The paper compares runs that take courses of their own, as in the first table; there, contacts differ by the course as
much as by the method.
"""


def _more_visits(replays: Table) -> str:
    """How many more nodes the new tree visits than the old one by the same traversal, in per cent, by cracks."""
    shares = []
    for cracks in replays.values("cracks"):
        new, old = (
            replays.where(cracks=cracks, method=f"{tree} tree, new traversal").column("visits_average")[0]
            for tree in ("new", "old")
        )
        shares.append(number(100.0 * (new / old - 1.0), 1) if old else "–")
    return " and ".join(shares)


STUDY = Study(
    "fig17", "Old and new restructuring and traversal (Fig. 17)",
    Size((NEW, OLD, FIXED), ("flat",), None, 0.5, 3), Size(tuple(METHODS), ("flat", "curved"), None, None, 3),
    trials, tables, {"": draw}, section,
)  # fmt: skip

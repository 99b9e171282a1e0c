"""Section 7.2: cost of surface and interior resolution, on the reference sphere of Fig. 11."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from benchmarks.studies.pictures import BLUE, ORANGE, finish, new_figure
from benchmarks.studies.scene_trials import in_words, scene_trial
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, average_and_worst, markdown_table, number
from fracture_collision.run_report import PAPER, summary_of

VARIANTS = ("reference_sphere", "reference_sphere:fine_surface", "reference_sphere:coarse_inside")


class Size(NamedTuple):
    seeds: int  # runs with different cracks
    cracks: tuple[str, ...]
    duration: float | None  # [s]
    variants: tuple[str, ...] = VARIANTS
    repeats: int = 1  # per run


def trials(size: Size) -> list[Trial]:
    # interleaved, so that a slow minute of the machine does not hit one variant alone
    return [
        _trial(size, variant, cracks, seed)
        for seed in range(1, size.seeds + 1)
        for cracks in size.cracks
        for variant in size.variants
    ]


def _trial(size: Size, variant: str, cracks: str, seed: int) -> Trial:
    return scene_trial(variant, cracks, seed=seed, duration=size.duration, repeats=size.repeats)


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    rows: list[Row] = []
    for variant in size.variants:
        for cracks in size.cracks:
            reports = [results[_trial(size, variant, cracks, seed)] for seed in range(1, size.seeds + 1)]
            (sizes,) = reports[0]["sizes"]
            columns = {
                name: np.concatenate([np.array(report[name], dtype=np.float64) for report in reports])
                for name in ("collision_ms", "update_ms", "contacts", "visits")
            }
            broken = np.concatenate([np.cumsum(report["fractures"]) for report in reports]) > 0
            updates = columns["update_ms"][columns["update_ms"] > 0.0]
            rows.append({
                "variant": variant, "cracks": cracks, "runs": size.seeds, "repeats": size.repeats,
                "triangles": sizes["triangles"], "points": sizes["points"], "interior_points": sizes["interior_points"],
                "fractures": len(updates),
                **_pair("contacts", columns["contacts"][broken]), **_pair("visits", columns["visits"][broken]),
                **_pair("update_ms", updates), **_pair("query_ms", columns["collision_ms"][broken]),
            })  # fmt: skip
    return {"": rows}


def _pair(name: str, values: np.ndarray) -> dict[str, float | None]:
    found = summary_of(values)
    return {f"{name}_average": found.get("average"), f"{name}_worst": found.get("worst")}


def draw(tables: Mapping[str, Table]) -> Figure:
    table = tables[""]
    variants, cracks = table.values("variant"), table.values("cracks")
    figure, (axes,) = new_figure(1, 2, height=3.8)
    for panel, name, paper_name, words in zip(
        axes, ("update_ms", "query_ms"), ("update_ms", "collision_ms"), ("update at a fracture", "query a step"),
        strict=True,
    ):  # fmt: skip
        width = 0.8 / len(cracks)
        for k, (kind, colour) in enumerate(zip(cracks, (BLUE, ORANGE), strict=False)):
            at = np.arange(len(variants)) + (k - 0.5 * (len(cracks) - 1)) * width
            own = [table.where(variant=variant, cracks=kind).rows[0] for variant in variants]
            average, worst = ([row[f"{name}_{q}"] or np.nan for row in own] for q in ("average", "worst"))
            panel.bar(at, average, 0.9 * width, color=colour, label=f"average, {kind} cracks")
            panel.plot(at, worst, "v", color=colour, markeredgecolor="black", label=f"worst, {kind} cracks")
        for i, variant in enumerate(variants):
            for value, style, q in zip(PAPER[variant][paper_name], ("-", ":"), ("average", "worst"), strict=True):
                if value is not None:
                    panel.hlines(
                        value, i - 0.45, i + 0.45, color="black", linestyle=style, linewidth=1.4,
                        label=f"paper, {q}" if i == 0 else None,
                    )  # fmt: skip
        panel.set_yscale("log")
        panel.set_xticks(range(len(variants)), [_words(table.where(variant=variant).rows[0]) for variant in variants])
        finish(panel, words, "", "milliseconds", None)
        panel.legend(fontsize=7, loc="upper right")
        panel.set_ylim(top=6.0 * panel.get_ylim()[1])
    return figure


def _words(row: Row) -> str:
    return f"{row['triangles']:,} triangles,\n{row['interior_points']:,} inside"


def section(tables: Mapping[str, Table]) -> str:
    rows = []
    for row in tables[""].rows:
        update, query = (PAPER[row["variant"]][name] for name in ("update_ms", "collision_ms"))
        rows.append((
            f"{row['triangles']:,} triangles, {row['interior_points']:,} points inside; {row['cracks']}",
            number(row["fractures"]), average_and_worst(row, "contacts"), average_and_worst(row, "visits"),
            average_and_worst(row, "update_ms"), number(update[0]),
            average_and_worst(row, "query_ms"), f"{number(query[0])} / {number(query[1])}",
        ))  # fmt: skip
    runs, repeats = tables[""].rows[0]["runs"], tables[""].rows[0]["repeats"]
    return f"""\
The reference sphere falls and breaks, in {runs} runs with different cracks. Queries are those after the first fracture.
{in_words(repeats)}

On average, queries are faster than the paper's, because neighbour lists answer pairs that hardly move. The worst query
is the first after the fracture, when all fragments touch in place. The update is slower than the paper's: it finds the
ridges for edges that cross, which is about half of its time, and makes closed surfaces with exact masses and seeds of
contacts for each crack; and the event is checked first.

Average / worst:

{markdown_table(("sphere; cracks", "fractures", "contacts", "visited nodes", "update, ms", "paper", "query, ms",
                 "paper"), rows)}"""


STUDY = Study(
    "resolution", "Surface and interior resolution (section 7.2)", Size(2, ("flat",), 0.6),
    Size(5, ("flat", "curved"), None, repeats=3), trials, tables, {"": draw}, section,
)  # fmt: skip

"""Summary of a run's figures: average, median and worst, and the tables in which Glondu et al. 2014 report a run.

`PAPER` holds the figures in the paper's text and captions; the cells of its Tables 1 to 3 are pictures. Its times are
of one core of a Core i7-2600 at 3.4 GHz: a mark to stay below, not a comparison of code.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

# Of each scene: figures by name, as average and worst where there are two. Times in milliseconds per step.
PAPER: dict[str, dict[str, tuple[float | None, float | None]]] = {
    "plates": {"total_ms": (7.4, 13.2), "triangles_after": (45_000, None)},  # Fig. 1
    "bunnies": {"total_ms": (2.0, 10.0)},  # Fig. 9
    "drop_bunnies": {
        "total_ms": (24.5, 81.5), "fragments": (166, None), "triangles_after": (435_000, None),  # Fig. 13
        "contacts": (866, 2393),  # 7.4
    },
    "bricks": {"total_ms": (11.7, 29.5), "fragments": (156, None), "triangles_after": (40_000, None)},  # Fig. 14
    "reference_sphere": {"update_ms": (1.54, None), "collision_ms": (1.16, 3.27)},  # 7.2
    "reference_sphere:fine_surface": {"update_ms": (1.8, None), "collision_ms": (1.37, 4.17)},
    "reference_sphere:coarse_inside": {"update_ms": (0.46, None), "collision_ms": (0.68, 2.26)},
}  # fmt: skip

# Measured only in the steps that have them: most have no fracture.
AT_FRACTURES = ("update_ms", "fracture_ms")

STATISTICS = (
    ("triangles_before", "triangles before"),
    ("triangles_after", "triangles after"),
    ("fragments", "fragments at the end"),
    ("contacts", "contacts per step"),
    ("colliding_points", "colliding points per step"),
    ("pairs", "close pairs per step"),
)
# A whole step consists of the five parts below it, in every table; an indented row is a part of the one above it.
TIMES = (
    ("time_step_ms", "time step"),
    ("total_ms", "whole step"),
    ("collision_ms", "collision detection"),
    ("update_ms", "update, at fractures"),
    ("physics_ms", "physics"),
    ("solver_ms", "  contact solver"),
    ("fracture_ms", "fracture computation"),
    ("ros_ms", "ROS"),
)


class TableRow(NamedTuple):
    """A row of a table beside the paper's figures."""

    words: str
    average: float | None  # or the one figure there is; None: not measured
    worst: float | None
    paper_average: float | None  # None: not in the text
    paper_worst: float | None


def summary_of(values: Sequence[float] | np.ndarray) -> dict[str, float]:
    """Median, average and worst; empty where there are no values."""
    if not len(values):
        return {}
    return {"median": float(np.median(values)), "average": float(np.mean(values)), "worst": float(np.max(values))}


def summaries(columns: Mapping[str, Sequence[float]]) -> dict[str, dict[str, float]]:
    """`summary_of` each column; for AT_FRACTURES only the steps in which they are not 0."""
    result = {}
    for name, column in columns.items():
        values = np.asarray(column, dtype=np.float64)
        result[name] = summary_of(values[values > 0.0] if name in AT_FRACTURES else values)
    return result


def statistics_table(report: Mapping[str, Any]) -> list[TableRow]:
    """Table 2 of the paper, from the report of a run."""
    return _table(report, STATISTICS)


def times_table(report: Mapping[str, Any]) -> list[TableRow]:
    """Table 3 of the paper, in milliseconds, from the report of a run."""
    return _table(report, TIMES)


def last_words(report: Mapping[str, Any]) -> str:
    """A sentence on the penetration and the speed of a run: their worst, and what is left at the end."""
    depths = 1e3 * np.maximum(-np.asarray(report["deepest_gap"]), 0.0) + 0.0  # no minus zero
    worst = int(np.argmax(depths))
    sentence = f"deepest penetration: {depths[-1]:.3f} mm at the end"
    if depths[worst] > depths[-1]:
        moment = f"{depths[worst]:.2f} mm for a moment, at {report['time'][worst]:.2f} s"
        sentence += f"; {moment}, when bodies hit each other within a time step"
    return f"{sentence}. Fastest at the end: {1e3 * report['max_speed'][-1]:.2f} mm/s"


def where_time_goes(report: Mapping[str, Any]) -> str:
    """Sentences on the share of ROS in an average step, and on what made the longest step long."""
    words = {name: text for name, text in TIMES if not text.startswith(" ")}
    parts = [name for name in words if name in report and name not in ("time_step_ms", "total_ms")]
    total = np.asarray(report["total_ms"])
    order = np.argsort(total)[::-1]
    longest = int(order[0])
    largest = max(parts, key=lambda name: report[name][longest])
    sentence = (
        f"The longest step is number {report['step'][longest]}, {total[longest]:.1f} ms, of which"
        f" {report[largest][longest]:.1f} are {words[largest].partition(',')[0]}"
    )
    if len(order) > 1:
        sentence += f"; the next longest takes {total[order[1]]:.1f} ms"
    if "ros_ms" in report:
        sentence = (
            f"ROS takes {np.mean(report['ros_ms']):.1f} of the {total.mean():.1f} ms of an average step; the paper's"
            f" step has no such part. {sentence}"
        )
    return sentence + "."


def _table(report: Mapping[str, Any], rows: Sequence[tuple[str, str]]) -> list[TableRow]:
    paper = PAPER.get(report["scene"], {})
    result = []
    for name, words in rows:
        if name in report["summary"]:
            own = report["summary"][name]
            ours = own.get("average"), own.get("worst")
        elif name in report["totals"]:
            ours = report["totals"][name], None
        else:
            continue
        result.append(TableRow(words, *ours, *paper.get(name, (None, None))))
    return result

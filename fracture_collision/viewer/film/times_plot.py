"""Times of a run and its load: one picture with two panels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

# Drawn if the report has them: a run in one process has no round trip, a run over ROS no total.
OPTIONAL_CURVES = (
    ("ros_ms", "ROS", "#7f7f7f"),
    ("total_ms", "whole step", "#17becf"),
)
CURVES = (
    ("collision_ms", "collision", "#1f77b4"),
    ("solver_ms", "contact solver", "#d62728"),
)
COUNTS = (("contacts", "contacts", "#2ca02c"), ("fragments", "fragments", "#9467bd"))
MEDIAN_STEPS = 21  # odd; window of the running median
SMALLEST_MS = 1e-3  # a logarithmic axis has no zero; nothing measured here is shorter than a microsecond


def plot_times(report: Mapping[str, Sequence[float]], png_path: Path | str) -> None:
    """Plot the times of each step of a run to a PNG.

    `report` has lists of equal length: time [s], contacts, fragments, collision_ms, update_ms, solver_ms, and those of
    OPTIONAL_CURVES that were measured.

    The upper panel has milliseconds per step on a logarithmic axis (each step pale, the running median bold; updates at
    fractures as dots, as most steps have none), the lower one contacts and fragments. Raises ValueError if a list is
    missing or the lengths differ.
    """
    curves = [curve for curve in OPTIONAL_CURVES if curve[0] in report] + list(CURVES)
    names = ("time", *(name for name, _, _ in (*curves, *COUNTS)), "update_ms")
    missing = [name for name in names if name not in report]
    if missing:
        raise ValueError(f"report: lacks {', '.join(missing)}")
    series = {name: np.asarray(report[name], dtype=np.float64) for name in names}
    lengths = {name: len(values) for name, values in series.items()}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"report: lists of different lengths: {lengths}")

    figure = Figure(figsize=(10, 6.4), dpi=120, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
    time = series["time"]
    for name, label, colour in curves:
        values = np.maximum(series[name], SMALLEST_MS)
        above.plot(time, values, color=colour, linewidth=0.7, alpha=0.3)
        above.plot(time, _running_median(values), color=colour, linewidth=1.6, label=f"{label}: {_summary(values)}")
    updated = series["update_ms"] > 0.0
    above.plot(time[updated], series["update_ms"][updated], "o", color="#ff7f0e", markersize=6, markeredgecolor="white",
               label=f"update at fractures: {_summary(series['update_ms'][updated])}")  # fmt: skip
    above.set_yscale("log")
    above.set_ylabel("milliseconds per step")
    above.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, fontsize=9, frameon=False)
    counts_axes = (below, below.twinx())
    for axes, (name, label, colour) in zip(counts_axes, COUNTS, strict=True):
        axes.plot(time, series[name], color=colour, linewidth=1.4)
        axes.set_ylabel(label, color=colour)
        axes.tick_params(axis="y", colors=colour)
        axes.set_ylim(bottom=0.0)
    below.set_xlabel("simulated time [s]")
    for axes in (above, below):
        axes.grid(True, which="major", color="#dddddd", linewidth=0.7)
        axes.set_axisbelow(True)
    if len(time):
        below.set_xlim(time[0], max(time[-1], time[0] + 1e-9))
    figure.savefig(png_path)


def _running_median(values: np.ndarray) -> np.ndarray:
    if len(values) < MEDIAN_STEPS:
        return values
    padded = np.pad(values, MEDIAN_STEPS // 2, mode="edge")
    return np.median(np.lib.stride_tricks.sliding_window_view(padded, MEDIAN_STEPS), axis=1)


def _summary(values: np.ndarray) -> str:
    return f"median {np.median(values):.2g}, worst {np.max(values):.3g} ms" if len(values) else "none"

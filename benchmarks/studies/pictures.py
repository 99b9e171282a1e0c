"""Common style of the plots: one palette, labelled axes, the paper's figures marked."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

# Okabe and Ito's palette, distinguishable by colour-blind readers.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY, GREY = (
    "#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#56b4e9", "#7f7f7f",
)  # fmt: skip
DPI = 90


def new_figure(rows: int, columns: int, width: float = 10.0, height: float = 3.6, **how) -> tuple[Figure, np.ndarray]:
    """Axes (rows, columns); width and height [inch], the height of one row."""
    figure = Figure(figsize=(width, height * rows), dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False, **how)


def finish(axes: Axes, title: str = "", x: str = "", y: str = "", legend: str | None = "best") -> None:
    """Title, labels with units, a pale grid, and a legend at `legend` or none."""
    axes.set_title(title, fontsize=10)
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, color="#dddddd", linewidth=0.7)
    axes.set_axisbelow(True)
    if legend is not None:
        axes.legend(fontsize=8, loc=legend, framealpha=0.85)


def mark_paper(axes: Axes, value: float, words: str, style: str = "--") -> None:
    """A level given in the paper."""
    axes.axhline(value, color="black", linestyle=style, linewidth=1.0, label=f"paper: {words}")


def running_median(values: np.ndarray, count: int) -> np.ndarray:
    """Median of the `count` values around each, an odd number; fewer at the ends."""
    padded = np.pad(np.asarray(values, dtype=np.float64), count // 2, constant_values=np.nan)
    return np.nanmedian(np.lib.stride_tricks.sliding_window_view(padded, count), axis=1)

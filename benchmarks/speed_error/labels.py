"""Labels next to points, placed where they cover least: the picture is redrawn with every measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patheffects import withStroke
from matplotlib.text import Annotation, Text
from matplotlib.transforms import Bbox

# Candidate places, relative to the point, in points of type: next to it, clear of it, then in rings around it.
BESIDE = ((5.0, 0.0), (-5.0, 0.0), (5.0, 6.0), (5.0, -6.0), (-5.0, 6.0), (-5.0, -6.0), (0.0, 8.0), (0.0, -8.0))
RINGS, DIRECTIONS = (16.0, 24.0, 34.0, 46.0, 58.0), 16
TURNS = np.linspace(0.0, 2.0 * np.pi, DIRECTIONS, endpoint=False) + np.pi / DIRECTIONS
CLEAR = ((0.0, 20.0), (0.0, -20.0), (0.0, 28.0), (0.0, -28.0))  # words of several lines, straight above and below
PLACES = (*BESIDE, *CLEAR, *((r * np.cos(a), 0.8 * r * np.sin(a)) for r in RINGS for a in TURNS))
STEP = 0.05  # cost per rank in PLACES
# Costs of covering words, a marker's edge and its middle, of a line per SPACING, and of lying outside.
OVER_WORDS, OVER_POINT, OVER_MIDDLE, OVER_LINE, OUTSIDE = 30.0, 3.0, 20.0, 0.3, 100.0
SPACING = 4.0  # [pixels]


class Label(NamedTuple):
    axes: Axes
    x: float  # data
    y: float
    words: str
    color: str
    needed: bool = True  # False: written only if it fits next to its point and covers nothing


def place_labels(figure: Figure, labels: Sequence[Label], size: float, radius: float = 0.0) -> None:
    """Writes `labels`, type of `size` points, once limits and layout are final.

    Their points are markers of `radius` [pixels].
    """
    renderer = FigureCanvasAgg(figure).get_renderer()
    taken: list[Bbox] = []
    for axes in figure.axes:
        if axes.get_legend() is not None:
            taken.append(axes.get_legend().get_window_extent(renderer))
        taken += [text.get_window_extent(renderer) for text in axes.texts]
    points = np.array([label.axes.transData.transform((label.x, label.y)) for label in labels]).reshape(-1, 2)
    lines = np.concatenate([np.zeros((0, 2)), *(_along(line) for axes in figure.axes for line in axes.lines)])
    for label in sorted(labels, key=lambda label: (not label.needed, -len(label.words))):  # large ones first
        if not label.words:
            continue
        best, least = None, np.inf
        for rank, place in enumerate(PLACES):
            text = _write(label, place, size)
            text.update_positions(renderer)
            box = Text.get_window_extent(text, renderer).padded(1.0)  # an annotation's own extent includes its line
            cost = STEP * rank + OVER_WORDS * sum(box.overlaps(other) for other in taken)
            cost += OVER_POINT * _count(points, box.padded(radius)) + OVER_LINE * _count(lines, box)
            cost += OVER_MIDDLE * _count(points, box)
            cost += OUTSIDE * (not _holds(label.axes.get_window_extent(), box))
            if cost < least:
                if best is not None:
                    best[0].remove()
                best, least = (text, box), cost
            else:
                text.remove()
        if label.needed or least < STEP * len(BESIDE):
            taken.append(best[1])
        else:
            best[0].remove()


def _write(label: Label, place: tuple[float, float], size: float) -> Annotation:
    across, up = place
    far = place not in BESIDE
    return label.axes.annotate(
        label.words, (label.x, label.y), place, textcoords="offset points", fontsize=size, color=label.color,
        ha="left" if across > 0.0 else "right" if across < 0.0 else "center", va="center",
        arrowprops={"arrowstyle": "-", "lw": 0.4, "color": label.color, "shrinkA": 0, "shrinkB": 2} if far else None,
        path_effects=[withStroke(linewidth=1.5, foreground="white")], zorder=7,
    )  # fmt: skip


def _along(line: Line2D) -> np.ndarray:
    """Points (n, 2) on a drawn line [pixels], SPACING apart."""
    ends = line.get_transform().transform(line.get_path().vertices)
    if line.get_linestyle() == "None" or len(ends) < 2:
        return ends
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(ends, axis=0), axis=1))])
    at = np.arange(0.0, lengths[-1], SPACING)
    return np.column_stack([np.interp(at, lengths, ends[:, k]) for k in range(2)])


def _count(points: np.ndarray, box: Bbox) -> int:
    return int(np.all((points > box.min) & (points < box.max), axis=1).sum())


def _holds(outer: Bbox, inner: Bbox) -> bool:
    return outer.x0 <= inner.x0 and outer.y0 <= inner.y0 and outer.x1 >= inner.x1 and outer.y1 >= inner.y1

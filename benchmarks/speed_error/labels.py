"""Words beside points, put where they cover least: the picture is drawn anew with every measurement."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

# Where words may go, from the point, in points of type: right, left, above, below, then farther off.
NEAR, FAR = 5.0, 14.0
PLACES = (
    (NEAR, 0.0), (-NEAR, 0.0), (NEAR, 6.0), (NEAR, -6.0), (-NEAR, 6.0), (-NEAR, -6.0), (0.0, 8.0), (0.0, -8.0),
    (FAR, 9.0), (FAR, -9.0), (-FAR, 9.0), (-FAR, -9.0), (0.0, 18.0), (0.0, -18.0), (FAR, 18.0), (FAR, -18.0),
    (-FAR, 18.0), (-FAR, -18.0), (FAR, 27.0), (FAR, -27.0), (-FAR, 27.0), (-FAR, -27.0),
)  # fmt: skip
OVER_WORDS, OVER_POINT, OUTSIDE = 10.0, 3.0, 100.0  # what covering them costs; a step down PLACES costs 0.2


class Label(NamedTuple):
    axes: Axes
    x: float  # data
    y: float
    words: str
    color: str


def place_labels(figure: Figure, labels: Sequence[Label], size: float) -> None:
    """Write `labels`, type of `size` points, once limits and layout are final; points are those of all labels."""
    renderer = FigureCanvasAgg(figure).get_renderer()
    taken: list[Bbox] = []
    for axes in figure.axes:
        if axes.get_legend() is not None:
            taken.append(axes.get_legend().get_window_extent(renderer))
    points = np.array([label.axes.transData.transform((label.x, label.y)) for label in labels]).reshape(-1, 2)
    for label in labels:
        if not label.words:
            continue
        best, least = None, np.inf
        for rank, place in enumerate(PLACES):
            text = _write(label, place, size)
            box = text.get_window_extent(renderer).padded(1.0)
            cost = 0.2 * rank + OVER_WORDS * sum(box.overlaps(other) for other in taken)
            inside = np.all((points > box.min) & (points < box.max), axis=1)
            cost += OVER_POINT * int(inside.sum()) + OUTSIDE * (not _holds(label.axes.get_window_extent(), box))
            if cost < least:
                if best is not None:
                    best[0].remove()
                best, least = (text, box), cost
            else:
                text.remove()
        taken.append(best[1])


def _write(label: Label, place: tuple[float, float], size: float):
    across, up = place
    far = abs(across) > NEAR or abs(up) > 8.0
    return label.axes.annotate(
        label.words, (label.x, label.y), place, textcoords="offset points", fontsize=size, color=label.color,
        ha="left" if across > 0.0 else "right" if across < 0.0 else "center", va="center",
        arrowprops={"arrowstyle": "-", "lw": 0.4, "color": label.color, "shrinkA": 0, "shrinkB": 2} if far else None,
    )  # fmt: skip


def _holds(outer: Bbox, inner: Bbox) -> bool:
    return outer.x0 <= inner.x0 and outer.y0 <= inner.y0 and outer.x1 >= inner.x1 and outer.y1 >= inner.y1

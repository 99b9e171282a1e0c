"""The pictures, from the CSV's lines alone: a row of panels per kind of frame, one row zoomed in on our settings."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter

from benchmarks.peers.libraries.ours_settings import DEFAULTS, RESOLUTION, SAME_MESHES
from benchmarks.speed_error.labels import Label, place_labels
from benchmarks.speed_error.points import (
    FAMILIES,
    SILENT,
    Line,
    Point,
    family,
    is_ours,
    peer_label,
    points_of,
    setting_lines,
)

DPI = 150
LEGEND = {"fontsize": 7, "title_fontsize": 7, "frameon": False}
FLOOR = 0.001  # [% R] smaller errors are drawn here
# Okabe and Ito's colours, distinguishable by colour-blind readers; the markers are redundant with them.
OURS = "#0072B2"
STARS = {DEFAULTS: OURS, SAME_MESHES: "white"}  # filled with
STYLES = dict(
    zip(
        FAMILIES,
        (("#000000", "o"), ("#009E73", "p"), ("#CC79A7", "D"), ("#D55E00", "s"), ("#E69F00", "^")),
        strict=True,
    )
)
SETTINGS = {
    "contacts_per_pair": ("contacts per pair", "#0072B2", "o"),
    "penetration_tolerance": ("penetration tolerance, % R", "#D55E00", "s"),
    RESOLUTION: ("resolution (surface frequency)", "#000000", "D"),
    "method": ("method", "#E69F00", "P"),
}
NOTHING = {"color": "#777777", "lw": 0.9, "ls": ":"}  # when no contact is reported
ERROR = "remaining + unnecessary [% R]"
QUERY, UPDATE = "query of all fragments [ms]", "update at the fracture and first query [ms]"
MEASURE = (
    "Error: after the smallest translation that satisfies the contacts reported of a pair, the penetration that "
    "remains plus the displacement\nthat was unnecessary; by exact distances of whole surfaces, so that what lies "
    "between our samples counts.\nMarker: mean over all pairs whose boxes overlap; bar: up to the worst. A missed pair "
    "counts with its true depth, a false one with its whole translation.\n"
    f"Errors below {FLOOR} % R are drawn there. Times within the libraries, one core of: "
)


def draw(rows: Sequence[Line], png: Path) -> None:
    """Query time against error: jittered frames, ours in jittered frames zoomed in, piled frames."""
    worlds = worlds_of(rows)
    figure, grid = panels(worlds, 9.0, (3.4, 1.3, 2.8, 2.8))
    labels = []
    for column, (world, title) in enumerate(worlds):
        jitter, near_worst, near_mean, pile = (row[column] for row in grid)
        points = points_of(rows, world, "jitter", ["jitter_native"])
        labels += _all_methods(jitter, points)
        labels += _our_settings(near_worst, near_mean, points)
        labels += _all_methods(pile, points_of(rows, world, "pile", ["pile_native"]))
        jitter.set_title(f"{title}\njittered: moved by up to 1 % R and 1°", fontsize=9)
        near_worst.set_title("our settings from near: worst pair", fontsize=9)
        near_mean.set_title("our settings from near: mean", fontsize=9)
        pile.set_title("piled in a box", fontsize=9)
        for axes in (jitter, near_mean, pile):
            axes.set_xlabel(QUERY, fontsize=8)
    for row in (grid[0], grid[3]):
        same_limits(row)
    # above the panels, where they cover nothing; the taller one makes room for both
    figure.legend(handles=_family_handles(), title="methods", loc="upper left", ncols=2, **LEGEND)
    figure.legend(handles=_setting_handles(), title="our settings", loc="outside upper right", ncols=2, **LEGEND)
    _finish(figure, rows, labels, png)


def draw_update(rows: Sequence[Line], png: Path) -> None:
    """Time of an update and the first query after it against the error of jittered frames."""
    worlds = worlds_of(rows)
    figure, grid = panels(worlds, 9.0, (3.8,))
    labels = []
    for axes, (world, title) in zip(grid[0], worlds, strict=True):
        labels += _all_methods(axes, points_of(rows, world, "jitter", ["update", "first_query"]))
        axes.set_title(title, fontsize=9)
        axes.set_xlabel(UPDATE, fontsize=8)
    same_limits(grid[0])
    figure.legend(handles=_family_handles(), loc="outside upper center", ncols=4, **LEGEND)
    _finish(figure, rows, labels, png)


def worlds_of(rows: Sequence[Line]) -> list[tuple[str, str]]:
    """Name and title of the first world with curved cracks and of the first with flat ones."""
    found = {}
    for row in rows:
        cracks = "curved" if row["world"].endswith("w") else "flat"
        shape = "hollow sphere" if row["world"].startswith("shell") else "sphere"
        found.setdefault(cracks, (row["world"], f"{cracks} cracks ({shape}, {row['fragments']} fragments)"))
    return [found[cracks] for cracks in ("curved", "flat") if cracks in found]


def panels(worlds: Sequence, width: float, heights: tuple[float, ...]) -> tuple[Figure, list[list[Axes]]]:
    figure = Figure((width, sum(heights) + 0.6), dpi=DPI, layout="constrained")
    grid = figure.subplots(len(heights), len(worlds), squeeze=False, height_ratios=heights)
    for axes in grid.ravel():
        axes.set(xscale="log", yscale="log")
        axes.grid(alpha=0.25, lw=0.5)
        axes.tick_params(which="both", labelsize=8)
        axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
        axes.yaxis.set_major_formatter(FuncFormatter(_error_tick))
    for row, height in zip(grid, heights, strict=True):
        row[0].set_ylabel(ERROR if height > 2.0 else "[% R]", fontsize=8)
    return figure, grid.tolist()


def _error_tick(value: float, _place: int) -> str:
    return f"≤ {FLOOR:g}" if value == FLOOR else f"{value:g}"


def _minor_tick(value: float, _place: int) -> str:
    digit = round(value / 10.0 ** math.floor(math.log10(value)))
    return f"{value:g}" if digit in (2, 3, 5) else ""


def _all_methods(axes: Axes, points: Sequence[Point]) -> list[Label]:
    """Each method with its bar; our settings as one cloud around the defaults, connected by setting."""
    labels = []
    for point in points:
        if point.method == SILENT:
            axes.axhline(point.mean, **NOTHING, zorder=1)
        if is_ours(point) or point.method == SILENT:
            continue
        color, marker = STYLES[family(point)]
        _bar(axes, point, color)
        axes.plot(point.time, _floored(point.mean), marker, color=color, ms=6, mec="white", mew=0.6, zorder=4)
        labels.append(Label(axes, point.time, _floored(point.mean), peer_label(point), color))
    for line in setting_lines(points).values():
        own = [point for _, point in line]
        axes.plot([p.time for p in own], [_floored(p.mean) for p in own], "-o", color=OURS, ms=2.5, lw=0.8, alpha=0.6)
    for point in points:
        if point.method in STARS:
            _bar(axes, point, OURS)
            put_star(axes, point, _floored(point.mean), 14)
            labels.insert(0, Label(axes, point.time, _floored(point.mean), point.method, OURS))
    return labels


def _our_settings(worst: Axes, mean: Axes, points: Sequence[Point]) -> list[Label]:
    """Each setting as a line: worst pair in one panel, mean in the other, which has the labels."""
    labels = []
    for setting, line in setting_lines(points).items():
        _, color, marker = SETTINGS[setting]
        style = {"color": color, "marker": marker, "ms": 5, "lw": 1.0, "mec": "white", "mew": 0.5}
        times = [point.time for _, point in line]
        worst.plot(times, [_floored(point.worst) for _, point in line], **style)
        mean.plot(times, [_floored(point.mean) for _, point in line], **style)
        ends = line[0], line[-1]
        labels += [Label(mean, p.time, _floored(p.mean), words, color, (words, p) in ends) for words, p in line]
    for point in points:
        if point.method == DEFAULTS:
            put_star(worst, point, _floored(point.worst), 14)
            put_star(mean, point, _floored(point.mean), 14)
            labels.insert(0, Label(mean, point.time, _floored(point.mean), "defaults", OURS))
    for axes in (worst, mean):
        axes.margins(0.12, 0.2)
        for axis in (axes.xaxis, axes.yaxis):  # the view may span less than a decade
            axis.set_minor_formatter(FuncFormatter(_minor_tick))
    return labels


def put_star(axes: Axes, point: Point, error: float, size: float) -> None:
    fill = STARS[point.method]
    axes.plot(point.time, error, "*", color=fill, ms=size, mec="white" if fill == OURS else OURS, mew=0.8, zorder=6)


def _bar(axes: Axes, point: Point, color: str) -> None:
    """From the mean up to the worst pair."""
    worst = _floored(point.worst)
    axes.plot([point.time] * 2, [_floored(point.mean), worst], "-", color=color, lw=1.0, alpha=0.55, zorder=2)
    axes.plot(point.time, worst, "_", color=color, ms=6, alpha=0.8, zorder=2)


def _floored(error: float) -> float:
    return max(error, FLOOR)


def same_limits(row: Sequence[Axes]) -> None:
    """The floor at the bottom, and the range that all panels of a row need."""
    for get, put in ((Axes.get_xlim, Axes.set_xlim), (Axes.get_ylim, Axes.set_ylim)):
        limits = [get(axes) for axes in row]
        for axes in row:
            put(axes, min(low for low, _ in limits), max(high for _, high in limits))


def _family_handles() -> list[Line2D]:
    ours = Line2D([], [], color=OURS, marker="*", ms=10, lw=0.8, label="ours, every setting")
    same = Line2D([], [], color=STARS[SAME_MESHES], marker="*", ms=10, mec=OURS, ls="", label=SAME_MESHES)
    families = [Line2D([], [], color=c, marker=m, ls="", label=name) for name, (c, m) in STYLES.items()]
    return [ours, same, *families, Line2D([], [], **NOTHING, label="no contact reported")]


def _setting_handles() -> list[Line2D]:
    return [Line2D([], [], color=c, marker=m, ms=5, lw=1.0, label=words) for words, c, m in SETTINGS.values()]


def _finish(figure: Figure, rows: Sequence[Line], labels: Sequence[Label], png: Path) -> None:
    figure.supxlabel(f"{MEASURE}{rows[0]['cpu']}.", fontsize=7, x=0.01, ha="left")
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels next to points must not move the panels
    place_labels(figure, labels, 7.0)
    figure.savefig(png)

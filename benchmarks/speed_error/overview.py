"""The README's picture, from the CSV's lines alone: one point per kind of method, with a label of its own."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from matplotlib.axes import Axes

from benchmarks.peers.libraries.ours_settings import DEFAULTS, SAME_MESHES
from benchmarks.speed_error.labels import Label, place_labels
from benchmarks.speed_error.picture import OURS, STYLES, panels, put_star, same_limits, worlds_of
from benchmarks.speed_error.points import SILENT, Line, Point, family, is_ours, peer_label, points_of

OUR_NAMES = {DEFAULTS: "this package", SAME_MESHES: "this package\non others' meshes"}
NAMES = {
    "exact distances": "exact distances\nat all vertices",
    "distance grids": "distance grids",
    "convex decompositions": "convex decomposition",
    "convex hulls": "convex hulls",
    "triangle meshes": "triangle meshes",
}


def draw_overview(rows: Sequence[Line], png: Path) -> None:
    """Time of the update after a fracture, and of a query, against mean error in jittered frames; one per family."""
    worlds = worlds_of(rows)
    chosen = _representatives(points_of(rows, worlds[0][0], "jitter", ["jitter_native"]))
    figure, grid = panels(worlds, 9.0, (3.2, 3.2))
    labels = []
    for panel, column, words in zip(
        grid, ("update", "jitter_native"), ("update after the fracture [ms]", "query of all contacts [ms]"), strict=True
    ):
        for axes, (world, title) in zip(panel, worlds, strict=True):
            labels += _points(axes, points_of(rows, world, "jitter", [column]), chosen)
            axes.set_title(title.split(" (")[0], fontsize=11)
            axes.set_xlabel(words, fontsize=9)
        same_limits(panel)
        panel[0].set_ylabel("mean error of a pair [% R]", fontsize=9)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")  # labels next to points must not move the panels
    place_labels(figure, labels, 9.0, radius=8.0)
    figure.savefig(png)


def _representatives(points: Sequence[Point]) -> set[str]:
    """Of each family the method with the smallest error where cracks are curved."""
    best: dict[str, Point] = {}
    for point in points:
        if not is_ours(point) and point.method != SILENT:
            before = best.setdefault(family(point), point)
            if point.mean < before.mean:
                best[family(point)] = point
    return {point.method for point in best.values()}


def _points(axes: Axes, points: Sequence[Point], chosen: set[str]) -> list[Label]:
    labels = []
    for point in points:
        if point.method in chosen:
            name = family(point)
            color, marker = STYLES[name]
            axes.plot(point.time, point.mean, marker, color=color, ms=8, mec="white", mew=0.6)
            labels.append(Label(axes, point.time, point.mean, f"{NAMES[name]}\n({_library(point)})", color))
    for point in points:
        if point.method in OUR_NAMES:
            put_star(axes, point, point.mean, 17)
            labels.insert(0, Label(axes, point.time, point.mean, OUR_NAMES[point.method], OURS))
    axes.margins(0.25, 0.2)
    return labels


def _library(point: Point) -> str:
    return peer_label(point).split(",")[0].removesuffix(" 24³").replace("grids", "24³ each")

"""Converts rows of the CSV to points of the picture: times and errors, families, our settings with their values."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from benchmarks.peers.libraries.ours_settings import DEFAULTS, EVERY_CONTACT, RESOLUTION
from fracture_collision.world import Settings

SILENT = "nothing reported"  # a method whose answers have no contacts
# Methods other than ours and SILENT, by substring of their names; the first match applies.
FAMILIES = {
    "exact distances": r"exact",
    "distance grids": r"grids|sdf",
    "convex decompositions": r"decomposition|v-hacd|coacd",
    "convex hulls": r"hull",
    "triangle meshes": r"mesh|concave",
}
_DEFAULTS = Settings._field_defaults | {RESOLUTION: 10}  # approximately that of either body of `make_world`
# Parts of a method's name that repeat its family.
_REDUNDANT = re.compile(r" (hull|mesh|concave|decomposition)|exact vertices \(|\)")


class Point(NamedTuple):
    """One method or setting in one world and kind of frame."""

    method: str
    time: float  # [ms]
    mean: float  # [% R]
    worst: float  # [% R]


Line = Mapping[str, str]  # a CSV line, by column


def points_of(rows: Sequence[Line], world: str, kind: str, times: Sequence[str]) -> list[Point]:
    """All methods that answered in `world`: the sum of the columns `times` against errors in frames of `kind`.

    Without times within the library, those of the whole call from Python count.
    """
    found = []
    for row in rows:
        spent = (row.get(c) or row[c.replace("native", "query")] for c in times)
        cells = [*spent, *(row[c] for c in (f"{kind}_solver_error_mean", f"{kind}_solver_error_max"))]
        if row["world"] == world and all(cells):
            *seconds, mean, worst = map(float, cells)
            found.append(Point(row["method"], sum(seconds), 100.0 * mean, 100.0 * worst))
    return found


def is_ours(point: Point) -> bool:
    return point.method.split(",")[0] == DEFAULTS


def family(point: Point) -> str:
    return next(name for name, pattern in FAMILIES.items() if re.search(pattern, point.method))


def peer_label(point: Point) -> str:
    return _REDUNDANT.sub("", point.method).replace("^3", "³")


def setting_lines(points: Sequence[Point]) -> dict[str, list[tuple[str, Point]]]:
    """Each setting's name to its points in the order of its values, including the default's, with their labels."""
    default = next((p for p in points if p.method == DEFAULTS), None)
    lines: dict[str, list[tuple[str, Point]]] = {}
    for point in points:
        if is_ours(point) and "=" in point.method:
            setting, value = point.method.removeprefix(f"{DEFAULTS}, ").split("=")
            lines.setdefault(setting, []).append((value, point))
    for setting, line in lines.items():
        if default is not None:
            line.append((str(_DEFAULTS.get(setting, "")), default))
        line.sort(key=lambda item: _number(item[0]))
        lines[setting] = [("" if p is default else _words(setting, value), p) for value, p in line]
    return lines


def _number(value: str) -> float:
    try:
        return float(value)
    except ValueError:
        return math.inf


def _words(setting: str, value: str) -> str:
    if setting == "contacts_per_pair":
        return "every contact" if int(value) == EVERY_CONTACT else value
    if setting == "penetration_tolerance":
        return f"{100.0 * float(value):g} %"
    return value

"""Errors of both fields against libigl's distance from independently built surfaces: about ten minutes.

    python benchmarks/field_errors.py

Prints the tables of docs/accuracy.md, 'The two fields', and writes docs/field_errors.csv and docs/field_errors.png.
"""

from __future__ import annotations

import csv
import math
import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the oracles live with the tests
matplotlib.use("Agg")

from matplotlib import pyplot as plt  # noqa: E402
from scipy.interpolate import RegularGridInterpolator  # noqa: E402
from truth.field_truth import FIELDS, INWARD, NEAR, Said, Truth, ask, igl_closest, make_truth, uniform_points  # noqa: E402
from worlds.fractured_worlds import after_each_fracture, fractured_world  # noqa: E402

from fracture_collision.core.glondu2014 import interior_field  # noqa: E402
from fracture_collision.core.mesh.tet_mesh import build_tet_mesh  # noqa: E402
from fracture_collision.geometry.generators import (  # noqa: E402
    ball,
    brick,
    shell,
    torus,  # noqa: E402
)
from fracture_collision.geometry.stored_meshes import bunny  # noqa: E402
from fracture_collision.world import Settings  # noqa: E402

SETTINGS = Settings(threads=1, method="glondu2014")  # keeps the averaged field; the exact one needs nothing kept
SEEDS, GENERATIONS, POINTS = 4, 5, 4000
DEEP = 0.10  # of R
TOO_LARGE = 0.001  # of R
WRONG_WAY = math.radians(30.0)
STILL_RISES = 0.5  # of a step: a larger growth of the exact depth shows that the step ends before the middle
DEPTH_EDGES = np.array([0.0, 0.5, 1, 2, 3, 5, 7, 10, 14, 18, 24, 32]) / 100.0

# Half the longest side, R, is 1 m for all.
BODIES = {
    "ball": ball(1.0, 0.25),
    "fine ball": ball(1.0, 0.15),
    "brick": brick((2.0, 1.0, 0.8), 0.2),
    "shell": shell(1.0, 0.6, 0.4),
    "torus": torus(0.72, 0.28, 0.2),
    "bunny": bunny(2.0),
}
RADIUS = 1.0

LEGEND = """
Lengths in % of R. mean, 99 %, worst: error of the depth, at points spread evenly over the volume; n: at points less
than 2 % R deep, most of them about places on the border spread evenly over its area; d: at points more than 10 % R
deep; over: share of evenly spread points whose depth is more than 0.1 % R too large; angle, 99 %: degrees between the
direction and that to the nearest point, evenly spread points; n angle, n angle 99: the same near the surface; off 30:
share of evenly spread points more than 30 degrees off; falls: share of steps of 1 % R, from evenly spread points
against the field's own direction, that end less deep; true falls: the same, of the steps straight away from the nearest
point that end before the middle (the exact depth rises by more than half a step); slack: the depth that is certainly
not exceeded, less the true one, mean over evenly spread points.
"""


class Measured(NamedTuple):
    """Points with their ground truth, and the answers of one field and of the exact one."""

    truth: Truth
    said: Said
    exact: Said


def main() -> None:
    print(f"{SEEDS} Voronoi seeds a fracture, the largest fragment again and again; {POINTS} points a row\n")
    rows, pooled, open_by = [], {}, 0.0
    print(_line(COLUMNS))
    for body in BODIES:
        for cracks in ("flat", "curved"):
            parts: dict[str, list[Measured]] = {field: [] for field in FIELDS}
            last = fractured_world(BODIES[body], SEEDS, GENERATIONS, cracks == "curved", SETTINGS)
            for case in after_each_fracture(last):
                truth = make_truth(case, POINTS, RADIUS, seed=case.generations)
                open_by = max(open_by, truth.open_by)
                said = {field: ask(case, truth, field, RADIUS) for field in FIELDS}
                for field, its in said.items():
                    parts[field].append(Measured(truth, its, said["exact"]))
                    rows.append((body, cracks, case.generations, field, *figures(parts[field][-1])))
                    print(_line(rows[-1]), flush=True)
            for field in FIELDS:
                pooled[field, body, cracks] = _together(parts[field])
    print("\nAll generations of a body together")
    print(_line(COLUMNS))
    for (field, body, cracks), measured in pooled.items():
        print(_line((body, cracks, f"1-{GENERATIONS}", field, *figures(measured))))
    print(LEGEND)
    print(f"winding numbers of the surfaces about points inside: within {open_by:.1e} of 1")
    exact = _together([m for (field, _, _), m in pooled.items() if field == "exact"])
    error = np.abs(exact.said.depth - exact.truth.depth)
    print(f"exact, all together: {len(error)} points, worst error {error.max():.1e} R\n")
    grid_errors()
    with (ROOT / "docs" / "field_errors.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([_text(value) for value in row] for row in rows)
    draw(rows, pooled)


COLUMNS = (
    "body", "cracks", "gen", "field", "mean", "99 %", "worst", "n mean", "n 99 %", "n worst", "d mean", "d 99 %",
    "d worst", "over", "angle", "angle 99", "n angle", "n angle 99", "off 30", "falls", "true falls", "slack",
)  # fmt: skip


def figures(measured: Measured) -> tuple[float, ...]:
    """The row of COLUMNS from "mean" on."""
    truth, said, exact = measured
    error = 100.0 * np.abs(said.depth - truth.depth)
    angle = _angles(truth, said)
    even, near, deep = truth.is_uniform, truth.depth < NEAR, truth.depth > DEEP
    inside = even & np.isfinite(said.rise)
    before_middle = even & (exact.true_rise > STILL_RISES * INWARD)
    return (
        *_mean_99_worst(error[even]), *_mean_99_worst(error[near]), *_mean_99_worst(error[deep]),
        float((said.depth - truth.depth > TOO_LARGE)[even].mean()),
        *_mean_99_worst(np.degrees(angle[even]))[:2], *_mean_99_worst(np.degrees(angle[near]))[:2],
        float((angle > WRONG_WAY)[even].mean()), float((said.rise < 0.0)[inside].mean()),
        float((said.true_rise < 0.0)[before_middle].mean()), 100.0 * float((said.most - truth.depth)[even].mean()),
    )  # fmt: skip


def _angles(truth: Truth, said: Said) -> np.ndarray:
    """(n,) [rad]; nan where the point is too close to the surface for a true direction."""
    # from the chord: near 1 the arc cosine loses half its digits
    chord = np.linalg.norm(said.outward - truth.outward, axis=1)
    angle = 2.0 * np.arcsin(np.minimum(0.5 * chord, 1.0))
    return np.where(np.any(truth.outward != 0.0, axis=1), angle, np.nan)


def _mean_99_worst(values: np.ndarray) -> tuple[float, float, float]:
    values = values[np.isfinite(values)]
    if not len(values):
        return math.nan, math.nan, math.nan
    return float(values.mean()), float(np.quantile(values, 0.99)), float(values.max())


def _together(parts: list[Measured]) -> Measured:
    truths, saids, exacts = zip(*parts, strict=True)
    return Measured(
        Truth(*(np.concatenate(column) for column in zip(*(t[:-1] for t in truths), strict=True)), 0.0),
        *(Said(*(np.concatenate(column) for column in zip(*side, strict=True))) for side in (saids, exacts)),
    )


def _text(value: float | str | int) -> str:
    if not isinstance(value, float):
        return str(value)
    return f"{float(f'{value:.2g}'):g}"


def _line(cells: tuple) -> str:
    return "".join(f"{_text(cell):>11}" for cell in cells)


def grid_errors() -> None:
    """Error of the dense grid that caps the averaged field, in unbroken bodies, by grid resolution."""
    print("the dense grid of whole bodies alone: error in % of R (mean, 99 %, worst), grid points a tetrahedron")
    kept = interior_field.CELLS_PER_EDGE
    for name, body in BODIES.items():
        mesh = build_tet_mesh(*body)
        points = uniform_points(*body, POINTS, np.random.default_rng(3))
        true = igl_closest(points, mesh.nodes[mesh.surface])[0]
        for cells in (1, 2, 3, 4):
            interior_field.CELLS_PER_EDGE = cells
            interior = interior_field.make_interior_field(mesh)
            axes = [interior.origin[d] + interior.cell * np.arange(interior.dims[d]) for d in range(3)]
            cap = RegularGridInterpolator(axes, interior.depth.reshape(interior.dims))(points)
            error = _mean_99_worst(100.0 * np.abs(np.maximum(cap, 0.0) - true) / RADIUS)
            print(_line((name, f"{cells} an edge", *error, len(interior.depth) / len(mesh.tetrahedra))))
    interior_field.CELLS_PER_EDGE = kept


def draw(rows: list[tuple], pooled: dict[tuple[str, str, str], Measured]) -> None:
    figure, (by_depth, angles, by_generation) = plt.subplots(1, 3, figsize=(14, 4.2))
    middle = 50.0 * (DEPTH_EDGES[:-1] + DEPTH_EDGES[1:])
    for cracks, color in (("flat", "tab:blue"), ("curved", "tab:red")):
        both = _together([m for (field, _, c), m in pooled.items() if (field, c) == ("averaged", cracks)])
        index = np.digitize(both.truth.depth, DEPTH_EDGES) - 1
        error = 100.0 * np.abs(both.said.depth - both.truth.depth)
        degrees = np.degrees(_angles(both.truth, both.said))
        for axes, values in ((by_depth, error), (angles, degrees)):
            statistics = [_mean_99_worst(values[index == i]) for i in range(len(middle))]
            for k, (label, style) in enumerate((("mean", "-"), ("99 %", ":"))):
                axes.plot(middle, [s[k] for s in statistics], style, color=color, label=f"{cracks}: {label}")
        for name, marker in zip(BODIES, "os^vDx", strict=True):
            own = [r for r in rows if (r[0], r[1], r[3]) == (name, cracks, "averaged")]
            by_generation.plot(
                [r[2] for r in own], [r[4] for r in own], f"-{marker}", color=color, alpha=0.7,
                label=name if cracks == "flat" else None,
            )  # fmt: skip
    by_depth.set(
        xlabel="true depth [% R]", ylabel="error of the depth [% R]", title="averaged: depth (exact: below 1e-13)"
    )
    angles.set(xlabel="true depth [% R]", ylabel="degrees", title="averaged: direction, off the nearest point's")
    by_generation.set(
        xlabel="generation", ylabel="mean error of the depth [% R]", title="averaged: flat (blue), curved (red)"
    )
    by_generation.set_ylim(bottom=0.0)
    by_generation.set_xticks(range(1, GENERATIONS + 1))
    for axes in (by_depth, angles, by_generation):
        axes.legend(fontsize=7, ncols=2, loc="upper left")
        axes.set_ylim(top=1.2 * axes.get_ylim()[1])
        axes.grid(alpha=0.3)
    figure.tight_layout()
    figure.savefig(ROOT / "docs" / "field_errors.png", dpi=80)


if __name__ == "__main__":
    main()

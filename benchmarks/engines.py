"""Every scene with either engine: `python -m benchmarks.engines`.

Times of a step by part, in one process on one thread; how deep bodies are in each other, ever and at the end; how fast
the fastest is at the end; and the largest rise of the energy in a step, as a share of the energy then, but for steps in
which a body joins or something breaks. Whether a run is right is what benchmarks.scene_seeds --engine judges.

A second table: how far the pieces of something move that breaks where it lies, without a blow.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import pairwise, product
from pathlib import Path
from typing import Any, NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from fracture_collision.extras import MissingExtra
from fracture_collision.lockstep import Exchange, Lockstep
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import (
    ENGINES,
    Scene,
    SceneError,
    load_scene,
    parse_scene,
    scene_files,
)
from fracture_collision.world import Settings

MILLI, MICRO = 1e3, 1e6
WIDTH = 130  # of the table, which is wider than many terminals


class Row(NamedTuple):
    """Figures of a run: milliseconds, millimetres, millimetres per second."""

    scene: str
    engine: str
    pieces: int
    contacts: float  # mean
    service: float  # mean
    physics: float  # mean
    worst: float  # longest step
    at_fracture: float  # longest step after a fracture
    deepest: float  # ever
    deepest_at_end: float
    fastest_at_end: float
    rise: float  # of the energy, see above


def rise_of(exchanges: list[Exchange]) -> float:
    """The largest share by which energy rises in a step in which no body joins or breaks."""
    largest, rise = 1e-300, 0.0
    for before, after in pairwise(exchange.report for exchange in exchanges):
        energies = [each.kinetic_energy + each.potential_energy for each in (before, after)]
        largest = max(largest, abs(energies[0]))
        if before.fragments == after.fragments and not (before.events or after.events):
            rise = max(rise, (energies[1] - energies[0] - after.hand_energy) / largest)
    return rise


def run_of(scene: Scene) -> Row:
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step)) as run:
        exchanges = list(run)
    totals = MILLI * np.array([exchange.times.total for exchange in exchanges])
    broke = np.array([bool(exchange.report.events) for exchange in exchanges])
    after = np.append(False, broke[:-1])  # the pieces' first step
    depths = -MILLI * np.array([exchange.report.deepest_gap for exchange in exchanges])  # not a robot's in itself
    last = exchanges[-1].report
    return Row(
        scene.name, scene.engine, last.fragments, float(np.mean([len(x.contacts.gaps) for x in exchanges])),
        MILLI * float(np.mean([x.times.collision for x in exchanges])),
        MILLI * float(np.mean([x.times.physics for x in exchanges])), float(totals.max()),
        float(totals[broke | after].max(initial=0.0)), float(depths.max()), float(depths[-1]),
        MILLI * last.max_speed, rise_of(exchanges),
    )  # fmt: skip


class Snug(NamedTuple):
    """A body that breaks where it lies."""

    body: str
    engine: str
    pieces: int
    moved: float  # [um] the farthest that a piece moves from where it was in the whole, at the end
    speed: float  # [um/s] of the fastest, at the end


SNUG = {
    "slab": {"brick": {"size_xyz": [0.3, 0.3, 0.05], "edge_length": 0.025}},
    "plate": {"brick": {"size_xyz": [0.3, 0.3, 0.02], "edge_length": 0.02}},
}
BREAKS_AT, SNUG_TIME = 100, 2.25  # step, [s]


def snug_of(name: str, engine: str) -> Snug:
    """Pieces of a body on a floor, two seconds after it has broken."""
    height = SNUG[name]["brick"]["size_xyz"][2]  # type: ignore[index]
    fracture = {"strength": 1e3, "minimum_mass": 0.0, "pattern": {"seeds": 12, "minimum_nodes": 8}}
    content = {
        "time_step": 0.0025, "duration": SNUG_TIME, "solver": {"sleep_time": 0.0},
        "materials": {"clay": {"density": 2000.0, "friction": 0.6, "fracture": fracture}},
        "bodies": [
            {"name": "floor", "material": "clay", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}},
            {"name": name, "material": "clay", "shape": SNUG[name], "position": [0.0, 0.0, 0.5001 * height]},
        ],
    }  # fmt: skip
    scene = with_engine(parse_scene(content, name), engine)
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step)) as run:
        for step in range(scene.step_count):
            if step == BREAKS_AT:
                start = run.simulation.dynamics.states().frame_positions[0]
                run.simulation.strike(2, np.array([0.0, 0.0, 0.5 * height]), 3.0)
            run.step()
        states = run.simulation.dynamics.states()
    moved, speeds = (np.sqrt((v * v).sum(axis=1)).max() for v in (states.frame_positions - start, states.linear))
    return Snug(name, engine, len(states.masses), MICRO * float(moved), MICRO * float(speeds))


def snug_table_of(rows: list[Snug]) -> Table:
    table = Table("breaks where it lies", "engine", "pieces", "moved, um", "um/s", title="two seconds later")
    for row in rows:
        table.add_row(row.body, row.engine, str(row.pieces), f"{row.moved:.3g}", f"{row.speed:.3g}")
    return table


def table_of(rows: list[Row]) -> Table:
    names = (
        "scene", "engine", "pieces", "contacts", "service", "physics", "worst", "at fracture", "deepest", "at the end",
        "mm/s", "energy",
    )  # fmt: skip
    table = Table(*(Column(name, no_wrap=True) for name in names), title="means and worst of a step (ms), depths (mm)")
    for row in rows:
        table.add_row(
            row.scene, row.engine, str(row.pieces), f"{row.contacts:.0f}",
            *(f"{value:.2f}" for value in (row.service, row.physics, row.worst, row.at_fracture, row.deepest)),
            f"{row.deepest_at_end:.3f}", f"{row.fastest_at_end:.3f}", f"{row.rise:.0e}",
        )  # fmt: skip
    return table


def show(table: Table, rows: Sequence[Any], texts: int, csv_path: Path | None) -> None:
    """Print the table, and write the rows, NamedTuples of `texts` texts and integers, then numbers, to a file."""
    console = Console()
    console.width = max(console.width, WIDTH)
    console.print(table)
    if csv_path:
        with csv_path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(rows[0]._fields)
            writer.writerows([*row[:texts], *(f"{value:.4g}" for value in row[texts:])] for row in rows)


@click.command(epilog="Example: python -m benchmarks.engines plates bricks --csv docs/engines.csv")
@click.argument("scenes", nargs=-1, metavar="[SCENES]...")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="File for a row per run.")
def main(scenes: tuple[str, ...], csv_path: Path | None) -> None:
    """Run SCENES, all of them unless given, with either engine; the first run of each loads kernels."""
    names = scenes or tuple(file.path.stem for file in scene_files())
    try:
        cases = [with_engine(load_scene(name), engine) for name, engine in product(names, ENGINES)]
    except (SceneError, MissingExtra) as error:
        raise click.ClickException(str(error)) from error
    for engine in ENGINES:
        run_of(with_engine(load_scene("pane"), engine))
    rows = [run_of(case) for case in track(cases, "runs", console=Console(stderr=True))]
    show(table_of(rows), rows, 3, csv_path)
    Console().print(snug_table_of([snug_of(*case) for case in product(SNUG, ENGINES)]))


if __name__ == "__main__":
    main()

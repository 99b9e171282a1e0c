"""Whether scenes end as they should, with ten seeds each: `python -m benchmarks.scene_seeds`."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from benchmarks.scene_seeds.judging import EPSILON, ROUNDING, SPEED_AT_REST, Verdict, judged
from benchmarks.studies.scene_trials import CURVATURE, scene_with
from fracture_collision.extras import MissingExtra
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene, scene_files
from fracture_collision.simulation.scene.scene_changes import random_drop
from fracture_collision.world import Settings

OWN = "own"
WIDTH = 140  # of the table, which is wider than many terminals
DROPPED = ("plate_in_bowl",)  # what such a scene is for, says its file
# Of a scene in which nothing breaks and nothing is dropped: less than the 0.2 mm between the bricks of a wall.
NUDGE = 5e-5  # [m] each way along, and up
NUDGE_SPEED = 0.01  # [m/s] each way along


class Run(NamedTuple):
    """A run of a scene, and what was found."""

    scene: str
    cracks: str
    seed: int
    found: Verdict


def nudged(scene: Scene, seed: int) -> Scene:
    """The scene with each movable body moved a little, and given a small velocity along the ground."""
    random = np.random.default_rng(seed)
    bodies = []
    for body in scene.bodies:
        if not body.is_static:
            aside, speed = random.uniform(-1.0, 1.0, 2), random.uniform(-1.0, 1.0, 2)
            body = body._replace(
                position=body.position + NUDGE * np.append(aside, random.uniform(0.0, 1.0)),
                linear_velocity=body.linear_velocity + NUDGE_SPEED * np.append(speed, 0.0),
            )
        bodies.append(body)
    return scene._replace(bodies=tuple(bodies))


def scene_of(name: str, cracks: str, seed: int) -> Scene:
    """The scene for runs with `seed`: as it is where cracks depend on the seed, else with other starts."""
    scene = load_scene(name) if cracks == OWN else scene_with(name, cracks)
    if any(body.material.fracture is not None for body in scene.bodies):
        return scene
    return random_drop(scene, seed) if name in DROPPED else nudged(scene, seed)


def run_of(name: str, cracks: str, seed: int, engine: str | None = None) -> Run:
    scene = with_engine(scene_of(name, cracks, seed), engine)
    return Run(name, cracks, seed, judged(scene, Settings(threads=1, lookahead=scene.time_step), seed))


def table_of(runs: Sequence[Run]) -> Table:
    columns = (
        "scene", "cracks", "right", "at rest", "unsup.", "deepest, % R", "mm", "listed, % R", "energy", "solved",
        "steps",
    )  # fmt: skip
    table = Table(*(Column(name, no_wrap=True) for name in columns), title="the worst figure of each scene")
    for name, cracks in dict.fromkeys((run.scene, run.cracks) for run in runs):
        found = [run.found for run in runs if (run.scene, run.cracks) == (name, cracks)]
        overlap = max((each.overlap for each in found), key=lambda overlap: overlap.depth)
        table.add_row(
            name, cracks, f"{sum(not each.faults for each in found)} / {len(found)}",
            f"{sum(each.at_rest for each in found)} / {sum(each.fragments for each in found)}",
            str(sum(len(each.unsupported) for each in found)),
            f"{100.0 * overlap.depth:.3f}", f"{1e3 * overlap.depth_m:.3f}",
            f"{100.0 * max(each.overlap.listed for each in found):.3f}",
            f"{max(each.rise.share for each in found):.0e}", f"{max(each.rise.solved for each in found):.0e}",
            f"{sum(each.rise.judged for each in found)} / {sum(each.steps for each in found)}",
        )  # fmt: skip
    return table


def write(runs: Sequence[Run], path: Path) -> None:
    """A row per run."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((
            "scene", "cracks", "seed", "right", "fragments", "at_rest", "unsupported", "deepest_R", "deepest_mm",
            "deepest_a", "deepest_b", "listed_R", "energy_rise", "lifted", "solved",
            "energy_step", "judged_steps", "steps",
        ))  # fmt: skip
        for name, cracks, seed, found in runs:
            deep, rise = found.overlap, found.rise
            writer.writerow((
                name, cracks, seed, not found.faults, found.fragments, found.at_rest, len(found.unsupported),
                f"{deep.depth:.3e}", f"{1e3 * deep.depth_m:.4f}", *deep.fragments,
                f"{deep.listed:.3e}", f"{rise.share:.1e}", f"{rise.lifted:.1e}", f"{rise.solved:.1e}",
                rise.step, rise.judged, found.steps,
            ))  # fmt: skip


EPILOG = f"""\b
What must hold at the end of each run, and in each of its steps:
  unsup.       no body at rest is unsupported: contact forces within the friction cones carry it
               (test/truth/static_support.py)
  deepest      no body at rest is deeper in another than epsilon, {100.0 * EPSILON:g} % of R, half the longest side
               of the smaller one; by all samples and, where these leave it open, by libigl over
               whole surfaces. listed: the deepest contact of the answer that the simulator itself
               gets
  energy       kinetic and potential energy is no larger than in the step before, to {ROUNDING:g} of the
               largest so far; the work of a hand is subtracted. solved: what drift correction
               lifted is subtracted too; this does not count for right. steps: those judged: not
               those in which a body joins or a robot does work

\b
At rest is what moves by less than {1e3 * SPEED_AT_REST:g} mm/s, in velocity and in place. Seeds are those of the
fracture patterns. Where nothing breaks, bodies start elsewhere: dropped anew (plate_in_bowl), or
moved by {1e6 * NUDGE:.0f} um and {1e3 * NUDGE_SPEED:.0f} mm/s (wall, rolling_plate).

\b
Examples:
  python -m benchmarks.scene_seeds                               all scenes, a quarter of an hour
  python -m benchmarks.scene_seeds pane bricks --cracks flat,curved
  python -m benchmarks.scene_seeds bricks --seeds 1 --first 7    one run again
"""


@click.command(context_settings={"max_content_width": 120}, epilog=EPILOG)
@click.argument("scenes", nargs=-1, metavar="[SCENES]...")
@click.option("--seeds", default=10, show_default=True, type=click.IntRange(min=1), help="Of each scene.")
@click.option("--first", default=0, show_default=True, type=click.IntRange(min=0), help="The first seed.")
@click.option("--cracks", default=OWN, show_default=True, help=f"Of {OWN} (the scene's), {', '.join(CURVATURE)}.")
@click.option("--engine", help="That solves contacts: own or mujoco.  [default: the scene's]")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="File for a row per run.")
def main(
    scenes: tuple[str, ...], seeds: int, first: int, cracks: str, engine: str | None, csv_path: Path | None
) -> None:  # fmt: skip
    """Run scenes to their end with many seeds and judge each run.

    SCENES are those that `fracture-collision scenes` lists, also NAME:VARIANT; all of them unless given. Each runs at
    its defaults, on one thread.
    """
    names = scenes or tuple(file.path.stem for file in scene_files())
    if unknown := set(cracks.split(",")) - {OWN, *CURVATURE}:
        raise click.ClickException(f"--cracks {', '.join(sorted(unknown))}: none of {', '.join((OWN, *CURVATURE))}")
    try:
        for name in names:
            with_engine(load_scene(name), engine)
    except (SceneError, MissingExtra) as error:
        raise click.ClickException(str(error)) from error
    cases = list(product(names, cracks.split(","), range(first, first + seeds)))
    progress = Console(stderr=True)
    runs = [run_of(*case, engine) for case in track(cases, "runs", console=progress)]
    console = Console()
    console.width = max(console.width, WIDTH)
    console.print(table_of(runs))
    for run in runs:
        if run.found.faults:
            click.echo(f"{run.scene} {run.cracks} seed {run.seed}: {'; '.join(run.found.faults)}")
    console.print(f"{sum(not run.found.faults for run in runs)} of {len(runs)} right")
    if csv_path:
        write(runs, csv_path)


if __name__ == "__main__":
    main()

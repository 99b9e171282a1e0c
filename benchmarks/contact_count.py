"""How many contacts a pair needs, and what their ids are for: `python -m benchmarks.contact_count`.

Whole scenes with the package's own engine, without sleeping, so that what rests is solved to the end. "cold": each step
starts from no impulses instead of those of the last step's contacts with the same ids. "kept": of the contacts at rest,
in the last hundred steps, the share whose id was listed in the step before.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Column, Table

from benchmarks.engines import show
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.dynamics import Given, Solved
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene
from fracture_collision.simulation.solver.warm_start import NO_WARM_START
from fracture_collision.world import Settings

COUNTS = (2, 4, 8, 16, 50)
DEFAULT = Settings().contacts_per_pair
LAST = 100  # steps
MILLI = 1e3


class Cold(OwnDynamics):
    """Starts each step from no impulses."""

    def solve(self, given: Given) -> Solved:
        self._warm_start = NO_WARM_START
        return super().solve(given)


class Row(NamedTuple):
    """Figures of a run: milliseconds and millimetres."""

    scene: str
    per_pair: int
    start: str  # warm or cold
    contacts: float  # mean
    service: float  # mean
    solver: float  # mean
    deepest: float  # mean over all steps
    deepest_at_rest: float  # in the last steps
    speed_at_rest: float  # [mm/s]
    kept: float


def ids_of(contacts: ContactConstraintArray, most: float) -> set[tuple[int, int, int]]:
    """Fragments and ids of the contacts with a gap of at most `most` [m]."""
    counts, near = np.diff(contacts.pair_begin), contacts.gaps <= most
    columns = np.repeat(contacts.fragment_a, counts), np.repeat(contacts.fragment_b, counts), contacts.contact_ids
    return set(zip(*(column[near].tolist() for column in columns), strict=True))


def shares_kept(answers: list[ContactConstraintArray], most: float) -> Iterator[float]:
    listed = [ids_of(contacts, most) for contacts in answers]
    for before, after in zip(listed, listed[1:], strict=False):
        yield len(before & after) / len(after) if after else 1.0


def run_of(scene: Scene, per_pair: int, is_warm: bool) -> Row:
    settings = Settings(threads=1, lookahead=scene.time_step, contacts_per_pair=per_pair)
    dynamics = (OwnDynamics if is_warm else Cold)(scene.time_step, scene.gravity, scene.solver, looks_ahead=True)
    with Lockstep(scene, settings, dynamics=dynamics) as run:
        exchanges = list(run)
    least = min(body.shape.half_length() for body in scene.bodies)
    depths = -MILLI * np.array([x.contacts.gaps.min(initial=0.0) for x in exchanges])
    answers = [x.contacts for x in exchanges[-LAST - 1 :]]
    return Row(
        scene.name, per_pair, "warm" if is_warm else "cold", float(np.mean([len(x.contacts.gaps) for x in exchanges])),
        MILLI * float(np.mean([x.times.collision for x in exchanges])),
        MILLI * float(np.mean([x.report.solver_seconds for x in exchanges])), float(depths.mean()),
        float(depths[-LAST:].max()), MILLI * max(x.report.max_speed for x in exchanges[-LAST:]),
        float(np.mean(list(shares_kept(answers, scene.solver.ahead_gap * least)))),
    )  # fmt: skip


def table_of(rows: list[Row]) -> Table:
    names = (
        "scene", "per pair", "start", "contacts", "service", "solver", "deepest", "at rest", "mm/s", "ids kept"
    )  # fmt: skip
    table = Table(*(Column(name, no_wrap=True) for name in names), title="means of a step (ms), depths (mm)")
    for row in rows:
        table.add_row(
            row.scene, str(row.per_pair), row.start, f"{row.contacts:.0f}", f"{row.service:.2f}", f"{row.solver:.2f}",
            f"{row.deepest:.3f}", f"{row.deepest_at_rest:.4f}", f"{row.speed_at_rest:.4f}", f"{100.0 * row.kept:.2f} %",
        )  # fmt: skip
    return table


@click.command(epilog="Example: python -m benchmarks.contact_count wall --csv docs/contact_count.csv")
@click.argument("scenes", nargs=-1, metavar="[SCENES]...")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), help="File for a row per run.")
def main(scenes: tuple[str, ...], csv_path: Path | None) -> None:
    """Run SCENES (wall, plates and bricks unless given) with 2 to 50 contacts a pair."""
    try:
        loaded = [load_scene(name) for name in scenes or ("wall", "plates", "bricks")]
    except SceneError as error:
        raise click.ClickException(str(error)) from error
    awake = [scene._replace(solver=scene.solver._replace(sleep_time=0.0)) for scene in loaded]
    cases = [(scene, count, True) for scene in awake for count in COUNTS]
    cases += [(scene, DEFAULT, False) for scene in awake]
    run_of(awake[0]._replace(duration=0.1), DEFAULT, True)  # loads kernels
    rows = [run_of(*case) for case in track(cases, "runs", console=Console(stderr=True))]
    rows.sort(key=lambda row: (row.scene, row.start == "cold", row.per_pair))
    show(table_of(rows), rows, 3, csv_path)


if __name__ == "__main__":
    main()

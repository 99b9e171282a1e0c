"""`python -m benchmarks.frames`: the states of whole scenes, answered by the service and by other libraries."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import click
import numpy as np

SCENES = ("plates", "plates@0.25", "bricks", "bricks@0.25", "drop_bunnies", "drop_bunnies@0.25")
WIDTH = 220  # columns of a table that no terminal's width was asked for


class Row(NamedTuple):
    """Milliseconds a step, one core; ratios of ours to rapier's hulls. Each step's least of several runs."""

    scene: str
    steps: int
    mean: float
    median: float
    worst: float
    rapier_mean: float
    rapier_worst: float
    mean_ratio: float  # all steps
    busy_ratio: float  # means while much moves
    worst_ratio: float
    at_rest: float  # mean of the last fifty steps
    again: float  # mean of the same states asked again
    update: float  # median
    rapier_update: float  # median
    digest: str  # of all our answers


def measure(scene: str, runs: int) -> Row:
    from benchmarks.frames.measure import Times, is_busy, ours, peers
    from benchmarks.frames.rapier_hulls import RapierHulls
    from benchmarks.frames.recording import record
    from fracture_collision.world import Settings

    recording, settings = record(scene), Settings(threads=1)
    ours(recording, settings)  # brings kernels into memory

    def least(all_times: list[Times]) -> Times:
        columns = (np.min([times[k] for times in all_times], axis=0) for k in range(3))
        return Times(*columns, all_times[0].digest)

    # turn by turn, as a machine is not equally quick all the time
    both = [(ours(recording, settings), peers(recording, RapierHulls)) for _ in range(runs)]
    own, rapier = least([a for a, _ in both]), least([b for _, b in both])
    again = ours(recording, settings, again=True)
    if again.digest != own.digest:
        raise RuntimeError(f"{scene}: other answers where each is asked twice")
    busy, broke = is_busy(recording), own.update > 0.0
    update, rapier_update = (float(np.median(t.update[broke])) if broke.any() else 0.0 for t in (own, rapier))
    return Row(
        scene, len(recording.steps), own.query.mean(), float(np.median(own.query)), own.query.max(),
        rapier.query.mean(), rapier.query.max(), own.query.mean() / rapier.query.mean(),
        own.query[busy].mean() / rapier.query[busy].mean() if busy.any() else float("nan"),
        own.query.max() / rapier.query.max(),
        own.query[-50:].mean(), float(np.mean(again.again)), update, rapier_update, own.digest[:12],
    )  # fmt: skip


@click.command(context_settings={"show_default": True})
@click.argument("scenes", nargs=-1)
@click.option("--runs", default=3, help="Of which each step's least counts.")
@click.option("--csv", "path", type=click.Path(path_type=Path, dir_okay=False), help="The table as a file.")
def main(scenes: tuple[str, ...], runs: int, path: Path | None) -> None:
    """Ours (all of CollisionWorld.contacts, one thread) beside rapier's hulls (its own step), at the states of SCENES
    (`bricks`, with curved cracks `bricks@0.25`), step by step. Needs the libraries of `make peers`.
    """
    from rich.console import Console

    from benchmarks.scaling.report import print_table, write_csv

    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    rows = []
    with Console(stderr=True).status("") as status:
        for scene in scenes or SCENES:
            status.update(f"{scene}: recorded, and asked {runs} times")
            rows.append(measure(scene, runs))
    print_table("frames of scenes", rows, console)
    if path:
        write_csv("frames", rows, path)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.frames")

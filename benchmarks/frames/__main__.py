"""`python -m benchmarks.frames`: the states of whole scenes, queried in the service and in other libraries."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import click
import numpy as np

if TYPE_CHECKING:
    from benchmarks.frames.errors import Errors
    from benchmarks.frames.measure import Times
    from benchmarks.frames.peer import Peer

SCENES = ("plates@0", "plates", "bricks", "bricks@0.25", "drop_bunnies", "drop_bunnies@0.25")  # plates crack curved
RAPIER = "rapier"
PEERS = {  # module and class
    RAPIER: "rapier_hulls:RapierHulls", "mujoco": "mujoco_hulls:MujocoHulls", "box3d": "box3d_hulls:Box3dHulls",
    "physx": "physx_hulls:PhysxHulls",
}  # fmt: skip
WIDTH = 220  # columns of a table if no terminal sets a width


class Row(NamedTuple):
    """Milliseconds per step, one core; ratios of ours to rapier's hulls.

    Each step's minimum of several runs; rapier's nan: not measured.
    """

    scene: str
    steps: int
    mean: float
    median: float
    worst: float
    rapier_mean: float
    rapier_worst: float
    mean_ratio: float  # all steps
    busy_ratio: float  # means over busy steps
    worst_ratio: float
    at_rest: float  # mean of the last fifty steps
    again: float  # mean when the same states are queried again
    update: float  # median
    rapier_update: float  # median
    digest: str  # of all our answers


class Beside(NamedTuple):
    """Milliseconds per step, one core; ratios of ours to a peer's over the same steps.

    Each step's minimum of several runs.
    """

    scene: str
    peer: str
    steps: str  # ALL or LAST
    count: int  # number of these steps
    mean: float
    worst: float
    peer_mean: float
    peer_worst: float
    mean_ratio: float
    busy_ratio: float  # means over busy steps
    worst_ratio: float


ALL, LAST = "all", "after the last fracture"


def measure(
    scene: str, runs: int, peers: dict[str, type[Peer]], error_steps: int = 0
) -> tuple[Row, list[Beside], list[Errors]]:
    """Ours against rapier and against each of `peers`, including rapier; errors at `error_steps` steps."""
    from benchmarks.frames.measure import at_last_registry, is_busy, ours, times_of
    from benchmarks.frames.recording import record

    recording = record(scene)
    settings = recording.settings
    ours(recording, settings)  # loads the kernels
    # interleaved, as the machine's speed varies over time
    rounds = [
        (ours(recording, settings), [times_of(recording, make) for make in peers.values()]) for _ in range(runs)
    ]  # fmt: skip
    own = _least([a for a, _ in rounds])
    theirs = {name: _least([times[k] for _, times in rounds]) for k, name in enumerate(peers)}
    again = ours(recording, settings, again=True)
    if again.digest != own.digest:
        raise RuntimeError(f"{scene}: other answers where each is asked twice")
    busy, every, last = is_busy(recording), np.ones(len(recording.steps), bool), at_last_registry(recording)
    besides = []
    for name, times in theirs.items():
        spans = {LAST: last} if peers[name].last_registry_only else {ALL: every, LAST: last}
        besides += [_beside(scene, name, span, own, times, chosen, busy) for span, chosen in spans.items()]
    errors = []
    if error_steps:
        from benchmarks.frames.errors import errors_of  # libigl is optional

        errors = errors_of(recording, settings, peers, error_steps)
    return _row(scene, own, theirs.get(RAPIER), again, busy), besides, errors


def _least(all_times: list[Times]) -> Times:
    columns = (np.min([times[k] for times in all_times], axis=0) for k in range(3))
    return type(all_times[0])(*columns, all_times[0].digest)


def _row(scene: str, own: Times, rapier: Times | None, again: Times, busy: np.ndarray) -> Row:
    broke = own.update > 0.0
    query, updates = (rapier.query, rapier.update) if rapier else 2 * [np.full(len(own.query), np.nan)]
    update, rapier_update = (float(np.median(t[broke])) if broke.any() else 0.0 for t in (own.update, updates))
    return Row(
        scene, len(own.query), own.query.mean(), float(np.median(own.query)), own.query.max(),
        query.mean(), query.max(), own.query.mean() / query.mean(), _mean_ratio(own.query, query, busy),
        own.query.max() / query.max(), own.query[-50:].mean(), float(np.mean(again.again)), update, rapier_update,
        own.digest[:12],
    )  # fmt: skip


def _beside(
    scene: str, peer: str, span: str, own: Times, times: Times, chosen: np.ndarray, busy: np.ndarray
) -> Beside:  # fmt: skip
    """`chosen`, `busy` (n,) bool, over all steps."""
    mine, its = own.query[chosen], times.query[chosen]
    return Beside(
        scene, peer, span, int(chosen.sum()), mine.mean(), mine.max(), its.mean(), its.max(),
        mine.mean() / its.mean(), _mean_ratio(own.query, times.query, chosen & busy), mine.max() / its.max(),
    )  # fmt: skip


def _mean_ratio(own: np.ndarray, its: np.ndarray, chosen: np.ndarray) -> float:
    return own[chosen].mean() / its[chosen].mean() if chosen.any() else float("nan")


def load(name: str) -> type[Peer]:
    """The class of a peer; raises a ClickException if its library is missing."""
    module, _, kind = PEERS[name].partition(":")
    try:
        return getattr(import_module(f"benchmarks.frames.{module}"), kind)
    except ImportError as error:
        raise click.ClickException(f"--peers {name}: {error}; `make peers` installs the libraries") from error


@click.command(context_settings={"show_default": True})
@click.argument("scenes", nargs=-1)
@click.option("--runs", default=3, help="Of which each step's least counts.")
@click.option("--peers", multiple=True, type=click.Choice(list(PEERS)), default=[RAPIER], help="Several allowed.")
@click.option("--errors", "error_steps", type=click.IntRange(0), default=0, help="Steps at which contacts are judged.")
@click.option("--csv", "path", type=click.Path(path_type=Path, dir_okay=False), help="The table as a file.")
def main(scenes: tuple[str, ...], runs: int, peers: tuple[str, ...], error_steps: int, path: Path | None) -> None:
    """Times ours beside rapier's hulls at the states of SCENES, step by step.

    Ours is all of CollisionWorld.contacts with one thread, rapier's its own step. A scene is `bricks`, or `bricks@0.25`
    with curved cracks. Needs the libraries of `make peers`.

    With other peers (`--peers rapier --peers mujoco`) a second table has ours beside each of them. MuJoCo compiles its
    world anew for each fracture, so it is timed after the last one only.

    With `--errors 8` a third table has pairs missed and falsely reported, and what a solver would see (penetration that
    remains and unnecessary displacement, % of the smaller R), by exact distances, at so many of the steps in which much
    moves. MuJoCo is judged at those after the last fracture; Box3D and PhysX list no contacts here.
    """
    from rich.console import Console

    from benchmarks.scaling.report import print_table, write_csv

    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    makers = {name: load(name) for name in dict.fromkeys(peers)}
    rows, besides, errors = [], [], []
    with Console(stderr=True).status("") as status:
        for scene in scenes or SCENES:
            status.update(f"{scene}: recorded, and asked {runs} times")
            row, others, judged = measure(scene, runs, makers, error_steps)
            rows.append(row)
            besides += others
            errors += judged
    print_table("frames of scenes", rows, console)
    if path:
        write_csv("frames", rows, path)
    if list(makers) != [RAPIER]:
        print_table("frames of scenes, ours beside each peer", besides, console)
        if path:
            write_csv("beside", besides, path)
    if errors:
        print_table("frames of scenes, errors", errors, console)
        if path:
            write_csv("errors", errors, path)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.frames")

"""`python -m campaigns.kills`: kills nodes of a running scene at random and reports whether it made a difference."""

from __future__ import annotations

import math
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click
import numpy as np

if TYPE_CHECKING:
    from rich.console import Console

    from campaigns.kills import trials
    from campaigns.kills.mixed import Mixed

INTERRUPTED = 130


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.option("--times", default=200, type=click.IntRange(min=1), help="How often the service is killed.")
@click.option("--others", default=20, type=click.IntRange(min=1), help="How often the simulator, and a listener.")
@click.option("--mixed", default=300, type=click.IntRange(min=0), help="SIGKILLs of service and recorder, also both.")
@click.option("--scene", default="plates", help="Name or file; fractures are part of most.")
@click.option("--seed", default=1, help="Of the instants.")
@click.option("--out", default=Path("out/kills"), type=click.Path(path_type=Path), help="Logs and bags.")
def main(times: int, others: int, mixed: int, scene: str, seed: int, out: Path) -> None:
    """SIGKILL to service, simulator and listeners at random instants of a running SCENE, over real DDS.

    The service has to come back with the same registry and the same answers, byte for byte, as in a run that nobody
    disturbed; neither processes nor files in shared memory may be left. Service and recorder are also killed while they
    start, at fractures and both at once; those that do not come back are counted. Ends with status 1 if any of this
    fails, with 130 if it was interrupted during the last part, whose figures are printed all the same.
    """
    from rich.console import Console

    from campaigns.kills import trials
    from campaigns.kills.mixed import kill_mixed
    from campaigns.kills.stage import litter
    from fracture_collision.cli.console import interrupt_on_signals

    interrupt_on_signals()
    console = Console()
    shutil.rmtree(out, ignore_errors=True)
    with _progress() as progress:
        progress("a run that nobody disturbs")
        before = litter()
        reference = trials.undisturbed(out / "undisturbed", scene)
        console.print(f"registry: {reference.registry}")
        services = trials.kill_services(out / "services", scene, times, seed, reference, progress)
        _print_returns(console, *services)
        simulators = trials.kill_simulators(out / "simulators", scene, others, seed, reference, progress)
        console.print(f"{others} simulators killed: {'the run after them differs' if simulators else 'no difference'}")
        listeners = trials.kill_listeners(out / "listeners", scene, others, seed, reference, progress)
        console.print(f"{others} listeners killed: {'the run differs' if listeners else 'no difference'}")
        faults = list(trials.orders_of_ending(out / "orders", scene, progress))
        console.print(f"SIGINT and SIGTERM in all orders: {len(faults)} faults")
        both = kill_mixed(out, scene, mixed, seed, progress)
    faults += [*both.faults, *both.deaf]
    _print_mixed(console, both, mixed)
    for fault in faults:
        console.print(f"  {fault}", markup=False)
    after = litter()
    files, processes = after.files - before.files, after.processes - before.processes
    console.print(f"left behind: {len(files)} files in shared memory, {len(processes)} processes")
    if services[1] or simulators or listeners or faults or files or processes:
        raise SystemExit(1)
    if both.is_interrupted:
        raise SystemExit(INTERRUPTED)


@contextmanager
def _progress() -> Iterator[Callable[[str], None]]:
    """A line that is replaced; a new line each half minute where there is no terminal."""
    from rich.console import Console

    errors, last = Console(stderr=True), -math.inf

    def print_seldom(text: str) -> None:
        nonlocal last
        if time.monotonic() - last > 30.0:
            last = time.monotonic()
            errors.print(text)

    if not errors.is_terminal:
        yield print_seldom
        return
    with errors.status("") as status:
        yield status.update


def _print_returns(console: Console, returns: list[trials.Return], different: int, lost: int) -> None:
    steps = [r.step for r in returns]
    console.print(f"{len(returns)} services killed, at steps {min(steps)} to {max(steps)}")
    ready, answered = (np.array([getattr(r, name) for r in returns]) for name in ("ready", "answered"))
    for name, seconds in (("ready", ready), ("its first answer there", answered[np.isfinite(answered)])):
        told = f"{np.median(seconds):.2f} s median, {seconds.max():.2f} s worst"
        console.print(f"  from its process being started to {name}: {told}")
    console.print(f"  runs that differ: {different}")
    console.print(f"  answers that were being said when their service was killed, and were not recorded: {lost}")


def _print_mixed(console: Console, both: Mixed, wanted: int) -> None:
    from campaigns.kills.mixed import medians

    cut = f" of {wanted}, interrupted" if both.is_interrupted else ""
    console.print(f"{both.kills}{cut} kills of service and recorder: {len(both.deaf)} deaf, {len(both.faults)} faults")
    for name, (count, median, worst) in medians(both.returns).items():
        told = f"{median:.2f} s median, {worst:.2f} s worst"
        console.print(f"  {name} killed, {count} times, to the first answer: {told}")
    console.print(f"  from SIGINT to a node's end: {both.longest_end:.2f} s worst")


if __name__ == "__main__":
    main(prog_name="python -m campaigns.kills")

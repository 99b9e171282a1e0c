"""One service, run after run of a smashed scene: whether its memory grows, and whether it slows down.

    python -m campaigns.soak

Every cycle smashes the same scene with the same seeds, so all are the same work: only the service's age differs. Time
is processor time, not wall-clock time, which other programs on the machine affect.
"""

from __future__ import annotations

import csv
import os
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import click

from campaigns.kills.stage import await_end, await_ready, must_end, stage
from fracture_collision.cli.console import interrupt_on_signals

SETTLING = 300.0  # [s] of a service's life before its memory is measured
TICKS = os.sysconf("SC_CLK_TCK")
GROWTH_ALLOWED, SLOWER_ALLOWED = 0.02, 0.10


class Cycle(NamedTuple):
    """All seeds once."""

    age: float  # [s] of the service at its end
    runs: int  # so far
    resident: float  # [MB] of the service after it
    processor: float  # [s] that the service needed for it


def soak(
    folder: Path, scene: str, seeds: int, seconds: float, listens: bool, progress: Callable[[str], None]
) -> Iterator[Cycle]:
    """Cycles, until `seconds` are over; `listens`: a recorder records everything, and each cycle's bag is deleted."""
    with stage(folder) as nodes:
        service = nodes.start("collision_node", threads=1)
        await_ready(service)
        began, runs = time.monotonic(), 0
        while time.monotonic() - began < seconds:
            before = processor_seconds(service.pid)
            bag = folder / "bag"
            recorder = nodes.start("recorder_node", folder=str(bag)) if listens else None
            for seed in range(1, seeds + 1):
                progress(f"{(time.monotonic() - began) / 60.0:.1f} of {seconds / 60.0:.0f} minutes, {runs} runs")
                simulator = nodes.start("simulator_node", scene=scene, seed=seed, wait_for_subscribers=1 + listens)
                await_end(simulator, service)
                must_end(simulator)
                nodes.forget(simulator)
                runs += 1
            if recorder is not None:
                must_end(recorder)
                nodes.forget(recorder)
                shutil.rmtree(bag)
            yield Cycle(time.monotonic() - began, runs, _resident(service.pid), processor_seconds(service.pid) - before)
        must_end(service)


def _resident(pid: int) -> float:
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")


def processor_seconds(pid: int) -> float:
    """Processor time that a process has used so far."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(words[11]) + int(words[12])) / TICKS


def growth(cycles: list[Cycle]) -> tuple[float, float]:
    """Growth of memory and of processor time, each a ratio minus 1.

    Memory at the end over memory once settled, and processor time of the last cycles over that of the first settled
    ones (medians of a fifth of them each). Raises ValueError with fewer than two settled cycles.
    """
    settled = [cycle for cycle in cycles if cycle.age >= SETTLING]
    if len(settled) < 2:
        raise ValueError(f"{len(settled)} cycles after the first {SETTLING / 60.0:.0f} minutes are too few")
    part = max(len(settled) // 5, 1)
    first, last = settled[:part], settled[-part:]
    memory, times = ([sorted(c[k] for c in some)[len(some) // 2] for some in (first, last)] for k in (2, 3))
    return memory[1] / memory[0] - 1.0, times[1] / times[0] - 1.0


@click.command(context_settings={"show_default": True, "help_option_names": ["-h", "--help"]})
@click.option("--minutes", default=60.0, type=click.FloatRange(min=6.0))
@click.option("--scene", default="plates")
@click.option("--seeds", default=3, type=click.IntRange(min=1), help="Runs a cycle.")
@click.option("--listen/--alone", default=True, help="Whether somebody records, who makes the service publish meshes.")
@click.option("--out", default=Path("out/soak"), type=click.Path(path_type=Path), help="Logs, and cycles.csv.")
def main(minutes: float, scene: str, seeds: int, listen: bool, out: Path) -> None:
    """Smash SCENE before one service for so many MINUTES.

    Ends with status 1 where its memory grew by more than 2 % after the first five minutes, or its work needs over 10 %
    more processor time at the end.
    """
    from rich.console import Console

    interrupt_on_signals()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    cycles = []
    with Console(stderr=True).status("") as status, (out / "cycles.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(Cycle._fields)
        for cycle in soak(out / "logs", scene, seeds, 60.0 * minutes, listen, status.update):
            cycles.append(cycle)
            writer.writerow(f"{value:.6g}" for value in cycle)
            file.flush()
    memory, times = growth(cycles)
    settled = next(cycle for cycle in cycles if cycle.age >= SETTLING)
    click.echo(
        f"{cycles[-1].runs} runs in {cycles[-1].age / 60.0:.1f} minutes; resident {settled.resident:.1f} MB when"
        f" settled, {cycles[-1].resident:.1f} MB at the end: {100.0 * memory:+.2f} %; processor time of a cycle"
        f" {settled.processor:.2f} s, {cycles[-1].processor:.2f} s at the end: {100.0 * times:+.1f} %"
    )
    if memory > GROWTH_ALLOWED or times > SLOWER_ALLOWED:
        raise SystemExit(1)


if __name__ == "__main__":
    main(prog_name="python -m campaigns.soak")

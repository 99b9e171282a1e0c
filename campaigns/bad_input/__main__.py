"""`python -m campaigns.bad_input`: bad messages by the hundred thousand, and what became of them."""

from __future__ import annotations

import csv
import os
import sys
from collections import Counter
from pathlib import Path
from time import perf_counter

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
from rich.table import Table

from campaigns.bad_input.campaign import CHUNK, Tally, every_case, run, run_campaign
from campaigns.bad_input.doors import HELD, REFUSED, TAKEN
from campaigns.bad_input.refusal_sites import counted

SHOWN_PROBLEMS = 20
# Memory samples of a worker, between its first chunks, which fill caches and the allocator's arenas, and the last.
WARM_CHUNKS = 10


@click.command(help=__doc__)
@click.option("--cases", default=100_000, show_default=True, type=click.IntRange(0))
@click.option("--seed", default=1, show_default=True, help="Equal seeds give equal cases.")
@click.option("--workers", default=os.cpu_count() or 1, show_default="all cores", type=click.IntRange(1))
@click.option("--csv", "csv_file", type=click.Path(dir_okay=False, path_type=Path), help="The counts, as a file.")
def main(cases: int, seed: int, workers: int, csv_file: Path | None) -> None:
    console = Console(width=None if sys.stdout.isatty() else 120)
    started = perf_counter()
    tally = run(every_case(seed))
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TimeRemainingColumn(),
        console=Console(stderr=True),
    )  # fmt: skip
    with bar:
        task = bar.add_task("bad input", total=cases)
        for part in run_campaign(cases, seed, workers):
            tally = tally + part
            bar.update(task, advance=part.cases, description=f"{len(tally.problems)} problems")
    seconds = perf_counter() - started
    never = [site for site, count in counted(tally.sites).items() if not count]
    _show(console, tally, seconds, [str(site) for site in never])
    if csv_file:
        _write(csv_file, tally)
    sys.exit(1 if tally.problems or never else 0)


def _show(console: Console, tally: Tally, seconds: float, never: list[str]) -> None:
    outcomes = Table("topic", "door", *(TAKEN, REFUSED, HELD), title=f"{tally.cases} cases in {seconds:.0f} s")
    for topic, door in sorted({key[:2] for key in tally.outcomes}):
        counts = [str(tally.outcomes[topic, door, outcome]) for outcome in (TAKEN, REFUSED, HELD)]
        outcomes.add_row(topic, door, *counts)
    console.print(outcomes)
    topics = sorted({topic for topic, _ in tally.kinds})
    kinds = Table("refused or held as", *topics, "all", title="kinds")
    of_all = Counter({kind: 0 for _, kind in tally.kinds})
    for (_, kind), count in tally.kinds.items():
        of_all[kind] += count
    for kind, count in of_all.most_common():
        kinds.add_row(kind, *(str(tally.kinds[topic, kind] or "-") for topic in topics), str(count))
    console.print(kinds)
    if tally.readers:
        words = ", ".join(f"{who}: {n}" for who, n in sorted(_by_reader(tally).items()))
        console.print(f"spoilt bytes, read by our reader and by rclpy's: {words}")
    console.print(f"lines of world/ that refuse: {len(counted(tally.sites))}, never reached: {len(never)}")
    for site in never:
        console.print(f"  {site}")
    console.print(f"slowest case: {tally.slowest[0]:.2f} s, {tally.slowest[1]}")
    for pid, sizes in tally.resident.items():
        if len(sizes) > WARM_CHUNKS:
            first, last = sizes[WARM_CHUNKS - 1] / 1e6, sizes[-1] / 1e6
            console.print(
                f"memory of worker {pid}: {first:.1f} MB after {WARM_CHUNKS * CHUNK} cases, {last:.1f} MB after"
                f" {len(sizes) * CHUNK} ({100.0 * (last / first - 1.0):+.1f} %)"
            )
    console.print(f"[bold]{len(tally.problems)} problems[/]")
    for problem in tally.problems[:SHOWN_PROBLEMS]:
        console.print(f"case {problem.case}, {problem.door}, {problem.name}:\n{problem.text}", markup=False)


def _by_reader(tally: Tally) -> Counter[str]:
    counts: Counter[str] = Counter()
    for (_, who), count in tally.readers.items():
        counts[who] += count
    return counts


def _write(file: Path, tally: Tally) -> None:
    with file.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(["what", "topic", "door or kind", "outcome", "count"])
        for (topic, door, outcome), count in sorted(tally.outcomes.items()):
            writer.writerow(["outcome", topic, door, outcome, count])
        for (topic, kind), count in sorted(tally.kinds.items()):
            writer.writerow(["kind", topic, kind, "", count])
        for site, count in counted(tally.sites).items():
            writer.writerow(["site", str(site), "", "", count])
        for problem in tally.problems:
            writer.writerow(["problem", problem.name, problem.door, problem.text, problem.case])


if __name__ == "__main__":
    main()

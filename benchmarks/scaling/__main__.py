"""`python -m benchmarks.scaling`: measures, prints tables and their targets, and writes CSV files."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import click

from benchmarks.scaling.report import Asked, print_asked, print_table, write_csv

SIZES, QUICK_SIZES = (100, 300, 1000, 2000), (100, 300)
THREADS_PILE, QUICK_THREADS_PILE = 1000, 300
HEAPS, QUICK_HEAPS = (300, 2000), (300,)
WIDTH = 220  # columns of a table if no terminal sets a width

Tables = tuple[dict[str, Sequence[NamedTuple]], list[Asked]]
Progress = Callable[[str], None]


def growth(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.growth import fit_exponents, measure_growth
    from benchmarks.scaling.piles import broken_body

    rows = measure_growth(broken_body(), QUICK_SIZES if quick else SIZES, 3 if quick else 7, progress)
    exponents = fit_exponents(rows)
    asked = Asked("time over close pairs, exponent", exponents.over_close_pairs, 1.15)
    return {"growth": rows, "exponents": [exponents]}, [asked]


def threads(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.growth import measure_threads
    from benchmarks.scaling.piles import broken_body

    size = QUICK_THREADS_PILE if quick else THREADS_PILE
    rows = measure_threads(broken_body(), size, 5 if quick else 15, progress)
    return {"threads": rows}, [Asked("two threads over one, speed-up", rows[0].speed_up, 1.7, at_least=True)]


def memory(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.memory import measure_memory

    rows = measure_memory(("ball",) if quick else ("ball", "bunny"), (1,) if quick else (1, 2), progress)
    first = rows[0]
    return {"memory": rows}, [
        Asked(f"{first.body}, {first.nodes} nodes, broken, resident [MB]", first.broken_resident, 20.0),
        Asked("one more of the same, resident [MB]", first.one_more_resident, 2.0),
        Asked(
            "one more of the same, broken too, resident [MB]",
            first.one_more_resident + first.one_more_broken_resident, 2.0,
        ),
    ]  # fmt: skip


def updates(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.piles import broken_body
    from benchmarks.scaling.updates import measure_update_of_one

    rows = measure_update_of_one(broken_body(), 9 if quick else 27, 3 if quick else 5, progress)
    # on a shared machine a median of ratios of identical work varies by some hundredths
    name = f"breaking one of {rows[1].bodies} over breaking one alone"
    return {"updates": rows}, [Asked(name, rows[1].whole_over_alone, 1.1)]


def small_updates(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.small_updates import body_of_30000, measure_small_updates

    (row,) = measure_small_updates(body_of_30000(), events=8 if quick else 24, progress=progress)
    name = f"breaking {row.broken_nodes:.0f} of {row.nodes} nodes, median [ms]"
    return {"small_updates": [row]}, [Asked(name, row.whole, 0.5)]


def heaps(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.heaps import MODERATE, measure_heaps
    from benchmarks.scaling.piles import broken_body

    rows = measure_heaps(broken_body(), QUICK_HEAPS if quick else HEAPS, progress=progress)
    largest = rows[-1].fragments
    pair = {(row.moving, row.step): row.microseconds_a_pair for row in rows if row.fragments == largest}
    return {"heaps": rows}, [
        Asked(f"heap of {largest}, nothing moves, a close pair [us]", pair[0, 0.0], 0.1),
        Asked(f"heap of {largest}, one fragment moves, a close pair [us]", pair[1, MODERATE], 0.1),
        Asked(f"heap of {largest}, all move by {MODERATE} % R, a close pair [us]", pair[largest, MODERATE], 3.0),
    ]


def visits(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.visits import WORLDS, measure_visits

    rows, floors = measure_visits(WORLDS[:1] if quick else WORLDS, 3 if quick else 7, progress)
    return {"visits": rows, "floors": floors}, []


def limits(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.floors.limits import AIMS, measure_limits

    rows = measure_limits(AIMS[:1] if quick else AIMS, progress=progress)
    return {"limits": rows}, []


def round_trips(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.piles import broken_body
    from benchmarks.scaling.round_trips import measure_round_trips

    rows = measure_round_trips(broken_body(), steps=60 if quick else 300, progress=progress)
    return {"round_trips": rows}, [Asked("states to contacts beyond computation, median [ms]", rows[0].beyond, 1.0)]


def removal(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.removal import measure_removal

    row = measure_removal(240 if quick else 1000, progress=progress)
    return {"removal": [row]}, [Asked(f"REMOVE after {row.events} events, median [ms]", row.remove_median, 2.0)]


def crowds(quick: bool, progress: Progress) -> Tables:
    from benchmarks.scaling.crowds import CLOSE, CROWDS, measure_crowds

    rows = measure_crowds(CROWDS[:2] if quick else CROWDS, progress)
    return {"crowds": rows}, [
        Asked("crowds at one place, slowest [s]", max(row.seconds for row in rows if row.spread <= CLOSE), 2.0),
        Asked("crowds, peak of a whole process [MB]", max(row.peak for row in rows), 500.0),
    ]


MEASURES = {
    "growth": growth, "heaps": heaps, "threads": threads, "memory": memory, "updates": updates,
    "small_updates": small_updates, "visits": visits, "limits": limits, "removal": removal, "crowds": crowds,
    "round_trips": round_trips,
}  # fmt: skip


def measure_all(names: Sequence[str], quick: bool, progress: Progress) -> Iterator[Tables]:
    for name in names:
        yield MEASURES[name](quick, progress)


@click.command(context_settings={"show_default": True})
@click.argument("names", nargs=-1, type=click.Choice(list(MEASURES)))
@click.option("--quick", is_flag=True, help="Small piles and few rounds: some minutes instead of a quarter of an hour.")
@click.option("--csv", "path", type=click.Path(path_type=Path, dir_okay=False), help="A file a table, named after it.")
def main(names: tuple[str, ...], quick: bool, path: Path | None) -> None:
    """How a query grows with a pile and what else is asked of the service as a whole: NAMES, or all.

    growth: time over close pairs of piles. heaps: a step of a pile at rest, and of one that moves slowly. threads: two
    against one. memory: of a body, and of one more. updates: breaking one of many against one alone. small_updates:
    breaking 200 of 30,000 nodes. visits: where a query's time goes, and what a visit cannot do without. limits: what
    the aims against other libraries leave room for, by docs/peers.csv and this machine. removal: REMOVE after many
    events. crowds: many bodies at one place. round_trips: what ROS adds to an answer; needs ROS 2.
    """
    from rich.console import Console

    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    with Console(stderr=True).status("") as status:
        for tables, asked in measure_all(names or tuple(MEASURES), quick, status.update):
            for name, rows in tables.items():
                print_table(name.replace("_", " "), rows, console)
                if path:
                    write_csv(name, rows, path)
            print_asked(asked, console)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.scaling")

"""`python -m benchmarks.peers`: measures, prints the table and the ratios, and writes the CSV."""

from __future__ import annotations

import re
from pathlib import Path

import click

from benchmarks.peers.one_core import pin_to_one_core

QUICK_WORLDS = ("ball8", "shell20w")
DEFAULT_CSV = Path("out/peers.csv")
WIDTH = 240  # columns of a table if no terminal sets a width


@click.command(context_settings={"show_default": True})
@click.option("--full", is_flag=True, help="All worlds, and the slow methods too: about an hour.")
@click.option("--worlds", help="Comma-separated, such as ball20,shell20w; number: Voronoi seeds, w: curved cracks.")
@click.option("--methods", "pattern", default=".", help="Only methods whose name this regular expression finds.")
@click.option("--repeats", type=click.IntRange(1), default=5, help="Rounds; medians over them are reported.")
@click.option("--csv", "path", type=click.Path(path_type=Path, dir_okay=False), default=DEFAULT_CSV)
def main(full: bool, worlds: str | None, pattern: str, repeats: int, path: Path) -> None:
    """Update, query and errors of ours and of what people would use instead, in one run on one core.

    Without options: two worlds, and the methods that take seconds; some minutes. Libraries that are not installed are
    named and left out; `make peers` installs them.
    """
    pin_to_one_core()
    # deferred imports: they read the environment, or are slow
    from rich.console import Console

    from benchmarks.peers.measure import measure
    from benchmarks.peers.methods import all_methods
    from benchmarks.peers.report import print_ratios, print_tables, write_csv
    from benchmarks.peers.worlds import WORLDS

    names = worlds.split(",") if worlds else (WORLDS if full else QUICK_WORLDS)
    unknown = [name for name in names if not re.fullmatch(r"(ball|shell)\d+w?", name)]
    if unknown:
        raise click.BadParameter(f"{unknown[0]!r} is none of {', '.join(WORLDS)}", param_hint="--worlds")
    console = Console()
    if not console.is_terminal:
        console = Console(width=WIDTH)
    methods, missing = all_methods(slow=full)
    methods = [method for method in methods if re.search(pattern, method.name)]
    if not methods:
        raise click.BadParameter(f"no method's name matches {pattern!r}", param_hint="--methods")
    path.parent.mkdir(parents=True, exist_ok=True)
    with Console(stderr=True).status("") as status:
        rows = measure(names, methods, repeats, status.update)
    write_csv(rows, path)
    print_tables(rows, missing, console)
    print_ratios(rows, console)
    console.print(f"\n{path}")


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.peers")

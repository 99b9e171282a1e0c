"""`python -m benchmarks.speed_error`: measures, writes the CSV and draws its pictures from it."""

from __future__ import annotations

import csv
from pathlib import Path

import click

from benchmarks.peers.one_core import pin_to_one_core

DOCS = Path(__file__).resolve().parents[2] / "docs"


@click.command(context_settings={"show_default": True})
@click.option("--quick/--full", "quick", default=True, help="Hollow spheres, minutes; or solid ones and slow methods.")
@click.option("--repeats", type=click.IntRange(1), default=2, help="Rounds; medians over them are reported.")
@click.option("--csv", "table", type=click.Path(path_type=Path, dir_okay=False), default=DOCS / "speed_error.csv")
@click.option("--png", type=click.Path(path_type=Path, dir_okay=False), default=DOCS / "speed_error.png")
@click.option("--redraw", is_flag=True, help="Measure nothing, draw from the CSV.")
def main(quick: bool, repeats: int, table: Path, png: Path, redraw: bool) -> None:
    """Time against error of every method and setting: queries in PNG, beside it updates and an overview."""
    if not redraw:
        pin_to_one_core()
        # deferred import: it reads the environment
        from rich.console import Console

        from benchmarks.peers.report import write_csv
        from benchmarks.speed_error.measure import measure_all

        table.parent.mkdir(parents=True, exist_ok=True)
        console = Console(stderr=True)
        with console.status("") as status:
            rows, missing = measure_all(quick, repeats, status.update)
        for family, reason in missing.items():
            console.print(f"{family}: not measured: {reason}", markup=False)
        for row in rows:
            if row.failure:
                console.print(f"{row.world}: {row.method}: {row.failure}", markup=False)
        write_csv(rows, table)
    from benchmarks.speed_error.overview import draw_overview
    from benchmarks.speed_error.picture import draw, draw_update

    with table.open(newline="") as file:
        lines = list(csv.DictReader(file))
    png.parent.mkdir(parents=True, exist_ok=True)
    update_png, overview_png = (png.with_stem(f"{png.stem}_{name}") for name in ("update", "overview"))
    draw(lines, png)
    draw_update(lines, update_png)
    draw_overview(lines, overview_png)
    for path in (table, png, update_png, overview_png):
        click.echo(path)


if __name__ == "__main__":
    main(prog_name="python -m benchmarks.speed_error")

"""The results: tables, targets, and one CSV per table."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from rich.console import Console
from rich.table import Table

from benchmarks.peers.report import machine, versions


class Asked(NamedTuple):
    """A measurement and its target."""

    measure: str
    value: float
    limit: float
    at_least: bool = False  # else at most

    @property
    def is_met(self) -> bool:
        return self.value >= self.limit if self.at_least else self.value <= self.limit


def print_table(title: str, rows: Sequence[NamedTuple], console: Console) -> None:
    """A column per field, with its name."""
    table = Table(title=title, title_justify="left")
    for name in rows[0]._fields:
        table.add_column(name.replace("_", " "), justify="right")
    for row in rows:
        table.add_row(*(cell(value) for value in row))
    console.print(table)


def print_asked(measures: Sequence[Asked], console: Console) -> None:
    for it in measures:
        bound = f"{'at least' if it.at_least else 'at most'} {it.limit:g}"
        console.print(f"{it.measure}: {it.value:.3g}, asked {bound}: {'met' if it.is_met else 'not met'}", markup=False)


def cell(value: float | int | str) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def write_csv(name: str, rows: Sequence[NamedTuple], path: Path) -> Path:
    """Writes to `path` with the table's name before its suffix; each line ends with the machine and its versions."""
    file_path = path.with_stem(f"{path.stem}_{name}")
    file_path.parent.mkdir(parents=True, exist_ok=True)
    with file_path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([*rows[0]._fields, "cpu", "versions"])
        for row in rows:
            writer.writerow([*(f"{v:.6g}" if isinstance(v, float) else v for v in row), machine(), versions()])
    return file_path

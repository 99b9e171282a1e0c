"""Tables as CSV files that record the machine they were made on, and as markdown."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

Value = str | int | float | None
Row = Mapping[str, Value]
DIGITS = 5  # of a float in a CSV: no time or penetration is known more precisely


class Table(NamedTuple):
    about: dict[str, str]  # the machine, versions, how much was run
    rows: list[dict[str, Value]]

    def where(self, **conditions: Value) -> Table:
        """The rows with these values."""
        found = [row for row in self.rows if all(row[name] == value for name, value in conditions.items())]
        return Table(self.about, found)

    def column(self, name: str) -> np.ndarray:
        """(n,) of numbers; nan where there is none."""
        return np.array([np.nan if row[name] is None else row[name] for row in self.rows], dtype=np.float64)

    def values(self, name: str) -> list[Value]:
        """The different values of a column, in the order of their first rows."""
        return list(dict.fromkeys(row[name] for row in self.rows))


def is_time(column: str) -> bool:
    """Whether a column holds measured times, by its unit: _ms or _ns in its name."""
    return "_ms" in column or "_ns" in column


def write_table(csv_path: Path, about: Mapping[str, str], rows: Sequence[Row]) -> None:
    """Writes lines `# name: value` of `about`, then a header and the rows; the first row defines the columns."""
    names = list(rows[0]) if rows else []
    with csv_path.open("w", newline="", encoding="utf-8") as stream:
        for name, value in about.items():
            stream.write(f"# {name}: {value}\n")
        writer = csv.DictWriter(stream, names, lineterminator="\n")
        writer.writeheader()
        writer.writerows({name: _text(row[name]) for name in names} for row in rows)


def read_table(csv_path: Path) -> Table:
    """Reads a file of `write_table`: int, float, str, or None for an empty cell."""
    about, lines = {}, []
    for line in csv_path.read_text(encoding="utf-8").splitlines():
        if line.startswith("# "):
            name, _, value = line[2:].partition(": ")
            about[name] = value
        else:
            lines.append(line)
    return Table(about, [{name: _value(cell) for name, cell in row.items()} for row in csv.DictReader(lines)])


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Text in the first column, numbers in the others."""
    rule = ["---"] + ["---:"] * (len(header) - 1)
    return "\n".join("| " + " | ".join(cells) + " |" for cells in (header, rule, *rows)) + "\n"


def number(value: Value, digits: int = 3) -> str:
    """Rounded to `digits` digits, but with all before the decimal point; a dash for None and nan."""
    if value is None or value != value:
        return "–"
    if isinstance(value, str):
        return value
    if value == 0 or abs(value) >= 10.0 ** (digits - 1):
        return f"{value:,.0f}"
    return f"{float(f'{value:.{digits - 1}e}'):.{digits}g}"


def average_and_worst(row: Row, name: str) -> str:
    """From columns NAME_average and NAME_worst: "average / worst"."""
    average, worst = row[f"{name}_average"], row[f"{name}_worst"]
    if average is None and worst is None:
        return "–"
    return number(average) if worst is None else f"{number(average)} / {number(worst)}"


def _text(value: Value) -> Value:
    if value is None or value != value:
        return ""
    return f"{value:.{DIGITS}g}" if isinstance(value, float) else value


def _value(cell: str) -> Value:
    if cell == "":
        return None
    for kind in (int, float):
        try:
            return kind(cell)
        except ValueError:
            pass
    return cell

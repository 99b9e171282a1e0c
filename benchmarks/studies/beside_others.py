"""Sections of docs/benchmarks.md on other libraries, from what benchmarks.peers and benchmarks.speed_error wrote."""

from __future__ import annotations

import csv
import math
from pathlib import Path

PEERS, PICTURE_ROWS, LIMITS = "peers.csv", "speed_error.csv", "scaling_limits.csv"
PICTURES = ("speed_error.png", "speed_error_update.png")
# Columns of the table: heading, column of the CSV, factor, decimals; and counts of counts.
TIMES = (
    ("update", "update", 1, 2),
    ("first query", "first_query", 1, 2),
    ("touching", "touch_native", 1, 2),
    ("jittered", "jitter_native", 1, 2),
    ("piled", "pile_native", 1, 2),
    ("contacts", "jitter_contacts", 1, 0),
)
COUNTS = (("missed", "jitter_missed", "jitter_penetrating"), ("false", "jitter_false", "jitter_apart"))
ERRORS = (
    ("depth error, mean", "jitter_error_mean", 100, 2),
    ("worst", "jitter_error_max", 100, 2),
    ("remaining, mean", "jitter_remaining_mean", 100, 2),
    ("worst", "jitter_remaining_max", 100, 2),
    ("unnecessary, mean", "jitter_unnecessary_mean", 100, 2),
    ("worst", "jitter_unnecessary_max", 100, 2),
)


def peers_section(folder: Path) -> str:
    """A table per world; "" if nothing was measured. `make peers` (or python -m benchmarks.peers --csv) measures."""
    rows = rows_of(folder / PEERS)
    if not rows:
        return ""
    parts = [
        "## Comparison with other libraries",
        "Times are medians in ms on one core. Contacts and errors are those of the jittered frames.",
        """\
- *Update:* from the fracture event until the method can answer queries, masses included. The other libraries receive
  each fragment's closed mesh; building it is not timed.
- *First query:* the first query after the update, poses and contacts passed from and to Python.
- *Touching, jittered, piled:* queries with all fragments in place, moved by up to 1 % R and 1 degree, or in a pile;
  within the library's own calls, ours too.
- *Missed:* of the pairs that penetrate by more than 0.2 % R, those without a penetrating contact.
- *False:* of the disjoint pairs, those reported as penetrating by more than 0.2 % R.
- *Depth error:* of a pair's deepest contact, in % R. Ours measures depth along a crack's normal, which is longer than
  the nearest distance by design; what a solver would see is the error of "Speed against error".""",
        '"Ours" has the default settings, and its own surfaces; "ours, same meshes" gets the closed meshes, as the'
        ' others do. "Ours, glondu2014" is the paper\'s method, with exact or averaged distances: the contacts of'
        " samples alone, up to all that are deeper than 0.2 % R.",
    ]
    known = [column for column in ERRORS if column[1] in rows[0]]  # older files lack some
    if known[-1] == ERRORS[-1]:
        parts[-1] += (
            " The last four columns are in % R, after the smallest translation that satisfies a pair's contacts:"
            " remaining is the true depth that is left, unnecessary the part of the translation without which no more"
            " would remain. They cover all pairs whose boxes overlap, or 1,000 of them at random if there are more."
        )
    for world in dict.fromkeys(row["world"] for row in rows):
        own = [row for row in rows if row["world"] == world and not row["failure"]]
        head = ["method", *(heading for heading, *_ in (*TIMES, *COUNTS, *known))]
        lines = [f"| {' | '.join(head)} |", f"| --- |{' ---: |' * (len(head) - 1)}"]
        for row in own:
            times, errors = ([_figure(row[name], *form) for _, name, *form in columns] for columns in (TIMES, known))
            counts = [_count(row, found, of) for _, found, of in COUNTS]
            lines.append(f"| {' | '.join([row['method'], *times, *counts, *errors])} |")
        parts += [f"**{world}**, {own[0]['fragments']} fragments", "\n".join(lines)]
    parts.append(made(folder / PEERS, rows))
    return "\n\n".join(parts) + "\n"


def speed_error_section(folder: Path) -> str:
    """The picture, and the smaller one of updates; "" if they were not drawn."""
    rows = rows_of(folder / PICTURE_ROWS)
    pictures = [f"![Speed against error]({name})" for name in PICTURES if (folder / name).is_file()]
    if not rows or not pictures:
        return ""
    text = (
        "Query time within the library's own calls against the error that a solver would see, for each method and"
        " setting; mean and worst over all pairs whose boxes overlap."
        " For each pair, the smallest translation that satisfies its contacts is applied."
        " The error is the penetration that remains plus the unnecessary part of the translation: the part beyond what"
        " separates the pair equally well (to 0.02 % R). A missed pair counts with its true depth, a false pair with"
        " its whole translation. If no translation up to ten times the deepest contact satisfies all contacts, the"
        " least-squares translation is used. Depth along a crack's normal is larger than the nearest distance by"
        " design, and does not count as an error. Our own surfaces of flat cracks have steps where three fragments"
        " meet, other libraries get planes; the star without a filling is this package with their meshes. Drawn by"
        " `python -m benchmarks.speed_error`."
    )
    return "\n\n".join(("## Speed against error", text, *pictures, made(folder / PICTURE_ROWS, rows))) + "\n"


def limits_section(folder: Path) -> str:
    """What the targets leave room for; "" if nothing was measured. `python -m benchmarks.scaling limits` measures."""
    rows = rows_of(folder / LIMITS)
    if not rows:
        return ""
    head = (
        "measure", "world", "reference", "target, ms", "lower bound, ms", "without search, ms", "ours, ms",
        "ours / lower bound", "parts of the lower bound",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: | --- |"]
    for row in rows:
        figures = (_milliseconds(float(row[name])) for name in ("aim", "least", "alone", "ours"))
        what = row["what"] if row["what"].startswith("update") else f"jittered query, {row['what']}"
        factor = float(row["times"])
        beside = f"{row['peer']} {f'x {factor:g}' if factor >= 1.0 else f'/ {1.0 / factor:g}'}"
        cells = (what, row["world"], beside, *figures, f"{float(row['ours_over_least']):.1f}", row["rests_on"])
        lines.append(f"| {' | '.join(cells)} |")
    text = """\
Which targets are reachable on this machine, by `python -m benchmarks.scaling limits`.

- *Target:* a multiple or fraction of the time of another library, from "Comparison with other libraries". The
  fragments' meshes are free for rapier.
- *Lower bound:* the time to read and write only the data that the same answer depends on; in a query, each step waits
  for the one before. If a target is below this bound, no program meets it that lists the same contacts and finds its
  data in the shared cache, as here. If a target is above the bound, it may or may not be reachable.
- *Without search:* our time if the result is known in advance. A target below it could not be met even if search and
  checks took no time.
  - *Query:* the contacting samples are known. They are located, their nearest surface is found and their normals are
    turned. The rest of a query is the search for them and the proof that there are no others.
  - *Update:* the cut tetrahedra are known. Their polygons are written, their masses are added up, and the samples are
    dealt to the fragments. The rest of an update is checks, digests, cells, seeds, hulls and ridges."""
    return "\n\n".join(("## Lower bounds", text, "\n".join(lines), made(folder / LIMITS, rows))) + "\n"


def _milliseconds(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}"


def rows_of(csv_path: Path) -> list[dict[str, str]]:
    """Empty if the file does not exist."""
    if not csv_path.is_file():
        return []
    with csv_path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _figure(text: str, factor: int, digits: int) -> str:
    return f"{factor * float(text):,.{digits}f}" if text else "–"


def _count(row: dict[str, str], found: str, of: str) -> str:
    return f"{float(row[found]):.0f} / {float(row[of]):.0f}" if row[found] else "–"


def made(csv_path: Path, rows: list[dict[str, str]]) -> str:
    """The small line below a table: source file and machine."""
    return f"<sub>[{csv_path.name}]({csv_path.name}); {rows[0]['cpu']}, {rows[0].get('cores', 1)} core</sub>"

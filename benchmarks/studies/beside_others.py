"""Sections of docs/benchmarks.md about other libraries, from what benchmarks.peers and benchmarks.speed_error wrote."""

from __future__ import annotations

import csv
import math
from pathlib import Path

PEERS, PICTURE_ROWS, LIMITS = "peers.csv", "speed_error.csv", "scaling_limits.csv"
PICTURES = ("speed_error.png", "speed_error_update.png")
# Of the table: heading, column of the CSV, factor, decimals; and counts of counts.
TIMES = (
    ("update", "update", 1, 2),
    ("first query", "first_query", 1, 2),
    ("touching", "touch_query", 1, 2),
    ("jittered", "jitter_query", 1, 2),
    ("piled", "pile_query", 1, 2),
    ("contacts", "jitter_contacts", 1, 0),
)
COUNTS = (("missed", "jitter_missed", "jitter_penetrating"), ("false", "jitter_false", "jitter_apart"))
ERRORS = (
    ("error, mean", "jitter_error_mean", 100, 2),
    ("worst", "jitter_error_max", 100, 2),
    ("remaining, mean", "jitter_remaining_mean", 100, 2),
    ("worst", "jitter_remaining_max", 100, 2),
    ("unnecessary, mean", "jitter_unnecessary_mean", 100, 2),
    ("worst", "jitter_unnecessary_max", 100, 2),
)


def peers_section(folder: Path) -> str:
    """A table a world; "" where nothing was measured. `make peers` (or python -m benchmarks.peers --csv) measures."""
    rows = rows_of(folder / PEERS)
    if not rows:
        return ""
    parts = [
        "## What people would use instead",
        "Times in milliseconds, medians, one core: of an update (event in, ready to answer, masses included; the others"
        " get each fragment's closed mesh ready made), of the first query after it, and of queries of all fragments in"
        " place, jittered by up to 1 % R and 1 degree, and piled. Of the jittered frames: contacts, pairs missed of"
        " those that penetrate by more than 0.2 % R, pairs falsely reported of those that have nothing in common, and"
        " the error of a pair's depth in % R.",
    ]
    known = [column for column in ERRORS if column[1] in rows[0]]  # older files lack some
    if known[-1] == ERRORS[-1]:
        parts[-1] += (
            " The last four columns in % R: true depth that remains after the smallest translation that satisfies a"
            " pair's contacts, and unnecessary displacement, the part of it without which no more would remain; of all"
            " pairs whose boxes overlap, or of 1,000 of them drawn at random where there are more."
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
    """The picture, and the smaller one of updates; "" where they were not drawn."""
    rows = rows_of(folder / PICTURE_ROWS)
    pictures = [f"![Speed against error]({name})" for name in PICTURES if (folder / name).is_file()]
    if not rows or not pictures:
        return ""
    text = (
        "Each method and setting: time of a query against the error that a solver would see, mean and worst over all"
        " pairs whose boxes overlap. The smallest translation that satisfies the contacts of a pair is applied to it;"
        " the error is the penetration that remains plus the part of the translation that was unnecessary, that is"
        " beyond what parts the pair as well (to 0.02 % R). A missed pair counts with its true depth, a false one with"
        " its whole translation. Where no translation up to ten times the deepest contact satisfies all contacts, the"
        " least-squares one counts. Depth along a crack's normal is larger than the nearest distance on purpose; this"
        " is no error here. Drawn by `python -m benchmarks.speed_error`."
    )
    return "\n\n".join(("## Speed against error", text, *pictures, made(folder / PICTURE_ROWS, rows))) + "\n"


def limits_section(folder: Path) -> str:
    """What the aims leave room for; "" where nothing was measured. `python -m benchmarks.scaling limits` measures."""
    rows = rows_of(folder / LIMITS)
    if not rows:
        return ""
    head = (
        "of", "world", "beside", "aim, ms", "least, ms", "answer alone, ms", "ours, ms", "ours / least",
        "what the least is made of",
    )  # fmt: skip
    lines = [f"| {' | '.join(head)} |", "| --- | --- | --- | ---: | ---: | ---: | ---: | ---: | --- |"]
    for row in rows:
        figures = (_milliseconds(float(row[name])) for name in ("aim", "least", "alone", "ours"))
        what = row["what"] if row["what"].startswith("update") else f"jittered query, {row['what']}"
        factor = float(row["times"])
        beside = f"{row['peer']} {f'x {factor:g}' if factor >= 1.0 else f'/ {1.0 / factor:g}'}"
        cells = (what, row["world"], beside, *figures, f"{float(row['ours_over_least']):.1f}", row["rests_on"])
        lines.append(f"| {' | '.join(cells)} |")
    text = (
        "Aims are shares or multiples of what others take in the table above (the hulls of fragments are given to"
        " rapier for free). The least is what a program would take on this machine that does nothing but read and write"
        " what the same answer rests on, each step of a query waiting for the one before; made by `python -m"
        " benchmarks.scaling limits`. Where an aim lies below the least, no program meets it that lists the same"
        " contacts and finds its data in the common cache, as here: by default these are all that are deeper than"
        " 0.2 % R, thousands where hulls give hundreds. Where it lies above, nothing here says that it cannot be met."
        " Answer alone: what this program takes for what is asked for if nothing had to be looked for. Of a query: to"
        " locate its contacts, find their nearest surface and turn their normals, each sample known beforehand; the"
        " rest of its time it looks for them, and sees that there are no others. Of an update: to write the polygons"
        " and add up the masses of the tetrahedra that are cut, each known beforehand, and to deal out the trees to the"
        " fragments; the rest are checks, digests, cells, seeds and hulls. Where an aim lies below this, the search and"
        " the checks could be free and it would not be met."
    )
    return "\n\n".join(("## What there is room for", text, "\n".join(lines), made(folder / LIMITS, rows))) + "\n"


def _milliseconds(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.2f}"


def rows_of(csv_path: Path) -> list[dict[str, str]]:
    """Empty where the file is not there."""
    if not csv_path.is_file():
        return []
    with csv_path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def _figure(text: str, factor: int, digits: int) -> str:
    return f"{factor * float(text):,.{digits}f}" if text else "–"


def _count(row: dict[str, str], found: str, of: str) -> str:
    return f"{float(row[found]):.0f} / {float(row[of]):.0f}" if row[found] else "–"


def made(csv_path: Path, rows: list[dict[str, str]]) -> str:
    """The small line below a table: from which file, on what."""
    return f"<sub>[{csv_path.name}]({csv_path.name}); {rows[0]['cpu']}, {rows[0].get('cores', 1)} core</sub>"

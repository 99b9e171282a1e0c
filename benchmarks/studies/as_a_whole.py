"""The section of docs/benchmarks.md about the service as a whole, from the tables that benchmarks.scaling wrote."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from benchmarks.studies.beside_others import made, rows_of

HEADING = "## The service as a whole"
HEAD = (
    "Piles, heaps at rest and in slow motion, threads, memory, one of many, a small fragment of a large body, where a"
    " query's time goes, and what ROS adds: one run each of `python -m benchmarks.scaling --csv docs/scaling.csv`."
    " Times are medians of one thread unless said."
)


class Column(NamedTuple):
    heading: str
    name: str  # in the CSV
    digits: int | None = None  # behind the point; None: text as it is


class Sheet(NamedTuple):
    """One table of benchmarks.scaling, and what is asked of it."""

    name: str  # of its file, scaling_<name>.csv
    title: str
    text: str
    columns: tuple[Column, ...]


SHEETS = (
    Sheet(
        "growth",
        "Piles",
        "Asked: time over close pairs to a power of at most 1.15.",
        (
            Column("fragments", "fragments", 0), Column("close pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("visited nodes", "visits", 0),
            Column("broad phase, ms", "broad_phase", 2), Column("whole query, ms", "whole", 1),
            Column("µs a pair", "microseconds_a_pair", 1),
        ),
    ),
    Sheet(
        "exponents",
        "",
        "",
        (
            Column("exponent of the query over close pairs", "over_close_pairs", 2),
            Column("over pairs in contact", "over_contact_pairs", 2),
            Column("of the broad phase over fragments", "broad_over_fragments", 2),
            Column("steepest between two piles", "steepest", 2),
        ),
    ),
    Sheet(
        "heaps",
        "Heaps from step to step",
        "The default settings, piles as above. Nothing moves: the last answer is copied. One fragment moves, another in"
        " each step. All move, to and fro, each along a line of its own. Asked of 2,000 fragments: at rest 0.1 µs a"
        " pair, moving by 0.1 % R a step 3 µs. About half of the time of one that moves is the system's, for memory of"
        " neighbour lists that is used for the first time.",
        (
            Column("fragments", "fragments", 0), Column("of these move", "moving", 0),
            Column("a step, % R", "step", 2), Column("close pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("broad phase, ms", "broad_phase", 2),
            Column("whole query, ms", "whole", 2), Column("µs a pair", "microseconds_a_pair", 3),
        ),
    ),
    Sheet(
        "threads",
        "Two threads",
        "Asked: 1.7 times one. Beside it what the machine gave two loops without memory at that time.",
        (
            Column("fragments", "fragments", 0), Column("one, ms", "one", 1), Column("two, ms", "two", 1),
            Column("speed-up", "speed_up", 2), Column("of the narrow phase", "narrow_speed_up", 2),
            Column("of the machine", "machine_speed_up", 2), Column("same bytes", "same_bytes"),
        ),
    ),
    Sheet(
        "memory",
        "Memory",
        "Megabytes resident beyond interpreter, libraries and kernels; asked of a body of 5,000 nodes: 20 in all, and 2"
        " for one more of the same.",
        (
            Column("body", "body"), Column("nodes", "nodes", 0), Column("pieces", "pieces", 0),
            Column("threads", "threads", 0), Column("unbroken", "whole_resident", 1),
            Column("broken", "broken_resident", 1), Column("one more", "one_more_resident", 2),
            Column("breaking that", "one_more_broken_resident", 2),
        ),
    ),
    Sheet(
        "updates",
        "Breaking one of many",
        "Asked: what breaking one alone takes. Check, update and masses together are what a fracture costs.",
        (
            Column("bodies", "bodies", 0), Column("broken before", "broken_before", 0), Column("check, ms", "check", 2),
            Column("update, ms", "update", 2), Column("masses, ms", "masses", 2), Column("whole, ms", "whole", 2),
            Column("over alone", "whole_over_alone", 2),
        ),
    ),
    Sheet(
        "small_updates",
        "Breaking a small fragment of a large body",
        "Medians over breaks one after the other, each of another fragment. Asked: 0.5 ms for check, update and masses"
        " together. The worst is the one at which arrays run out of room and are copied to larger ones.",
        (
            Column("nodes", "nodes", 0), Column("fragments", "fragments", 0), Column("breaks", "events", 0),
            Column("nodes that break", "broken_nodes", 0), Column("pieces", "pieces", 0),
            Column("check, ms", "check", 3), Column("update, ms", "update", 3), Column("masses, ms", "masses", 3),
            Column("whole, ms", "whole", 3), Column("worst, ms", "worst", 3),
        ),
    ),
    Sheet(
        "visits",
        "Where the time goes",
        "Visited nodes of sphere trees, and nanoseconds each: as measured; in the best round; and what a visit cannot"
        " do without, if all were culled but those that became contacts: its loads and flops at full speed, or each"
        " step waiting for the one before (in turn).",
        (
            Column("world", "world"), Column("frames", "kind"), Column("pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("visits", "visits", 0), Column("a pair", "visits_a_pair", 0),
            Column("ns a visit", "nanoseconds_a_visit", 0), Column("best", "best", 0), Column("least", "least", 0),
            Column("in turn", "in_turn", 0), Column("best / in turn", "off", 1),
        ),
    ),
    Sheet(
        "floors",
        "What a visit cannot do without",
        "Cache lines and flops counted in the code, only those that its outcome rests on; nanoseconds of this machine.",
        (
            Column("visit", "visit"), Column("cache lines", "lines", 0), Column("flops", "flops", 0),
            Column("a load, ns", "load", 2), Column("a load in turn", "load_latency", 1), Column("a flop", "flop", 2),
            Column("a flop in turn", "flop_latency", 2), Column("a wrong guess", "wrong_guess", 1),
            Column("least", "least", 0), Column("in turn, ns", "in_turn", 0),
        ),
    ),
    Sheet(
        "round_trips",
        "What ROS adds",
        "Milliseconds from states published to contacts received, less the computation; asked: 1 in the median. Beside"
        " it the same bytes there and back between two nodes of rclpy's own that do nothing else.",
        (
            Column("recorder listens", "recorder"), Column("fragments", "fragments", 0),
            Column("contacts", "contacts", 0), Column("computation", "computation", 2),
            Column("beyond it", "beyond", 2), Column("worst", "beyond_worst", 2),
            Column("of an answer without contacts", "beyond_empty", 2), Column("rclpy alone", "beyond_plain", 2),
        ),
    ),
)  # fmt: skip


def scaling_section(folder: Path) -> str:
    """All tables that are there; "" where none is."""
    parts = [part for sheet in SHEETS if (part := _sheet(folder, sheet))]
    return "\n\n".join((HEADING, HEAD, *parts)) + "\n" if parts else ""


def _sheet(folder: Path, sheet: Sheet) -> str:
    path = folder / f"scaling_{sheet.name}.csv"
    rows = rows_of(path)
    if not rows:
        return ""
    align = ("---" if column.digits is None else "---:" for column in sheet.columns)
    lines = [
        f"| {' | '.join(column.heading for column in sheet.columns)} |",
        f"| {' | '.join(align)} |",
        *(f"| {' | '.join(_cell(row[column.name], column.digits) for column in sheet.columns)} |" for row in rows),
    ]
    words = " ".join(filter(None, (f"**{sheet.title}.**" if sheet.title else "", sheet.text)))
    return "\n\n".join(filter(None, (words, "\n".join(lines), made(path, rows))))


def _cell(text: str, digits: int | None) -> str:
    return text if digits is None else f"{float(text):,.{digits}f}"

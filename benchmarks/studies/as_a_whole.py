"""The section of docs/benchmarks.md on the service as a whole, from the tables that benchmarks.scaling wrote."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from benchmarks.studies.beside_others import made, rows_of

HEADING = "## Scaling, memory and ROS overhead"
HEAD = (
    "Each table is from one run of `python -m benchmarks.scaling --csv docs/scaling.csv`. Times are medians on one"
    " thread unless stated otherwise."
)


class Column(NamedTuple):
    heading: str
    name: str  # in the CSV
    digits: int | None = None  # after the decimal point; None: text unchanged


class Sheet(NamedTuple):
    """One table of benchmarks.scaling, and its targets."""

    name: str  # of its file, scaling_<name>.csv
    title: str
    text: str
    columns: tuple[Column, ...]


SHEETS = (
    Sheet(
        "growth",
        "Piles",
        "Target: query time grows with at most the 1.15th power of the number of close pairs.",
        (
            Column("fragments", "fragments", 0), Column("close pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("visits", "visits", 0),
            Column("broad phase, ms", "broad_phase", 2), Column("whole query, ms", "whole", 1),
            Column("µs per pair", "microseconds_a_pair", 1),
        ),
    ),
    Sheet(
        "exponents",
        "",
        "Exponents fitted to these piles:",
        (
            Column("query time over close pairs", "over_close_pairs", 2),
            Column("query time over pairs in contact", "over_contact_pairs", 2),
            Column("broad phase over fragments", "broad_over_fragments", 2),
            Column("query time over close pairs, steepest between two piles", "steepest", 2),
        ),
    ),
    Sheet(
        "heaps",
        "Heaps at rest and in slow motion",
        "Default settings, piles as above. If nothing moves, the last answer is copied. If one fragment moves, it is a"
        " different one in each step. If all move, each moves back and forth along its own line. Targets for 2,000"
        " fragments: 0.1 µs per pair at rest, 3 µs per pair at 0.1 % R per step. About half of the time of a moving"
        " heap is system time for the first use of neighbour-list memory.",
        (
            Column("fragments", "fragments", 0), Column("moving", "moving", 0),
            Column("motion per step, % R", "step", 2), Column("close pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("broad phase, ms", "broad_phase", 2),
            Column("whole query, ms", "whole", 2), Column("µs per pair", "microseconds_a_pair", 3),
        ),
    ),
    Sheet(
        "threads",
        "Two threads",
        "Target: a speed-up of 1.7. The machine's speed-up is that of a loop without memory access at the same time.",
        (
            Column("fragments", "fragments", 0), Column("one thread, ms", "one", 1),
            Column("two threads, ms", "two", 1), Column("speed-up", "speed_up", 2),
            Column("narrow phase", "narrow_speed_up", 2), Column("machine", "machine_speed_up", 2),
            Column("identical bytes", "same_bytes"),
        ),
    ),
    Sheet(
        "memory",
        "Memory",
        "Resident memory in MB, without interpreter, libraries and compiled kernels. Targets for a body of 5,000 nodes:"
        " 20 MB in total, 2 MB for each further body of the same geometry.",
        (
            Column("body", "body"), Column("nodes", "nodes", 0), Column("pieces", "pieces", 0),
            Column("threads", "threads", 0), Column("unbroken", "whole_resident", 1),
            Column("broken", "broken_resident", 1), Column("one more body", "one_more_resident", 2),
            Column("fracture of one more", "one_more_broken_resident", 2),
        ),
    ),
    Sheet(
        "updates",
        "Fracture of one body among many",
        "A fracture costs check, update and masses together. Target: no more than for a single body in the world.",
        (
            Column("bodies", "bodies", 0), Column("already broken", "broken_before", 0),
            Column("check, ms", "check", 2), Column("update, ms", "update", 2), Column("masses, ms", "masses", 2),
            Column("total, ms", "whole", 2), Column("ratio to a single body", "whole_over_alone", 2),
        ),
    ),
    Sheet(
        "small_updates",
        "Fracture of a small fragment of a large body",
        "Medians over consecutive fractures, each of a different fragment. Target: 0.5 ms for check, update and masses"
        " together. The fragment touches 1,640 tetrahedra, of which 1,250 are cut. The kernels that find, divide, mark"
        " and sort them take 1.5 ms, mostly in memory accesses that miss every cache. The worst case is the fracture"
        " at which arrays exceed their capacity and are copied to larger ones.",
        (
            Column("nodes", "nodes", 0), Column("fragments", "fragments", 0), Column("fractures", "events", 0),
            Column("nodes of the fragment", "broken_nodes", 0), Column("pieces", "pieces", 0),
            Column("check, ms", "check", 3), Column("update, ms", "update", 3), Column("masses, ms", "masses", 3),
            Column("total, ms", "whole", 3), Column("worst, ms", "worst", 3),
        ),
    ),
    Sheet(
        "visits",
        "Time per visited node of the paper's method",
        "Visited sphere-tree nodes and the time per visit in ns, median and best round. The two bounds count only the"
        " loads and flops that the outcome depends on, and assume that every visit that does not become a contact is"
        " culled. In the throughput bound loads and flops run at full speed; in the latency bound each step waits for"
        " the one before.",
        (
            Column("world", "world"), Column("frames", "kind"), Column("pairs", "close_pairs", 0),
            Column("contacts", "contacts", 0), Column("visits", "visits", 0),
            Column("visits per pair", "visits_a_pair", 0), Column("ns per visit", "nanoseconds_a_visit", 0),
            Column("best round", "best", 0), Column("throughput bound", "least", 0),
            Column("latency bound", "in_turn", 0), Column("best / latency bound", "off", 1),
        ),
    ),
    Sheet(
        "floors",
        "Lower bounds of a visit",
        "Cache lines and flops that the outcome of a visit depends on, counted in the code; times on this machine.",
        (
            Column("visit", "visit"), Column("cache lines", "lines", 0), Column("flops", "flops", 0),
            Column("load, ns", "load", 2), Column("dependent load, ns", "load_latency", 1),
            Column("flop, ns", "flop", 2), Column("dependent flop, ns", "flop_latency", 2),
            Column("branch miss, ns", "wrong_guess", 1), Column("throughput bound, ns", "least", 0),
            Column("latency bound, ns", "in_turn", 0),
        ),
    ),
    Sheet(
        "round_trips",
        "ROS overhead",
        "Overhead is the time from publishing states to receiving contacts, minus the computation. Times in ms. Target:"
        " a median overhead of 1 ms. For comparison: the round trip of the same bytes between two plain rclpy nodes.",
        (
            Column("recorder subscribed", "recorder"), Column("fragments", "fragments", 0),
            Column("contacts", "contacts", 0), Column("computation", "computation", 2),
            Column("overhead", "beyond", 2), Column("worst overhead", "beyond_worst", 2),
            Column("overhead without contacts", "beyond_empty", 2), Column("plain rclpy", "beyond_plain", 2),
        ),
    ),
)  # fmt: skip


def scaling_section(folder: Path) -> str:
    """All tables that exist; "" if there is none."""
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

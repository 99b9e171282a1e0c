"""The results: a table, a CSV, and the target ratios."""

from __future__ import annotations

import csv
import platform
from collections.abc import Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.peers.judging.score import Score
from benchmarks.peers.measure import KINDS, Row
from benchmarks.peers.method import EXACT, MESH
from benchmarks.peers.methods import FAMILIES
from benchmarks.peers.one_core import cores

EVERYBODY_NEEDS = ("numpy", "scipy", "manifold3d")
# The names for the methods it compares.
OURS, RAPIER, MUJOCO = "ours", "rapier hull", "mujoco hull"
VERTICES, FIELD = ("exact vertices (warp)", "exact vertices (libigl)"), "exact field at nodes (libigl)"

LEGEND = """
Times in ms, medians: update (event in, ready to answer, masses included), first query after it, then queries of
touching, jittered and piled frames, whole calls from Python; native: of the jittered one within the library. From here
on jittered frames, lengths in % R. con: contacts a frame. missed: of pairs that penetrate by more than 0.2 % R, those
without a contact inside; in parentheses of those alone that a sample of the service shows (what lies between its
samples it cannot see). false: of the pairs that have nothing in common, those reported deeper than 0.2 % R. err, max:
depth of a pair's deepest contact less the true one. remains, unneeded: true depth left after the smallest translation
that satisfies a pair's contacts, and the part of this translation without which no more would be left; mean and worst
of all pairs whose boxes overlap, or of 1,000 of them drawn at random. nearest: angle of the deepest contact's normal to
the way from the truth's deepest vertex to the nearest surface, median and share above 30 degrees; near rims that is a
surface beside the crack. parting: the same to the way in which the common volume shrinks fastest, one direction a pair
(a curved crack has many). off: largest distance of a witness from its surface. p: piled frames. t max: largest depth
reported in place.
Ours works on, and is judged against, the surfaces of its regions; the others get closed meshes ready made, and are
judged against these: cut by planes where cracks are flat, through the cut edges where they are curved. So does ours on
the same meshes.
"""


def machine() -> str:
    """The processor's name, as reported by the system."""
    info = Path("/proc/cpuinfo")
    lines = info.read_text().splitlines() if info.exists() else []
    named = (line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.processor() or platform.machine())


def versions() -> str:
    """Versions of Python and of all measured libraries that are installed."""
    known = [f"python {platform.python_version()}"]
    for name in sorted({*EVERYBODY_NEEDS, *(n for names in FAMILIES.values() for n in names)}):
        try:
            known.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            continue
    return "; ".join(known)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    """A row per world and method; a column per field of Row and Score, by kind of frame."""
    columns = [f for f in Row._fields if f not in ("query", "native", "score")]
    of_kinds = ["query", "native", *Score._fields]
    with path.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        of_all = [f"{kind}_{name}" for kind in KINDS for name in of_kinds]
        writer.writerow([*columns, *of_all, "cpu", "cores", "versions"])
        for row in rows:
            cells = [_plain(getattr(row, c)) for c in columns]
            for kind in KINDS:
                judged = row.score.get(kind) or [np.nan] * len(Score._fields)
                cells += [_plain(v) for v in (row.query[kind], row.native[kind], *judged)]
            writer.writerow([*cells, machine(), cores(), versions()])


def _plain(value: float | int | str) -> str:
    if isinstance(value, float):
        return f"{value:.6g}" if np.isfinite(value) else ""
    return str(value)


def print_tables(rows: Sequence[Row], missing: dict[str, str], console: Console) -> None:
    console.print(f"{machine()}; {cores()} core(s) used; {versions()}\n")
    for name in dict.fromkeys(row.world for row in rows):
        console.print(_table([row for row in rows if row.world == name]))
        for row in rows:
            if row.world == name and row.failure:
                console.print(f"{row.method}: {row.failure}", markup=False)
    for family, reason in missing.items():
        console.print(f"{family}: not measured: {reason}", markup=False)
    console.print(LEGEND, markup=False)


def _table(rows: Sequence[Row]) -> Table:
    first = rows[0]
    meshes = {row.surface: row.triangles for row in rows}
    names = {EXACT: "of the service's surfaces", MESH: f"of meshes by {first.mesher}"}
    sizes = ", ".join(f"{count} triangles {names[surface]}" for surface, count in sorted(meshes.items()))
    table = Table(title=f"{first.world}: {first.fragments} fragments, {sizes}", title_justify="left")
    table.add_column("method", no_wrap=True)
    for title in (
        "update", "first", "touch", "jitter", "pile", "native", "con", "missed", "false", "err", "max", "remains",
        "max", "unneeded", "max", "nearest", "parting", "off", "p missed", "p false", "t max",
    ):  # fmt: skip
        table.add_column(title, justify="right", no_wrap=True)
    for row in rows:
        table.add_row(row.method, *_cells(row))
    return table


def _cells(row: Row) -> Iterator[str]:
    if row.failure:
        yield "failed"
        return
    times = row.update, row.first_query, *(row.query[kind] for kind in KINDS), row.native["jitter"]
    yield from (_time(t) for t in times)
    if not row.score:
        return
    it = row.score["jitter"]
    by_samples = f" ({it.samples_missed}/{it.samples_penetrating})" if it.samples_penetrating else ""
    yield f"{it.contacts:.0f}"
    yield f"{it.missed}/{it.penetrating}{by_samples}"
    yield f"{it.false}/{it.apart}"
    yield from (_percent(it.error_mean), _percent(it.error_max))
    yield from (_percent(it.remaining_mean), _percent(it.remaining_max))
    yield from (_percent(it.unnecessary_mean), _percent(it.unnecessary_max))
    yield _angle(it.nearest_median, it.nearest_wrong)
    yield _angle(it.parting_median, it.parting_wrong)
    yield f"{100.0 * it.witness_max:.1g}" if np.isfinite(it.witness_max) else ""
    piled = row.score["pile"]
    yield f"{piled.missed}/{piled.penetrating}"
    yield f"{piled.false}/{piled.apart}"
    yield _percent(row.score["touch"].deepest)


def _time(milliseconds: float) -> str:
    if not np.isfinite(milliseconds):
        return ""
    return f"{milliseconds:.0f}" if milliseconds >= 100.0 else f"{milliseconds:.3g}"


def _percent(share: float) -> str:
    return f"{100.0 * share:.2f}" if np.isfinite(share) else ""


def _angle(median: float, wrong: float) -> str:
    return f"{median:.0f} {100.0 * wrong:.0f}%" if np.isfinite(median) else ""


def ratios(rows: Sequence[Row]) -> Iterator[tuple[str, str, float]]:
    """(world, what, ratio), as in the project's targets; only those whose methods were measured."""
    for world in dict.fromkeys(row.world for row in rows):
        by = {row.method: row for row in rows if row.world == world and not row.failure}
        ours = by.get(OURS)
        if ours is None:
            continue
        vertices = min((by[n] for n in VERTICES if n in by), key=lambda row: row.query["jitter"], default=None)
        rapier, mujoco, field = by.get(RAPIER), by.get(MUJOCO), by.get(FIELD)
        with_first = ours.update + ours.first_query
        if rapier:
            yield world, "update: rapier's hulls / ours", rapier.update / ours.update
            theirs = rapier.update + rapier.first_query
            yield world, "update and first query: rapier's hulls / ours", theirs / with_first
        if field:
            yield world, "update: full exact field (libigl) / ours", field.update / ours.update
        if mujoco:
            yield world, "jittered query: ours / mujoco's hulls", ours.query["jitter"] / mujoco.query["jitter"]
        if vertices:
            ratio = vertices.query["jitter"] / ours.query["jitter"]
            yield world, "jittered query: exact vertices (the faster) / ours", ratio
        if rapier:
            yield world, "jittered query: ours / rapier's hulls", ours.query["jitter"] / rapier.query["jitter"]
        yield world, "ours: touching / jittered query", ours.query["touch"] / ours.query["jitter"]


def print_ratios(rows: Sequence[Row], console: Console) -> None:
    found = list(ratios(rows))
    worlds = list(dict.fromkeys(world for world, _, _ in found))
    value = {(world, what): ratio for world, what, ratio in found}
    table = Table(title="ratios", title_justify="left")
    table.add_column("", no_wrap=True)
    for world in worlds:
        table.add_column(world, justify="right")
    for what in dict.fromkeys(what for _, what, _ in found):
        table.add_row(what, *(f"{value[w, what]:.3g}" if (w, what) in value else "" for w in worlds))
    console.print(table)

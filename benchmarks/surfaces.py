"""Is any point of a surface deeper than the answer says? Samples alone, and with `surfaces: searched`, by dense points.

    python benchmarks/surfaces.py [pairs] [seed]        default: 1400 pairs, seed 1

Pairs of fragments of seven shapes, flat and curved cracks, one and two generations, jittered and piled; see
test/surface_campaign.py.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the truth lives with the tests

from contact_truth import SHAPES, ContactTruth, piled  # noqa: E402
from fractured_worlds import fractured_world, with_settings  # noqa: E402
from surface_campaign import EPSILON, JITTERS, SEARCHED, SPREADS, PairDepth, campaign  # noqa: E402

from fracture_collision.geometry.generators import TetGeometry  # noqa: E402

SAMPLED = SEARCHED._replace(surfaces="sampled")
RUNS = 3
PERCENT, MILLI = 100.0, 1e3
LEGEND = """
too shallow: pairs with a point of either surface that is deeper than the deepest contact by more than epsilon, 0.2 % R;
missed: pairs with a point deeper than epsilon and no contact; worst: how much deeper, % R. Left: samples alone; right:
surfaces searched, and how many pairs have a point deeper than their bound and their contacts. ms: narrow phase of a
step, median of three runs, mean over the states.
"""


class Part(NamedTuple):
    """One shape with one kind of cracks."""

    pairs: int
    too_shallow: int
    missed: int
    worst: float  # [R]
    violations: int
    milliseconds: float


def main(pairs: int = 1400, seed: int = 1) -> int:
    """Print the table; returns the number of violations."""
    console = Console(width=120)
    table = Table("shape", "cracks", "pairs")
    for name in ("too shallow", "missed", "worst", "ms", "too shallow", "missed", "worst", "violations", "ms"):
        table.add_column(name, justify="right")
    violations = 0
    rows = [(shape, curved) for shape in SHAPES for curved in (False, True)]
    for shape, curved in track(rows, "shapes", console=Console(stderr=True)):
        sampled, searched = (
            _part(shape, SHAPES[shape], curved, -(-pairs // len(rows)), seed, settings)
            for settings in (SAMPLED, SEARCHED)
        )
        violations += searched.violations
        cells = [*_cells(sampled), *_cells(searched)]
        cells.insert(7, str(searched.violations))
        table.add_row(shape, "curved" if curved else "flat", str(sampled.pairs), *cells)
    console.print(table)
    console.print(LEGEND)
    return violations


def _part(shape: str, make: Callable[[], TetGeometry], curved: bool, pairs: int, seed: int, settings) -> Part:
    judged = list(campaign(pairs, seed, {shape: make}, settings=settings, cracks=(curved,)))
    deeper = np.array([it.truth - it.listed for it in judged if _is_known(it)])
    return Part(
        len(judged), sum(it.is_too_shallow for it in judged), sum(it.is_missed for it in judged),
        float(deeper.max(initial=0.0)), sum(it.violates for it in judged), _time(make, curved, seed, settings),
    )  # fmt: skip


def _is_known(it: PairDepth) -> bool:
    """Where the truth was looked for: see LEAST."""
    return it.truth > it.listed + 0.5 * EPSILON


def _time(make: Callable[[], TetGeometry], curved: bool, seed: int, settings) -> float:
    case = fractured_world(make(), seeds=6, generations=2, curved=curved, seed=seed)
    truth, world = ContactTruth(case), with_settings(case, settings._replace(neighbour_lists=False))
    states = [case.states(jitter, seed) for jitter in JITTERS] + [piled(truth, seed, spread) for spread in SPREADS]
    times = []
    for it in states:
        runs = []
        for _ in range(RUNS + 1):
            world.contacts(it)
            runs.append(world.last_timings["narrow_phase"])
        times.append(np.median(runs[1:]))
    return float(MILLI * np.mean(times))


def _cells(part: Part) -> list[str]:
    return [
        str(part.too_shallow), str(part.missed), f"{PERCENT * part.worst:.2f}", f"{part.milliseconds:.2f}",
    ]  # fmt: skip


if __name__ == "__main__":
    sys.exit(1 if main(*(int(a) for a in sys.argv[1:])) else 0)

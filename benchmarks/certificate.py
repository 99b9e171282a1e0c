"""Does missed_depth_bound hold, and how loose is it? Random pairs of fragments, compared with brute force."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the ground truth lives with the tests

import click  # noqa: E402
from rich.console import Console  # noqa: E402
from rich.progress import track  # noqa: E402
from truth.certificate_campaign import Part, Tally, campaign  # noqa: E402
from truth.contact_truth import SHAPES  # noqa: E402

# A bound up to this [R] means that nothing was left out.
ROUNDING = 1e-9
LEGEND = """
pairs: whose boxes overlap; touching: with a sample of one inside the other; loose: median of (bound - deepest unlisted
sample) / R over the pairs that the answer names; left out: the same over those where the search left something out
(bound above rounding); violations: pairs with a sample deeper than the bound that is not listed (depth: distance to the
nearest point that is not the other's). Left: searches that ran to their end; right: cut short by a budget.
"""


@click.command(context_settings={"show_default": True})
@click.argument("pairs", type=click.IntRange(1), default=100_000)
@click.argument("seeds", type=int, nargs=-1)
def command(pairs: int, seeds: tuple[int, ...]) -> None:
    """Compare the missed depth bounds of random pairs of fragments with brute force.

    PAIRS in all (100000, some minutes), drawn with SEEDS (1). Exit status 1 if a sample is deeper than its pair's
    bound.
    """
    sys.exit(1 if main(pairs, seeds or (1,)) else 0)


def main(pairs: int, seeds: tuple[int, ...]) -> int:
    """Prints the table; returns the number of violations."""
    console = Console(stderr=True)
    half = ("pairs", "touching", "loose", "left out")
    print(_line("shape", "cracks", *half, *half, "violations"), flush=True)
    violations, total = [], 0
    for seed in seeds:
        parts = track(campaign(pairs // len(seeds), seed), f"seed {seed}", total=2 * len(SHAPES), console=console)
        for part in parts:
            print(_row(part), flush=True)
            violations += part.violations
            total += part.full.pairs + part.budgeted.pairs
    print(LEGEND)
    print(f"{total} pairs, {len(violations)} violations")
    for violation in violations:
        print(violation)
    return len(violations)


def _row(part: Part) -> str:
    cracks = "curved" if part.curved else "flat"
    return _line(part.shape, cracks, *_cells(part.full), *_cells(part.budgeted), len(part.violations))


def _line(*cells: object) -> str:
    return "".join(f"{cell:>11}" for cell in cells)


def _cells(tally: Tally) -> tuple[object, ...]:
    loose, left_out = (
        f"{np.median(these):.1e}" if len(these) else "-"
        for these in (tally.looseness, tally.looseness[tally.bounds > ROUNDING])
    )
    return tally.pairs, tally.touching, loose, left_out


if __name__ == "__main__":
    command(prog_name="python benchmarks/certificate.py")

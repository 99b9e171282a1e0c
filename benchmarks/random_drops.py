"""Boxes dropped on boxes, at random: all must end at rest on top or beside.

    python -m benchmarks.random_drops [--count 1000] [--seed 1]

Equal and unequal boxes, bricks of one and two cells, aligned, from 0.01 to 2 m at steps of 1 to 10 ms; over the lower
one by up to 80 % of its half sides, or beside it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.elementary.ours import run
from benchmarks.elementary.scenes import Elementary, Setting, Trace, body, flat, ground, scene_of

KINDS = ("box", "brick1", "brick2")
STEPS = (0.001, 0.0025, 0.005, 0.01)  # [s]
SIDES = 0.05, 0.3  # [m]
HEIGHTS = 0.01, 2.0  # [m]
OVER = 0.8  # of the lower one's half sides
BESIDE = 0.01  # [m] between the two
TOLERANCE = 0.002  # [R] of depth at rest; and of places, with 1 mm for what slides at the impact
SLID = 1e-3  # [m]


class Drop(NamedTuple):
    kinds: tuple[str, str]
    lower: np.ndarray  # (3,) [m] sides
    upper: np.ndarray  # (3,) [m]
    aside: np.ndarray  # (2,) [m] of the upper one's centre from the lower one's
    height: float  # [m]
    step: float  # [s]
    is_beside: bool

    @property
    def ground_of_upper(self) -> float:
        return 0.0 if self.is_beside else float(self.lower[2])


def drops(random: np.random.Generator) -> Iterator[Drop]:
    while True:
        kinds = tuple(random.choice(KINDS, 2).tolist())
        lower, upper = random.uniform(*SIDES, 3), random.uniform(*SIDES, 3)
        if random.random() < 0.5:
            upper = lower
        is_beside = random.random() < 0.25
        aside = random.uniform(-OVER, OVER, 2) * lower[:2] / 2.0
        if random.random() < 0.3:
            aside *= 0.0
        if is_beside:
            aside[0] = 0.5 * (lower[0] + upper[0]) + BESIDE
        height = math.exp(random.uniform(*np.log(HEIGHTS)))
        yield Drop(kinds, lower, upper, aside, height, float(random.choice(STEPS)), is_beside)


def elementary(drop: Drop) -> Elementary:
    """The scene, and what is wrong at its end."""
    at = np.append(drop.aside, drop.ground_of_upper + drop.upper[2] / 2.0)
    # R of what each rests on: the ground has none
    radii = 0.5 * np.array([drop.lower.max(), drop.upper.max()])
    radius = radii.min()
    if not drop.is_beside:
        radii[1] = radius

    def bodies(setting: Setting) -> list[dict]:
        low, high = (flat(kind, *sides) for kind, sides in zip(drop.kinds, (drop.lower, drop.upper), strict=True))
        start = at + [0.0, 0.0, drop.height]
        return [ground(), body("lower", low, (0.0, 0.0, drop.lower[2] / 2.0)), body("upper", high, start)]

    def faults(trace: Trace) -> Iterator[str]:
        off = np.abs(trace.places[-1] - [[0.0, 0.0, drop.lower[2] / 2.0], at])
        if not (off[:, 2] <= TOLERANCE * radii).all():
            yield f"{1e3 * off[:, 2].max():.2f} mm too high or low"
        if not off[:, :2].max() <= SLID + TOLERANCE * radius:
            yield f"{1e3 * off[:, :2].max():.2f} mm aside"
        if not trace.asleep.all():
            yield f"{(~trace.asleep).sum()} not asleep"
        if trace.deepest[-1] < -TOLERANCE * radius:
            yield f"{-1e3 * trace.deepest[-1]:.2f} mm deep at rest"

    return Elementary(bodies, math.sqrt(2.0 * drop.height / 9.81) + 1.5, faults)


@click.command(help=(__doc__ or "").split("\n\n")[0])
@click.option("--count", default=1000, show_default=True)
@click.option("--seed", default=1, show_default=True)
def main(count: int, seed: int) -> None:
    console, wrong, deepest = Console(), [], []
    made = drops(np.random.default_rng(seed))
    for number in track(range(count), "drops", console=Console(stderr=True)):
        drop = next(made)
        what = elementary(drop)
        trace = run(scene_of(f"drop {number}", what, Setting(step=drop.step)))
        deepest.append(-1e3 * trace.deepest.min())
        if found := list(what.faults(trace)):
            wrong.append((number, drop, found))
    table = Table("drop", "kinds", "height, m", "step, ms", "beside", "wrong")
    for number, drop, found in wrong:
        table.add_row(
            str(number), " on ".join(drop.kinds[::-1]), f"{drop.height:.3f}", f"{1e3 * drop.step:g}",
            str(drop.is_beside), ", ".join(found),
        )  # fmt: skip
    if wrong:
        console.print(table)
    console.print(f"{count - len(wrong)} of {count} right")
    console.print(f"deepest at an impact: {max(deepest):.2f} mm, median {np.median(deepest):.3f} mm")


if __name__ == "__main__":
    main()

"""Is any point of a surface deeper than the answer says? Samples alone, with edges, and searched, by dense points.

    python -m benchmarks.surfaces [--pairs 1400] [--seed 1]
    python -m benchmarks.surfaces --cost plates bricks drop_bunnies bricks@0.25
    python -m benchmarks.surfaces --cost-jittered ball20 ball20w shell20w

Pairs of fragments of seven shapes, flat and curved cracks, one and two generations, jittered and piled; see
test/truth/surface_campaign.py. The cost of edges is measured in all steps of recorded scenes (@ adds a curvature), and
in the jittered worlds of benchmarks.peers.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from benchmarks.setting_cost import cost_in_scene, show

sys.path.append(str(Path(__file__).resolve().parents[1] / "test"))  # the ground truth lives with the tests

from truth.contact_truth import SHAPES, ContactTruth, piled  # noqa: E402
from truth.surface_campaign import EPSILON, JITTERS, SEARCHED, SPREADS, PairDepth, campaign  # noqa: E402
from worlds.fractured_worlds import fractured_world, with_settings  # noqa: E402

from fracture_collision.geometry.generators import TetGeometry  # noqa: E402
from fracture_collision.records import FragmentStates  # noqa: E402
from fracture_collision.world import (
    CollisionWorld,  # noqa: E402
    Settings,  # noqa: E402
)

MODES = ("sampled", "edges", "searched")
DEEP = 0.1  # [R] less deep pairs are also listed separately
RUNS = 3
PERCENT, MILLI = 100.0, 1e3
LEGEND = """
Of each mode: pairs too shallow, with a point of either surface that is deeper than the deepest contact by more than
epsilon, 0.2 % R, and behind the slash those of them whose deepest point is less than 10 % R deep; missed, with a point
deeper than epsilon and no contact; how much deeper at worst, % R; and ms, the narrow phase of a step without lists,
median of three runs, mean over the states. Searched, pairs with a point deeper than their bound and their contacts are
violations.
"""


class Part(NamedTuple):
    """One shape with one kind of cracks, in one mode."""

    pairs: int
    too_shallow: int
    too_shallow_not_deep: int
    missed: int
    worst: float  # [R]
    violations: int
    milliseconds: float


def compare(pairs: int, seed: int) -> int:
    """Prints the table; returns the number of violations."""
    console = Console(width=140)
    table = Table("shape", "cracks", "pairs")
    for mode in MODES:
        for name in (f"{mode}: too shallow", "missed", "worst", "ms"):
            table.add_column(name, justify="right")
    violations, totals = 0, np.zeros((len(MODES), 3), int)
    rows = [(shape, curved) for shape in SHAPES for curved in (False, True)]
    for shape, curved in track(rows, "shapes", console=Console(stderr=True)):
        parts = [
            _part(shape, SHAPES[shape], curved, -(-pairs // len(rows)), seed, SEARCHED._replace(surfaces=mode))
            for mode in MODES
        ]
        violations += parts[-1].violations
        totals += [(part.too_shallow, part.too_shallow_not_deep, part.missed) for part in parts]
        cells = [cell for part in parts for cell in _cells(part)]
        table.add_row(shape, "curved" if curved else "flat", str(parts[0].pairs), *cells)
    ends = [cell for total in totals for cell in (f"{total[0]}/{total[1]}", str(total[2]), "", "")]
    table.add_row("all", "", "", *ends)
    console.print(table)
    console.print(LEGEND + f"Violations: {violations}")
    return violations


def _part(shape: str, make: Callable[[], TetGeometry], curved: bool, pairs: int, seed: int, settings: Settings) -> Part:
    judged = list(campaign(pairs, seed, {shape: make}, settings=settings, cracks=(curved,)))
    deeper = np.array([it.truth - it.listed for it in judged if _is_known(it)])
    return Part(
        len(judged), sum(it.is_too_shallow for it in judged),
        sum(it.is_too_shallow and it.truth < DEEP for it in judged), sum(it.is_missed for it in judged),
        float(deeper.max(initial=0.0)), sum(it.violates and settings.surfaces == "searched" for it in judged),
        _time(make, curved, seed, settings),
    )  # fmt: skip


def _is_known(it: PairDepth) -> bool:
    """Whether the truth was computed: see LEAST in test/truth/surface_campaign.py."""
    return it.truth > it.listed + 0.5 * EPSILON


def _time(make: Callable[[], TetGeometry], curved: bool, seed: int, settings: Settings) -> float:
    case = fractured_world(make(), seeds=6, generations=2, curved=curved, seed=seed)
    truth, world = ContactTruth(case), with_settings(case, settings._replace(neighbour_lists=False))
    states = [case.states(jitter, seed) for jitter in JITTERS] + [piled(truth, seed, spread) for spread in SPREADS]
    return float(np.mean([narrow_phase_ms(world, it, RUNS) for it in states]))


def narrow_phase_ms(world: CollisionWorld, states: FragmentStates, runs: int) -> float:
    """Median of `runs` runs, after a warm-up run."""
    times = []
    for _ in range(runs + 1):
        world.contacts(states)
        times.append(world.last_timings["narrow_phase"])
    return float(MILLI * np.median(times[1:]))


def _cells(part: Part) -> list[str]:
    return [
        f"{part.too_shallow}/{part.too_shallow_not_deep}", str(part.missed), f"{PERCENT * part.worst:.2f}",
        f"{part.milliseconds:.2f}",
    ]  # fmt: skip


class JitteredCost(NamedTuple):
    """Narrow phase without neighbour lists, mean over the frames [ms]."""

    world: str
    frames: str
    without_ms: float
    with_ms: float
    ratio: float


def jittered_costs(name: str) -> list[JitteredCost]:
    """For a world of benchmarks.peers: its fragments in place, jittered, and piled."""
    from benchmarks.peers.worlds import make_world

    made = make_world(name)
    ids = np.array([fragment.fragment_id for fragment in made.fragments])
    worlds = []
    for mode in MODES[:2]:
        worlds.append(CollisionWorld(Settings(threads=1, neighbour_lists=False, surfaces=mode)))
        worlds[-1].add_body(made.body)
        worlds[-1].add_fracture(made.event)
    rows = []
    for kind in dict.fromkeys(frame.kind for frame in made.frames):
        frames = [frame for frame in made.frames if frame.kind == kind]
        times = np.array(
            [
                [narrow_phase_ms(world, states, 2 * RUNS + 1) for world in worlds]
                for states in (
                    FragmentStates(1, 1, ids, frame.body_positions.ravel(), frame.quaternions.ravel())
                    for frame in frames
                )
            ]
        ).mean(axis=0)
        rows.append(JitteredCost(name, kind, times[0], times[1], times[1] / times[0]))
    return rows


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.surfaces", description=__doc__.split("\n\n")[0])
    parser.add_argument("--pairs", type=int, default=1400, help="at least so many (1400: a quarter of an hour)")
    parser.add_argument("--seed", type=int, default=1, help="another one, other pairs (1)")
    parser.add_argument("--cost", nargs="+", metavar="SCENE", help="no pairs: what edges cost in scenes")
    parser.add_argument("--cost-jittered", nargs="+", metavar="WORLD", help="no pairs: likewise in these worlds")
    arguments = parser.parse_args()
    if arguments.cost:
        rows = [cost_in_scene(name, surfaces="edges") for name in track(arguments.cost, "scenes")]
        show("without and with edges", rows)
    if arguments.cost_jittered:
        rows = [row for name in track(arguments.cost_jittered, "worlds") for row in jittered_costs(name)]
        show("without and with edges", rows)
    if arguments.cost or arguments.cost_jittered:
        return 0
    return compare(arguments.pairs, arguments.seed)


if __name__ == "__main__":
    sys.exit(1 if main() else 0)

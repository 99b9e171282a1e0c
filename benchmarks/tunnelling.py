"""Does something fast go through something thin? A rotating shard is thrown at a plate, without and with `lookahead`.

    python -m benchmarks.tunnelling [--trials N] [--csv docs/tunnelling.csv]
    python -m benchmarks.tunnelling --cost plates bricks drop_bunnies@0.25

A shard of 60 x 60 x 4 mm, in any orientation and spinning at up to 200 rad/s, is thrown at a fixed or free standing
plate of 250 x 250 x 6 mm, at 2.5 ms a step, so that it reaches the plate at any moment of a step. It counts as through
if its centre has crossed the plate's middle within the plate's border and is behind it at the end.

The cost is that of the states of whole scenes, answered step by step on one core without and with `lookahead`, each
step's minimum of three runs.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.progress import track

from benchmarks.setting_cost import cost_in_scene, show
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.rotations import rotation_matrices
from fracture_collision.simulation.scene.scene import Scene, load_scene, parse_scene
from fracture_collision.world import Settings

TIME_STEP = 0.0025  # [s]
PLATE, SHARD = (0.25, 0.006, 0.25), (0.06, 0.06, 0.004)  # [m]
SPEEDS = (1.0, 10.0, 20.0, 50.0, 100.0, 200.0)  # [m/s]
MOST_SPIN = 200.0  # [rad/s]
DEEP = 5e-4  # [m] a penetration that counts


class Trial(NamedTuple):
    is_through: bool
    deepest: float  # [m] penetration of any contact, in any step
    energy_gain: float  # in any step, as a share of the initial energy


class Row(NamedTuple):
    """Some trials that differ only in their random numbers."""

    speed: float  # [m/s]
    plate: str
    lookahead: str
    trials: int
    through: int
    deep: int  # trials with a penetration deeper than DEEP
    deepest_mm: float
    energy_gain: float


def scene_of(speed: float, seed: int, is_fixed: bool) -> Scene:
    """A shard at `speed` [m/s] in front of a plate at the origin that stands across y."""
    random = np.random.default_rng(seed)
    spin = random.normal(size=3)
    spin *= random.uniform(0.0, MOST_SPIN) / np.linalg.norm(spin)
    before = random.uniform(0.1, 0.1 + speed * TIME_STEP)
    beside, turned = random.uniform(-0.06, 0.06, 2), random.uniform(0.0, 360.0, 3)
    steps = int(np.ceil((before + 0.15) / speed / TIME_STEP)) + 4
    plate = {"name": "plate", "material": "porcelain", "shape": {"brick": {"size_xyz": PLATE, "edge_length": 0.05}}}
    shard = {
        "name": "shard", "material": "porcelain", "shape": {"brick": {"size_xyz": SHARD, "edge_length": 0.02}},
        "position": [float(beside[0]), -float(before), float(beside[1])], "rotation": turned.tolist(),
        "linear_velocity": [0.0, speed, 0.0], "angular_velocity": spin.tolist(),
    }  # fmt: skip
    return parse_scene(
        {
            "gravity": [0.0, 0.0, 0.0], "time_step": TIME_STEP, "duration": steps * TIME_STEP,
            "materials": {"porcelain": {"density": 2400.0, "friction": 0.5, "restitution": 0.1}},
            "bodies": [plate | ({"static": True} if is_fixed else {}), shard],
        },
        "tunnelling",
    )  # fmt: skip


def run_trial(scene: Scene, lookahead: float) -> Trial:
    energies, deepest, crossed, last = [], 0.0, False, None
    half = 0.5 * np.array(PLATE)
    with Lockstep(scene, Settings(threads=1, lookahead=lookahead)) as lockstep:
        for exchange in lockstep:
            energies.append(exchange.report.kinetic_energy)
            deepest = min(deepest, exchange.report.deepest_gap)
            states = exchange.states
            places = dict(zip(states.fragment_ids.tolist(), states.positions.reshape(-1, 3), strict=True))
            turns = dict(zip(states.fragment_ids.tolist(), states.orientations.reshape(-1, 4), strict=True))
            place = places[2] - places.get(1, np.zeros(3))
            if 1 in turns:
                place = rotation_matrices(turns[1][None])[0].T @ place
            if last is not None and last[1] * place[1] < 0.0:
                at = last + last[1] / (last[1] - place[1]) * (place - last)
                crossed |= bool(np.all(np.abs(at[[0, 2]]) < half[[0, 2]]))
            last = place
    gain = float(np.diff(energies).max(initial=0.0)) / energies[0]
    return Trial(crossed and bool(last[1] > half[1]), 0.0 - deepest, gain)


def measure(trials: int) -> list[Row]:
    rows = []
    cases = [(speed, fixed, ahead) for speed in SPEEDS for fixed in (True, False) for ahead in (0.0, TIME_STEP)]
    for speed, is_fixed, lookahead in track(cases, "trials"):
        runs = [run_trial(scene_of(speed, seed, is_fixed), lookahead) for seed in range(trials)]
        rows.append(
            Row(
                speed, "fixed" if is_fixed else "free", "a step" if lookahead else "none", trials,
                sum(run.is_through for run in runs), sum(run.deepest > DEEP for run in runs),
                1e3 * max(run.deepest for run in runs), max(run.energy_gain for run in runs),
            )
        )  # fmt: skip
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.tunnelling", description=__doc__.split("\n\n")[0])
    parser.add_argument("--trials", type=int, default=48, help="of each speed, plate and lookahead (48)")
    parser.add_argument("--csv", type=Path, help="file for the rows")
    parser.add_argument("--cost", nargs="+", metavar="SCENE", help="no trials: what looking ahead costs in scenes")
    arguments = parser.parse_args()
    if arguments.cost:
        show(
            "without and with lookahead",
            [
                cost_in_scene(name, lookahead=load_scene(name.partition("@")[0]).time_step)
                for name in track(arguments.cost, "scenes")
            ],
        )
        return
    rows = measure(arguments.trials)
    show("a shard thrown at a plate", rows)
    if arguments.csv:
        with arguments.csv.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerows([Row._fields, *rows])


if __name__ == "__main__":
    main()

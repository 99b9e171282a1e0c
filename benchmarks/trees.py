"""Prints the cost of trees and traversals (compare Glondu 2014, Fig. 6, 15 and 17), and the maximum-distance order."""

from __future__ import annotations

import sys
from pathlib import Path
from time import perf_counter

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "test")]  # the fracture patterns live with the tests

from worlds.fractured_worlds import FracturedWorld, fractured_world, with_settings  # noqa: E402

from fracture_collision.core.glondu2014.max_distance_order import max_distance_order  # noqa: E402
from fracture_collision.geometry.generators import ball  # noqa: E402
from fracture_collision.records import FragmentStates  # noqa: E402
from fracture_collision.world import CollisionWorld, PaperSettings, Settings  # noqa: E402
from fracture_collision.world.settings import CHOICES  # noqa: E402

BODY = ball(1.0, 0.13)
SETTINGS = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))
SEEDS = 20
JITTERS = (0.003, 0.01, 0.03)  # [R]
POSES = 10
REPEATS = 7
UPDATES = 9
LEGEND = """
visits, contacts: a step of all pieces, mean; spread: rms distance of a pair's contacts from their mean, as a share of
that of all its samples in contact, mean over pairs with four contacts or more; update: the fracture, median [ms];
query: a step's broad and narrow phase, median [ms], one thread
"""


def main() -> None:
    for name, points in _clouds():
        print(f"order of {len(points):>6} points {name:<14}{1e3 * _seconds(max_distance_order, points):9.1f} ms")
    case = fractured_world(BODY, SEEDS)
    print(f"\nball of {len(BODY.vertices)} nodes, {len(case.oracle.fragment_ids)} pieces, {POSES} poses each\n")
    print(f"{'jitter':>8}{'tree':>14}{'traversal':>13}{'visits':>9}{'contacts':>10}{'spread':>8}{'update':>8}{'query':>8}")
    updates = {tree: _update_time(case, _with(tree=tree)) for tree in CHOICES["tree"]}
    for jitter in JITTERS:
        states = [case.states(jitter, seed) for seed in range(POSES)]
        full = [_spreads(with_settings(case, SETTINGS._replace(contacts_per_pair=10**6)).contacts(s)) for s in states]
        for tree in CHOICES["tree"]:
            for traversal in CHOICES["traversal"]:
                world = with_settings(case, _with(tree=tree, traversal=traversal))
                visits, contacts, spread, query = _queries(world, states, full)
                print(
                    f"{jitter:8.3f}{tree:>14}{traversal:>13}{visits:9.0f}{contacts:10.0f}{spread:8.3f}"
                    f"{1e3 * updates[tree]:8.2f}{1e3 * query:8.2f}"
                )
    print(LEGEND)


def _with(**variant: str) -> Settings:
    return SETTINGS._replace(paper=SETTINGS.paper._replace(**variant))


def _clouds():
    for count in (1_000, 10_000, 100_000):
        random = np.random.default_rng(1)
        directions = random.normal(size=(count, 3))
        directions /= np.linalg.norm(directions, axis=1)[:, None]
        side = round(count ** (1 / 3))
        yield "in a ball", directions * random.uniform(0.0, 1.0, (count, 1)) ** (1 / 3)
        yield "on a sphere", directions
        yield "on a lattice", 0.1 * np.stack(np.meshgrid(*[np.arange(side)] * 3), axis=-1).reshape(-1, 3)
        yield "with twins", directions[random.integers(0, count // 10, count)]


def _seconds(function, *arguments) -> float:
    function(*arguments)
    times = []
    for _ in range(3):
        started = perf_counter()
        function(*arguments)
        times.append(perf_counter() - started)
    return float(np.median(times))


def _at(sequence: int) -> FragmentStates:
    return FragmentStates(1, sequence, np.zeros(0, int), np.zeros(0), np.zeros(0))


def _update_time(case: FracturedWorld, settings: Settings) -> float:
    """[s] Median time of applying the fracture; the body is already loaded."""
    world, times = with_settings(case, settings), []
    for _ in range(UPDATES):
        world.contacts(_at(0))
        world.contacts(_at(1))
        times.append(world.last_timings["update"])
    return float(np.median(times))


def _spreads(answer) -> dict[tuple[int, int], float]:
    """[m] For each pair with at least four contacts."""
    points = answer.points_a.reshape(-1, 3)
    spreads = {}
    for i, pair in enumerate(zip(answer.fragment_a.tolist(), answer.fragment_b.tolist(), strict=True)):
        own = points[answer.pair_begin[i] : answer.pair_begin[i + 1]]
        if len(own) >= 4:
            spreads[pair] = float(np.sqrt(own.var(axis=0).sum()))
    return spreads


def _queries(
    world: CollisionWorld, states: list[FragmentStates], full: list[dict]
) -> tuple[float, float, float, float]:
    visits, contacts, shares, times = [], [], [], []
    for state, of_all in zip(states, full, strict=True):
        for _ in range(REPEATS):
            world.forget()
            answer = world.contacts(state)
            times.append(world.last_timings["broad_phase"] + world.last_timings["narrow_phase"])
        visits.append(world.last_visits)
        contacts.append(len(answer.gaps))
        shares += [spread / of_all[pair] for pair, spread in _spreads(answer).items()]
    return float(np.mean(visits)), float(np.mean(contacts)), float(np.mean(shares)), float(np.median(times))


if __name__ == "__main__":
    main()

"""Memory of a world; each case in a process of its own: `python -m benchmarks.scaling.memory`.

Measured twice: the resident set, as the system sees it, and tracemalloc's count, which is what the world's arrays and
objects hold, whatever the allocator keeps. Interpreter, libraries and kernels are loaded before.
"""

from __future__ import annotations

import ctypes
import gc
import json
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.scaling.growth import Progress, silent
from fracture_collision.geometry.sampled_bodies import sampled_ball
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.warm_up import compile_kernels

ROOT = Path(__file__).resolve().parents[2]
sys.path.append(str(ROOT / "test"))  # the fracture patterns live with the tests

from oracles.fracture_patterns import voronoi_event  # noqa: E402
from oracles.fragmented_body import FragmentedBody  # noqa: E402

MORE = 8  # bodies of the same geometry; the mean of them is one more body, as arrays grow by doubling
PIECES = 20  # seeds; there are more pieces if a cell comes in several
APART = 3.0  # [m] between bodies
BODIES = ("ball", "bunny")
MEGABYTE = 1e6


class MemoryRow(NamedTuple):
    """Megabytes (1e6 bytes) beyond interpreter, libraries and kernels."""

    body: str
    nodes: int
    tetrahedra: int
    pieces: int
    threads: int
    whole_resident: float  # of a world with the unbroken body, queried once
    whole_held: float  # the same, as counted by tracemalloc
    broken_resident: float  # after its fracture, queried once
    broken_held: float
    peak_held: float  # peak until then, while a message was checked or a fracture applied
    one_more_resident: float  # of one more body, unbroken: mean of MORE
    one_more_held: float
    one_more_broken_resident: float  # of one more broken body, beyond its unbroken size: mean of MORE
    one_more_broken_held: float
    first_more_held: float  # of the first of them alone, unbroken
    first_more_broken_held: float


def measure_memory(
    bodies: tuple[str, ...] = BODIES, threads: tuple[int, ...] = (1, 2), progress: Progress = silent
) -> list[MemoryRow]:
    """ball: sampled_ball(1, 11, 4000), 5,212 nodes; bunny: the stored one, 2,010."""
    rows = []
    for body in bodies:
        for count in threads:
            progress(f"memory: {body}, {count} thread(s)")
            resident, held = (_process(body, count, how) for how in ("resident", "held"))
            rows.append(
                MemoryRow(
                    body, resident["nodes"], resident["tetrahedra"], resident["pieces"], count,
                    resident["whole"], held["whole"], resident["broken"], held["broken"], held["peak"],
                    resident["more"] / MORE, held["more"] / MORE,
                    resident["more_broken"] / MORE, held["more_broken"] / MORE,
                    held["first_more"], held["first_more_broken"],
                )
            )  # fmt: skip
    return rows


def _process(body: str, threads: int, how: str) -> dict[str, float]:
    command = [sys.executable, "-m", "benchmarks.scaling.memory", body, str(threads), how]
    done = subprocess.run(command, cwd=ROOT, env=os.environ, capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(command[1:])} ended with {done.returncode}:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


class _Bodies(NamedTuple):
    """Copies of one body next to each other, and the fracture of each."""

    bodies: list[CollisionBody]
    events: list[FractureEvent]

    def states(self, there: int, broken: int) -> FragmentStates:
        """All live fragments when `there` bodies exist and the first `broken` of them have broken, in place."""
        ids = [self.events[k].new_fragment_ids for k in range(broken)]
        ids += [np.array([self.bodies[k].fragment_id], np.uint32) for k in range(broken, there)]
        positions = np.zeros((sum(map(len, ids)), 3))
        positions[:, 0] = np.repeat(APART * np.arange(there), [len(i) for i in ids])
        turns = np.tile([0.0, 0.0, 0.0, 1.0], (len(positions), 1))
        return FragmentStates(1, broken, np.concatenate(ids), positions.ravel(), turns.ravel())


def _copies(body: str) -> _Bodies:
    vertices, tetrahedra = sampled_ball(1.0, 11, 4000) if body == "ball" else bunny(2.0)
    oracle = FragmentedBody(vertices, tetrahedra, 1)
    nodes = np.random.default_rng(1).choice(len(vertices), PIECES, replace=False)
    event = voronoi_event(oracle, 1, vertices[nodes], 2)
    bodies, events = [], []
    for k in range(MORE + 1):
        first = 1 + k * (1 + len(event.new_fragment_ids))
        bodies.append(CollisionBody(k + 1, first, vertices=vertices, tetrahedra=tetrahedra))
        ids = event.new_fragment_ids - 1 + first
        events.append(event._replace(sequence=k + 1, body_id=k + 1, fragment_id=first, new_fragment_ids=ids))
    return _Bodies(bodies, events)


def _levels(body: str, threads: int, level: Callable[[], int]) -> Iterator[int]:
    """Bytes: before, with a body, with its pieces, with one more body, with MORE, one of these broken, all broken."""
    its = _copies(body)
    world = CollisionWorld(Settings(threads=threads))

    def ask(there: int, broken: int) -> int:
        world.contacts(its.states(there, broken))
        world.fragments()
        return level()

    yield level()
    world.add_body(its.bodies[0])
    yield ask(1, 0)
    world.add_fracture(its.events[0])
    yield ask(1, 1)
    for k in range(1, MORE + 1):
        world.add_body(its.bodies[k])
        if k in (1, MORE):
            yield ask(k + 1, 1)
    for k in range(1, MORE + 1):
        world.add_fracture(its.events[k])
        if k in (1, MORE):
            yield ask(MORE + 1, k + 1)


def _held() -> int:
    gc.collect()
    return tracemalloc.get_traced_memory()[0]


def _resident() -> int:
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)  # the allocator's reserve does not belong to the world
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def _main(body: str, threads: int, how: str) -> None:
    compile_kernels(progress=lambda text: None)
    _copies(body)  # anything a library loads on first use
    peak = 0
    levels = []
    if how == "held":
        tracemalloc.start()
    for value in _levels(body, threads, _held if how == "held" else _resident):
        levels.append(value)
        if how == "held" and len(levels) == 1:
            tracemalloc.reset_peak()
        if how == "held" and len(levels) == 3:
            peak = tracemalloc.get_traced_memory()[1]
    start, whole, broken, first_more, more, first_more_broken, more_broken = levels
    its = _copies(body)
    megabytes = {
        "whole": whole - start, "broken": broken - start, "peak": max(peak - start, 0),
        "first_more": first_more - broken, "more": more - broken,
        "first_more_broken": first_more_broken - more, "more_broken": more_broken - more,
    }  # fmt: skip
    sizes = {
        "nodes": len(its.bodies[0].vertices), "tetrahedra": len(its.bodies[0].tetrahedra),
        "pieces": len(its.events[0].new_fragment_ids),
    }  # fmt: skip
    print(json.dumps(sizes | {name: value / MEGABYTE for name, value in megabytes.items()}))


if __name__ == "__main__":
    _main(sys.argv[1], int(sys.argv[2]), sys.argv[3])

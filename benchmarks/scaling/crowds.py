"""Valid states that would cost more than any answer is worth: crowds of bodies in one place.

Each crowd has a process of its own: `python -m benchmarks.scaling.crowds KIND COUNT SPREAD`.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.scaling.growth import Progress, silent
from fracture_collision.geometry.generators import ball
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings

ROOT = Path(__file__).resolve().parents[2]
COARSE = ball(0.5, 0.15)
KINDS = ("boxes", "spheres", "tetrahedra", "triangles", "mixed")  # mixed: tetrahedra and spheres
AT_ONE_PLACE, CLOSE, LOOSE = 0.0, 0.03, 0.3  # [m] spread of bodies of 1 m
CROWDS = (
    ("boxes", 300, AT_ONE_PLACE), ("boxes", 1000, AT_ONE_PLACE), ("boxes", 300, CLOSE), ("spheres", 300, CLOSE),
    ("tetrahedra", 300, CLOSE), ("triangles", 440, CLOSE), ("mixed", 300, CLOSE), ("mixed", 1000, CLOSE),
    ("boxes", 440, LOOSE), ("tetrahedra", 440, LOOSE), ("triangles", 440, LOOSE), ("mixed", 440, LOOSE),
)  # fmt: skip
MEGABYTE = 1e6
WIDTHS = {"fragment_ids": 1, "positions": 3, "orientations": 4}  # numbers per body


class CrowdRow(NamedTuple):
    """`states` is the first query of a world that has answered for three of its bodies, one thread."""

    kind: str
    count: int
    spread: float  # [m]
    seconds: float  # until answer or rejection
    peak: float  # [MB] of the whole process, including interpreter and libraries
    contacts: int
    answer: float  # [MB]
    refused: str  # kind of the reason, or empty


def body(kind: str, number: int) -> CollisionBody:
    """One of KINDS, about 1 m across."""
    plain = CollisionBody(number, number)
    if kind == "boxes":
        return plain._replace(primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)))
    if kind == "spheres" or (kind == "mixed" and number % 2):
        return plain._replace(primitive=SolidPrimitive(SPHERE, (0.5,)))
    if kind == "triangles":
        used, triangles = np.unique(boundary_triangles(COARSE.tetrahedra), return_inverse=True)
        return plain._replace(vertices=COARSE.vertices[used].ravel(), triangles=triangles.ravel())
    return plain._replace(vertices=COARSE.vertices, tetrahedra=COARSE.tetrahedra)


def crowd(kind: str, count: int, spread: float, **settings) -> tuple[CollisionWorld, FragmentStates]:
    """Randomly oriented bodies, centred within `spread` [m] of the origin along each axis."""
    world, random = CollisionWorld(Settings(**settings)), np.random.default_rng(1)
    for i in range(1, count + 1):
        world.add_body(body(kind, i))
    turns = Rotation.random(count, random_state=random).as_quat()
    positions = random.uniform(-spread, spread, (count, 3))
    return world, FragmentStates(1, 0, np.arange(1, count + 1), positions.ravel(), turns.ravel())


def measure_crowds(crowds=CROWDS, progress: Progress = silent) -> list[CrowdRow]:
    """Keeps the second process of each case, as the first may compile kernels."""
    rows = []
    for case in crowds:
        progress(f"crowds: {case[1]} {case[0]} within {case[2]} m")
        command = [sys.executable, "-m", "benchmarks.scaling.crowds", *map(str, case)]
        for _ in range(2):
            told = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, cwd=ROOT).stdout
        rows.append(CrowdRow(*case, **json.loads(told)))
    return rows


def _measure(kind: str, count: int, spread: float) -> dict:
    world, states = crowd(kind, count, spread, threads=1)
    few = {name: getattr(states, name)[: 3 * width] for name, width in WIDTHS.items()}
    world.contacts(states._replace(**few))
    contacts, size, refused = 0, 0, ""
    begun = perf_counter()
    try:
        answer = world.contacts(states)
        contacts, size = len(answer.gaps), sum(np.asarray(field).nbytes for field in answer)
    except InvalidMessage as error:
        refused = error.kind
    seconds = perf_counter() - begun
    # not ru_maxrss, which starts at the parent process's value
    peak = 1024 * int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
    return {
        "seconds": seconds, "peak": peak / MEGABYTE, "contacts": contacts, "answer": size / MEGABYTE,
        "refused": refused,
    }  # fmt: skip


if __name__ == "__main__":
    print(json.dumps(_measure(sys.argv[1], int(sys.argv[2]), float(sys.argv[3]))))

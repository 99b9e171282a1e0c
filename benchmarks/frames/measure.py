"""Times of each step of a recorded scene: ours, and those of a peer that receives the same data."""

from __future__ import annotations

import gc
import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.frames.peer import Peer
from benchmarks.frames.recording import Recording, Step
from fracture_collision.world import CollisionWorld, Settings

BUSY = 10  # moving fragments that make a step busy
MILLI = 1e3


class Times(NamedTuple):
    """For each of n steps [ms]."""

    query: np.ndarray  # (n,) all of contacts() except updates, or the peer's own step; nan: not measured
    update: np.ndarray  # (n,) at fractures; elsewhere 0
    again: np.ndarray  # (n,) the same states queried again; nan: not measured
    digest: str  # of all answers; "" for a peer


def ours(recording: Recording, settings: Settings, again: bool = False) -> Times:
    """The whole of `contacts`, called twice a step if `again`."""
    world, sha = CollisionWorld(settings), hashlib.sha256()
    query, update, repeated = [], [], []
    with _uncollected():
        for step in recording.steps:
            told = tell(world, step)
            started = perf_counter()
            answer = world.contacts(step.states)
            seconds = perf_counter() - started
            changed = world.last_timings["update"] if step.bodies or step.events else 0.0
            query.append(seconds - changed)
            started = perf_counter()
            if step.events:
                world.fragments()
            update.append(told + changed + perf_counter() - started if step.events else 0.0)
            for field in answer:
                sha.update(np.asarray(field).tobytes())
            if again:
                started = perf_counter()
                world.contacts(step.states)
                repeated.append(perf_counter() - started)
    unknown = np.full(len(query), np.nan)
    return Times(
        MILLI * np.array(query), MILLI * np.array(update), MILLI * np.array(repeated) if again else unknown,
        sha.hexdigest(),
    )  # fmt: skip


def times_of(recording: Recording, make: type[Peer]) -> Times:
    world, peer = CollisionWorld(Settings(threads=1)), make()
    first = int(np.argmax(at_last_registry(recording))) if peer.last_registry_only else 0
    query, update = [np.nan] * first, [0.0] * first
    with _uncollected():
        for k, step in enumerate(recording.steps):
            tell(world, step)
            peer.tell(step.bodies)
            if k < first:
                continue
            changed = peer.follow(world, world.present(step.states).ids.tolist())
            update.append(changed if step.events else 0.0)
            query.append(peer.step(step.states))
    return Times(MILLI * np.array(query), MILLI * np.array(update), np.full(len(query), np.nan), "")


def is_busy(recording: Recording) -> np.ndarray:
    """Busy steps (n,) bool."""
    return np.array([step.moving >= BUSY for step in recording.steps])


def at_last_registry(recording: Recording) -> np.ndarray:
    """Steps from the last fracture's on (n,) bool; all steps if nothing breaks."""
    broke = np.flatnonzero([bool(step.events) for step in recording.steps])
    return np.arange(len(recording.steps)) >= (broke[-1] if len(broke) else 0)


def tell(world: CollisionWorld, step: Step) -> float:
    started = perf_counter()
    for body in step.bodies:
        world.add_body(body)
    for event in step.events:
        world.add_fracture(event)
    return perf_counter() - started


@contextmanager
def _uncollected() -> Iterator[None]:
    """Disables garbage collection in the middle of a step."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()

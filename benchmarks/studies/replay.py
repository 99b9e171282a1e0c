"""Replays one trajectory: a scene is run once, and worlds with other settings answer the same states.

A scene run with other settings takes another course, and so has other contacts to find. Here all find the same.
"""

from __future__ import annotations

from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from benchmarks.studies.scene_trials import ONE_THREAD, scene_with
from benchmarks.studies.study import Trial
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.world import CollisionWorld, Settings

MILLI = 1e3


class Recording(NamedTuple):
    """The complete input of the service in a run."""

    bodies: list[CollisionBody]
    events: list[FractureEvent]  # ascending by sequence
    states: list[FragmentStates]  # by step


class Answers(NamedTuple):
    """For each state of a recording, (n,); times in seconds."""

    query: np.ndarray  # validation, broad and narrow phase; the shortest of all repetitions
    update: np.ndarray  # events applied, registry ready, masses included; 0 in a step without events
    visits: np.ndarray  # sphere tree nodes tested; of method `exact`, leaves and samples
    contacts: np.ndarray
    pairs: np.ndarray
    longest_query: np.ndarray  # of all repetitions
    longest_update: np.ndarray


def record(scene: Scene, settings: Settings = ONE_THREAD) -> Recording:
    """Runs a scene, with `settings` of the service."""
    events, states = [], []
    with Lockstep(scene, settings) as run:
        bodies = run.simulation.start_bodies()
        for exchange in run:
            states.append(exchange.states)
            events += exchange.report.events
    return Recording(bodies, events, states)


def replay(recording: Recording, settings: Settings) -> Answers:
    """Adds the bodies to a new world and queries all states in order, adding events when states need them."""
    world = CollisionWorld(settings)
    for body in recording.bodies:
        world.add_body(body)
    rows = []
    told = 0
    for states in recording.states:
        started = perf_counter()
        news = recording.events[told : states.fracture_sequence]
        for event in news:
            world.add_fracture(event)
        told += len(news)
        asked = perf_counter()
        contacts = world.contacts(states)
        answered = perf_counter()
        update = 0.0
        if news:
            world.fragments()
            update = asked - started + world.last_timings["update"] + perf_counter() - answered
        query = answered - asked - (world.last_timings["update"] if news else 0.0)
        rows.append((query, update, world.last_visits, len(contacts.gaps), world.last_pairs))
    query, update, *counts = np.array(rows, dtype=np.float64).T
    return Answers(query, update, *counts, query, update)


def summary_of_answers(answers: Answers) -> dict[str, Any]:
    """Average and worst, of times that of all repetitions; queries if fragments are close, updates at fractures."""
    close, updated = answers.pairs > 0, answers.update > 0.0
    row: dict[str, Any] = {"steps": int(close.sum()), "fractures": int(updated.sum())}
    for name, values, longest in (
        ("contacts", answers.contacts[close], answers.contacts[close]),
        ("visits", answers.visits[close], answers.visits[close]),
        ("query_ms", MILLI * answers.query[close], MILLI * answers.longest_query[close]),
        ("update_ms", MILLI * answers.update[updated], MILLI * answers.longest_update[updated]),
    ):
        row[f"{name}_average"] = float(values.mean()) if len(values) else None
        row[f"{name}_worst"] = float(longest.max()) if len(values) else None
    row["visit_ns"] = float(1e9 * answers.query[close].sum() / max(answers.visits[close].sum(), 1.0))
    return row


def replay_trial(name: str, cracks: str, duration: float | None, settings: tuple[Settings, ...], repeats: int) -> Trial:
    """Computes the Answers of each of `settings`, whose times are of `repeats` interleaved runs."""
    words = f"{name}, {cracks} cracks, {len(settings)} times over"
    return Trial(_replay_all, (name, cracks, duration, settings, repeats), words, True)


def _replay_all(
    name: str, cracks: str, duration: float | None, settings: tuple[Settings, ...], repeats: int
) -> list[Answers]:
    recording = record(scene_with(name, cracks, duration))
    best: list[Answers] = [replay(recording, one) for one in settings]
    for _ in range(repeats - 1):
        for i, one in enumerate(settings):
            again = replay(recording, one)
            best[i] = best[i]._replace(
                query=np.minimum(best[i].query, again.query), update=np.minimum(best[i].update, again.update),
                longest_query=np.maximum(best[i].longest_query, again.query),
                longest_update=np.maximum(best[i].longest_update, again.update),
            )  # fmt: skip
    return best

"""Surfaces of the fragments of a recorded run that were not recorded: computed from bodies and events."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from fracture_collision.bag.exchanges import read_runs
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.records import ADD, FragmentStates
from fracture_collision.viewer.film.recorded_run import RecordedRun, recorded_run
from fracture_collision.world import CollisionWorld, InvalidMessage

Progress = Callable[[int, int], None]  # fractures done, of how many


def read_run_with_meshes(
    bag: Path, namespace: str | None = None, progress: Progress = lambda done, total: None
) -> RecordedRun:
    """The last run of a bag, as `read_run` reads it, with a mesh of every fragment that its states show.

    Recorded meshes are used; the others are made by a CollisionWorld of its own, event by event. Raises BagError.
    """
    exchanges = read_runs(bag, namespace)[-1]
    run = recorded_run(bag, exchanges, namespace)
    unbroken = {body.fragment_id for body in run.bodies.values()}
    shown = set(np.unique(np.concatenate([states.fragment_ids for states in run.states])).tolist())
    missing = shown - set(run.meshes) - unbroken
    if not missing:
        return run
    events = [message.received.record for message in exchanges.events]
    makes_some = [not missing.isdisjoint(event.new_fragment_ids.tolist()) for event in events]
    last = max(np.flatnonzero(makes_some).tolist(), default=-1)
    world = CollisionWorld()
    meshes = dict(run.meshes)
    try:
        for message in exchanges.bodies:
            if message.received.record.operation == ADD:
                world.add_body(message.received.record)
        for done, event in enumerate(events[: last + 1]):
            progress(done, last + 1)
            world.add_fracture(event)
            wanted = missing.intersection(event.new_fragment_ids.tolist())
            if wanted:
                world.contacts(_nobody_at(event.sequence))  # brings the registry there
                meshes |= {fragment_id: world.fragment_mesh(fragment_id) for fragment_id in sorted(wanted)}
        progress(last + 1, last + 1)
    except InvalidMessage as error:
        raise BagError(f"{bag}: cannot compute meshes from its bodies and events: {error}") from error
    return run._replace(meshes=meshes)


def _nobody_at(sequence: int) -> FragmentStates:
    nothing = np.zeros(0)
    return FragmentStates(0, sequence, nothing.astype(np.uint32), nothing, nothing)

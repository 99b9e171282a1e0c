"""A run recorded in a bag: bodies, fractures, meshes, the states of each step and the answers."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fracture_collision.bag.exchanges import Question, Run, deserialize_record, read_runs, topics_of
from fracture_collision.bag.reader import BagError, read_messages
from fracture_collision.records import REMOVE, CollisionBody, ContactConstraintArray, FragmentMesh, FragmentStates

NO_ANSWERS: Mapping[int, bytes] = {}


class RecordedStates(NamedTuple):
    """States of n fragments at one step of a recording."""

    time: float  # [s], simulated
    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray  # (n,)
    positions: np.ndarray  # (n, 3) [m]
    orientations: np.ndarray  # (n, 4) x y z w


class RecordedRun(NamedTuple):
    """A recorded run, as films and the page show it."""

    bodies: dict[int, CollisionBody]  # by body_id
    body_of: dict[int, int]  # fragment_id -> body_id
    meshes: dict[int, FragmentMesh]  # by fragment_id
    states: list[RecordedStates]  # ascending in step
    answers: Mapping[int, bytes] = NO_ANSWERS  # by step, serialized; only recorded ones

    def contacts(self, step: int) -> ContactConstraintArray | None:
        """The answer to the states of a step; None if it was not recorded. Raises BagError."""
        data = self.answers.get(step)
        if data is None:
            return None
        try:
            return deserialize_record(data, ContactConstraintArray).record
        except ValueError as error:
            raise BagError(f"step {step}: {error}") from error


def read_run(bag: Path, namespace: str | None = None) -> RecordedRun:
    """Read the last run of a bag: a rosbag2 folder, or one .mcap file.

    Topics are identified by message type, so the run may have been recorded under any namespace; `namespace` selects
    one of several. Raises BagError with a reason if there is no such file, no FragmentStates in it, or a message does
    not match its topic.
    """
    return recorded_run(bag, read_runs(bag, namespace)[-1], namespace)


def recorded_run(bag: Path, run: Run, namespace: str | None = None) -> RecordedRun:
    """One of the runs that `read_runs` found in the bag, with the meshes recorded beside it. Raises BagError."""
    added = (message.received.record for message in run.bodies)
    bodies = {body.body_id: body for body in added if body.operation != REMOVE}
    body_of = {body.fragment_id: body.body_id for body in bodies.values()}
    for message in run.events:
        event = message.received.record
        body_of.update((f, event.body_id) for f in event.new_fragment_ids.tolist())
    states = [_states(bag, question) for question in run.questions]
    answers = {question.step: question.answers[0] for question in run.questions if question.answers}
    return RecordedRun(bodies, body_of, _meshes(bag, run.run_id, namespace), states, answers)


def _meshes(bag: Path, run_id: int, namespace: str | None) -> dict[int, FragmentMesh]:
    meshes: dict[int, FragmentMesh] = {}
    topics = topics_of(bag, [FragmentMesh], namespace)
    if not topics:
        return meshes
    for message in read_messages(bag, list(topics)):
        try:
            received = topics[message.topic].read(message.data)
        except ValueError as error:
            raise BagError(f"{bag}: {message.topic}: {error}") from error
        mesh = received.record
        fits = mesh.vertices.ndim == mesh.triangles.ndim == 2 and len(mesh.triangles) == len(mesh.is_crack)
        if not fits or np.any(mesh.triangles >= len(mesh.vertices)) or not np.isfinite(mesh.vertices).all():
            raise BagError(f"{bag}: {message.topic}: the mesh of fragment {mesh.fragment_id} is not made of triangles")
        if received.run_id == run_id:
            meshes[mesh.fragment_id] = mesh
    return meshes


def _states(bag: Path, question: Question) -> RecordedStates:
    states: FragmentStates = deserialize_record(question.states, FragmentStates).record
    count = len(states.fragment_ids)
    if states.positions.shape != (count, 3) or states.orientations.shape != (count, 4):
        raise BagError(f"{bag}: step {states.step}: the numbers of poses and fragments differ")
    return RecordedStates(
        time=1e-9 * question.time,
        step=states.step,
        fracture_sequence=states.fracture_sequence,
        fragment_ids=states.fragment_ids.astype(np.int64),
        positions=states.positions,
        orientations=states.orientations,
    )

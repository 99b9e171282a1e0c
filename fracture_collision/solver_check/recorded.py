"""What a run has published, and the motion that follows from it.

Velocities and spins are derived from poses, since simulators publish velocities before contacts, or none.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fracture_collision.bag.exchanges import deserialize_record, read_runs, topics_of
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import read_messages
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentRegistry,
    FragmentStates,
)
from fracture_collision.simulation.step_records import StepReport


class Impulses(NamedTuple):
    """What a solver in this process returned in a step."""

    contacts: ContactConstraintArray  # those solved
    normal: np.ndarray  # (N,) [N s]
    seconds: float  # [s] of wall time in `solve` and `move`


class Recorded(NamedTuple):
    """One run of a scene."""

    time_step: float  # [s]
    bodies: list[CollisionBody]
    states: list[FragmentStates]  # of each step, ascending
    contacts: list[ContactConstraintArray]  # the answers to them
    events: list[FractureEvent]
    registries: dict[int, FragmentRegistry]  # by fracture_sequence
    # Of each step, where the solver is in this process: a node does not publish them.
    impulses: list[Impulses] | None = None
    reports: list[StepReport] | None = None
    torques: list[np.ndarray] | None = None  # (k,) [N m], [N] of the motors of a robot; None: the scene has none

    def id_of(self, name: str) -> int:
        """The id of a body, and of its fragment before any fracture. KeyError if there is none of this name."""
        for body in self.bodies:
            if body.name == name:
                return body.fragment_id
        raise KeyError(name)

    def track(self, name: str) -> Track:
        """The motion of a body that does not break."""
        return self.track_of(self.id_of(name))

    def track_of(self, fragment_id: int) -> Track:
        """The motion of a fragment, in the steps in which it lives. ValueError if it has less than two states."""
        first, positions, orientations, velocities = -1, [], [], []
        for k, states in enumerate(self.states):
            rows = np.flatnonzero(np.asarray(states.fragment_ids) == fragment_id)
            if not len(rows):
                continue
            first, row = k if first < 0 else first, rows[0]
            positions.append(states.positions[row])
            orientations.append(states.orientations[row])
            if len(states.linear_velocities):
                velocities.append(states.linear_velocities[row])
        if len(positions) < 2:
            raise ValueError(f"fragment {fragment_id} has {len(positions)} published states: at least 2 are needed")
        registry = next(each for each in self.registries.values() if fragment_id in each.fragment_ids)
        row = int(np.flatnonzero(registry.fragment_ids == fragment_id)[0])
        xx, xy, xz, yy, yz, zz = registry.inertias[row]
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        turns = matrices(np.array(orientations))
        origins = np.array(positions)
        return Track(
            fragment_id, self.time_step, first, float(registry.masses[row]), inertia,
            origins, origins + turns @ registry.centers_of_mass[row], turns, np.array(velocities),
        )  # fmt: skip

    def pair(self, k: int, one: int, other: int) -> tuple[np.ndarray, np.ndarray]:
        """Gaps (N,) [m] and normals (N, 3), from the smaller id to the larger, of two fragments in the k-th answer."""
        contacts = self.contacts[k]
        here = (contacts.fragment_a == min(one, other)) & (contacts.fragment_b == max(one, other))
        begin = contacts.pair_begin.astype(np.int64)
        rows = [np.arange(begin[p], begin[p + 1]) for p in np.flatnonzero(here)]
        chosen = np.concatenate(rows) if rows else np.zeros(0, np.int64)
        return contacts.gaps[chosen], contacts.normals[chosen]

    def digest(self) -> str:
        """SHA-256 over ids and poses of all steps."""
        found = hashlib.sha256()
        for states in self.states:
            for column in (states.fragment_ids, states.positions, states.orientations):
                found.update(np.ascontiguousarray(column).tobytes())
        return found.hexdigest()


class Track(NamedTuple):
    """The motion of one fragment over S states."""

    fragment_id: int
    time_step: float  # [s]
    first: int  # index of its first states among those of the run
    mass: float  # [kg]
    inertia: np.ndarray  # (3, 3) [kg m2] about the centre of mass, body axes
    origins: np.ndarray  # (S, 3) [m] of the body frame
    centers: np.ndarray  # (S, 3) [m] of mass
    turns: np.ndarray  # (S, 3, 3) body frame to world
    published: np.ndarray  # (S, 3) [m/s] of the origin, as published; (0, 3): none

    def velocities(self) -> np.ndarray:
        """(S - 1, 3) [m/s] of the centre of mass in each step."""
        return np.diff(self.centers, axis=0) / self.time_step

    def spins(self) -> np.ndarray:
        """(S - 1, 3) [rad/s], world axes: the constant spin that turns the fragment as it turned in each step."""
        return rotation_vectors(self.turns[1:] @ self.turns[:-1].transpose(0, 2, 1)) / self.time_step

    def smooth_spins(self) -> np.ndarray:
        """(S - 4, 3) [rad/s] of states 2 .. S - 3, world axes, to fourth order: for motion without contacts."""
        def turned(by: int) -> np.ndarray:
            middle = self.turns[2:-2]
            other = self.turns[2 + by : len(self.turns) - 2 + by]
            return rotation_vectors(other @ middle.transpose(0, 2, 1))

        return (8.0 * (turned(1) - turned(-1)) - (turned(2) - turned(-2))) / (12.0 * self.time_step)

    def momenta(self, steps: slice) -> tuple[np.ndarray, np.ndarray]:
        """Mean linear [N s] and angular momentum [N m s] about the world's origin, (3,) each, in free `steps`."""
        velocities, spins = self.velocities()[steps], self.spins()[steps]
        turns = self.turns[:-1][steps]
        own = np.einsum("nij,jk,nlk,nl->ni", turns, self.inertia, turns, spins)
        angular = self.mass * np.cross(self.centers[:-1][steps], velocities) + own
        return self.mass * velocities.mean(axis=0), angular.mean(axis=0)

    def smooth_spin_momenta(self) -> np.ndarray:
        """(S - 4, 3) [N m s] about the centre of mass, of states 2 .. S - 3."""
        turns = self.turns[2:-2]
        return np.einsum("nij,jk,nlk,nl->ni", turns, self.inertia, turns, self.smooth_spins())


def matrices(quaternions: np.ndarray) -> np.ndarray:
    """(n, 3, 3) of unit quaternions x y z w (n, 4)."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


def rotation_vectors(turns: np.ndarray) -> np.ndarray:
    """(n, 3) [rad] of rotation matrices (n, 3, 3), by less than half a turn."""
    axes = 0.5 * np.stack(
        (turns[:, 2, 1] - turns[:, 1, 2], turns[:, 0, 2] - turns[:, 2, 0], turns[:, 1, 0] - turns[:, 0, 1]), axis=1
    )
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    cosines = 0.5 * (np.trace(turns, axis1=1, axis2=2)[:, None] - 1.0)
    angles = np.arctan2(sines, cosines)
    return np.where(sines > 1e-12, angles / np.maximum(sines, 1e-300), 1.0) * axes


def read_recorded(bag: Path, time_step: float) -> Recorded:
    """The one run in a bag. BagError if it has none or several, or steps without an answer."""
    runs = read_runs(bag)
    if len(runs) != 1:
        raise BagError(f"{bag}: holds {len(runs)} runs; the simulator must start one")
    run = runs[0]
    unanswered = [question.step for question in run.questions if not question.answers]
    # The last states may have no answer: a simulator may end when it has published them.
    questions = [question for question in run.questions if question.answers]
    if len(unanswered) > 1 or not questions:
        raise BagError(f"{bag}: {len(unanswered)} of {len(run.questions)} states have no answer")
    registries: dict[int, FragmentRegistry] = {}
    codecs = topics_of(bag, [FragmentRegistry])
    for message in read_messages(bag, list(codecs)):
        received = codecs[message.topic].read(message.data)
        if received.run_id == run.run_id:
            registries[received.record.fracture_sequence] = received.record
    return Recorded(
        time_step,
        [message.received.record for message in run.bodies],
        [deserialize_record(question.states, FragmentStates).record for question in questions],
        [deserialize_record(question.answers[-1], ContactConstraintArray).record for question in questions],
        [message.received.record for message in run.events],
        registries,
    )

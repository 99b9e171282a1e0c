"""What a step of the simulation requests from the collision service and expects of its answer, and what it reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates
from fracture_collision.simulation.engine import BodyStates, FrameState


class StepRequest(NamedTuple):
    """Records to publish before the service can answer."""

    states: FragmentStates
    bodies: list[CollisionBody]  # not yet announced, neither by `start_bodies` nor by an earlier request
    events: list[FractureEvent]  # since the last request


class StepReport(NamedTuple):
    """Figures of one step."""

    step: int
    time: float  # [s] at the end of the step
    contacts: int  # listed by the service
    fragments: int  # in motion
    solver_seconds: float  # wall time of the contact solver
    fracture_seconds: float  # wall time of making the patterns; 0 where nothing was hit hard enough
    kinetic_energy: float  # [J] at the end of the step, without a robot's
    potential_energy: float  # [J] likewise, in the scene's gravity, relative to the world's origin
    drift_energy: float  # [J] potential energy added by this step's drift correction in lifting bodies
    max_speed: float  # [m/s] of any centre of mass at the end of the step
    deepest_gap: float  # [m] the smallest gap among the contacts that are solved; 0 without
    events: list[FractureEvent]  # of this step, published with the next request
    hand_energy: float  # [J] added by hand, hammer and robot; negative where they removed some


def fragment_states(
    step: int, sequence: int, moving: BodyStates, others: Mapping[int, FrameState]
) -> FragmentStates:
    """States of the bodies in motion and of the `others`, by fragment id, that are not in the engine."""
    ids = np.concatenate((moving.fragment_ids, np.array(list(others), dtype=np.uint32)))
    order = np.argsort(ids, kind="stable")
    in_engine = FrameState(moving.frame_positions, moving.frame_orientations, moving.frame_velocities(), moving.angular)
    columns = [
        np.concatenate((values, np.array([frame[k] for frame in others.values()]).reshape(-1, values.shape[1])))
        for k, values in enumerate(in_engine)
    ]
    positions, orientations, linear, angular = (column[order] for column in columns)
    return FragmentStates(step, sequence, ids[order], positions, orientations, linear, angular)


# Relative; a lookahead that was written with four digits is meant to be the time step
NEARLY = 1e-3


class LookaheadCheck:
    """Compares the `lookahead` of answers with the one expected [s]; None: any will do."""

    def __init__(self, expected: float | None) -> None:
        self._expected = expected
        self._last = expected

    def unexpected(self, lookahead: float) -> str:
        """What is wrong with the `lookahead` [s] of an answer, and what to do; "": nothing, or nothing new."""
        expected, last, self._last = self._expected, self._last, lookahead
        if expected is None or lookahead == last or math.isclose(lookahead, expected, rel_tol=NEARLY):
            return ""
        effect = "contacts are listed that do not come about within a step"
        if lookahead < expected:
            effect = "fast bodies may pass through others"
        return (
            f"the service's answers have a lookahead of {lookahead:g} s, but this simulation counts on its time step,"
            f" {expected:g} s: {effect}. Set the service's parameter lookahead:={expected:g}, in Python"
            f" Settings(lookahead={expected:g}), or simulate with looks_ahead false"
        )

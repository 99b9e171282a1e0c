"""Simulator and service together, in one process: a plate on a shelf is smashed and comes to rest."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fracture_collision.geometry import generators
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene


def smash(scene):
    """All reports, all answers' bytes, the last contacts, and the lowest point [m] of each fragment at the end."""
    reports, answers = [], []
    with Lockstep(scene) as run:
        for states, contacts, _, report, _ in run:
            parts = (contacts.gaps, contacts.normals, contacts.contact_ids, states.positions)
            answers.append(b"".join(part.tobytes() for part in parts))
            reports.append(report)
        return reports, answers, contacts, lowest_points(run)


def lowest_points(run: Lockstep) -> list[float]:
    """Lowest point of each fragment and body in the states; frame origins would not do, as they may be anywhere."""
    states = run.states()
    run.world.contacts(states)
    poses = zip(
        states.fragment_ids.tolist(), states.positions.reshape(-1, 3), states.orientations.reshape(-1, 4), strict=True
    )
    lowest = []
    for fragment, position, turn in poses:
        points = run.world.fragment_mesh(fragment).vertices.reshape(-1, 3)
        if len(points):
            lowest.append(float((position + Rotation.from_quat(turn).apply(points))[:, 2].min()))
    return lowest


@pytest.fixture(scope="module")
def scene():
    """One plate of the plates scene, of a coarse mesh, one ball, over a shelf only 10 cm high."""
    full = load_scene("plates")
    coarse = generators.plate(0.25, 0.01, 0.025, 0.018, layers=1)
    bodies = []
    for body in full.bodies:
        if body.name == "plate 1":
            bodies.append(body._replace(shape=body.shape._replace(mesh=coarse)))
        elif body.name == "ball 1":
            bodies.append(body._replace(start_time=0.0, position=body.position + [0.0, 0.8, -0.02]))
        elif body.is_static:
            bodies.append(body)
    return full._replace(bodies=tuple(bodies), duration=2.0)


@pytest.fixture(scope="module")
def run(scene):
    return smash(scene)


def test_the_plate_breaks_and_comes_to_rest(run):
    reports, _, contacts, _ = run
    events = [event for report in reports for event in report.events]
    assert [event.sequence for event in events] == list(range(1, len(events) + 1))
    assert reports[-1].fragments >= 10
    assert reports[-1].max_speed < 0.01
    assert contacts.gaps.min() > -0.002


def test_nothing_falls_through_shelf_or_ground(run):
    lowest = run[3]
    assert len(lowest) >= 10
    assert min(lowest) > -0.002  # as deep as a contact may be


def test_energy_never_rises_without_cause(run):
    reports = run[0]
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    drift = np.array([report.drift_energy for report in reports])
    unbroken = np.diff([report.fragments for report in reports]) == 0
    rise = (np.diff(energy) - drift[1:])[unbroken]
    assert rise.max() < 2e-5 * energy.max()
    assert drift.sum() < 0.02 * energy.max()


def test_a_shorter_run_gives_the_same_bytes(scene, run):
    part = scene._replace(duration=0.5)
    assert smash(part)[1] == run[1][: part.step_count]

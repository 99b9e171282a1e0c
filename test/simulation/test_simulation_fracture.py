"""Fracture within a simulation: when bodies break, and conservation of motion."""

from __future__ import annotations

import numpy as np
import pytest
from truth.simulation_oracle import Oracle

from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.engine import RigidBodyWorld
from fracture_collision.simulation.scene.scene import parse_scene
from fracture_collision.simulation.simulation import Simulation


class WatchedWorld(RigidBodyWorld):
    """Records its contents before and after its last step."""

    def advance(self, *velocities):
        self.before = self.states()
        super().advance(*velocities)
        self.after = self.states()


def breaking_scene(plates=1):
    porcelain = {
        "density": 2400.0, "friction": 0.5,
        "fracture": {"strength": 0.2, "minimum_mass": 0.02, "pattern": {"seeds": 8, "minimum_nodes": 6}},
    }  # fmt: skip
    plate = {"diameter": 0.25, "thickness": 0.008, "edge_length": 0.0125, "rim_height": 0.018, "layers": 2}
    content = {
        "seed": 5, "gravity": [0.0, 0.0, 0.0], "time_step": 0.0025, "duration": 1.0,
        "materials": {"porcelain": porcelain, "steel": {"density": 7800.0, "friction": 0.3}},
        "bodies": [
            {"name": f"plate {i}", "material": "porcelain", "shape": {"plate": plate},
             "position": [0.5 * i, 0.1, 0.2], "rotation": [30.0, 20.0, 10.0],
             "linear_velocity": [0.3, -0.2, 1.0], "angular_velocity": [3.0, 7.0, -5.0]}
            for i in range(plates)
        ] + [
            {"name": f"ball {i}", "material": "steel", "shape": {"sphere": {"radius": 0.03}},
             "position": [0.5 * i, 0.1, 0.24], "linear_velocity": [0.0, 0.0, -20.0]}
            for i in range(plates)
        ],
    }  # fmt: skip
    return parse_scene(content, "breaking")


def touching(states, pairs):
    """One contact for each (a, b, point, normal), without a gap."""
    count = len(pairs)
    points = np.concatenate([np.zeros(0), *(point for _, _, point, _ in pairs)])
    normals = np.concatenate([np.zeros(0), *(normal for *_, normal in pairs)])
    return ContactConstraintArray(
        states.step, states.fracture_sequence, 0,
        np.array([a for a, *_ in pairs], np.uint32), np.array([b for _, b, *_ in pairs], np.uint32),
        np.arange(count + 1, dtype=np.uint32), np.zeros(count), np.full(count, 0.5), np.zeros(count),
        points, points, normals, np.zeros(count), np.zeros(count, np.uint64),
    )  # fmt: skip


def momenta(states, fragment_ids):
    """Total linear and angular momentum of these fragments, about the world's origin, and their mass."""
    rows = np.isin(states.fragment_ids, fragment_ids)
    linear = states.masses[rows, None] * states.linear[rows]
    angular = np.cross(states.centers[rows], linear)
    angular += np.einsum("nij,nj->ni", states.inertias[rows], states.angular[rows])
    return np.concatenate((linear.sum(axis=0), angular.sum(axis=0), [states.masses[rows].sum()]))


class Run:
    def __init__(self, scene, **more):
        self.world = WatchedWorld(scene.time_step)
        self.simulation = Simulation(scene, engine=self.world, **more)
        self.oracle = Oracle(self.simulation.start_bodies())

    def step(self, find_pairs=lambda states: []):
        request = self.simulation.begin_step()
        for event in request.events:
            self.oracle.add_fracture(event)
        contacts = touching(request.states, find_pairs(request.states))
        return request, self.simulation.finish_step(contacts, self.oracle.registry())


@pytest.fixture
def start_run():
    runs = []

    def start(*arguments, **more):
        runs.append(Run(*arguments, **more))
        return runs[-1]

    yield start
    for run in runs:
        run.simulation.close()


UP = np.array([0.0, 0.0, 1.0])


def balls_on_plates(states, plates=1):
    """Each ball falls and touches its plate from above."""
    positions = states.positions.reshape(-1, 3)
    return [(1 + i, 1 + plates + i, positions[plates + i] - 0.03 * UP, UP) for i in range(plates)]


def test_pieces_keep_the_momentum_of_the_whole(start_run):
    run = start_run(breaking_scene())
    _, report = run.step(balls_on_plates)
    assert [event.sequence for event in report.events] == [1]
    whole = momenta(run.world.after, [1])
    request, _ = run.step()
    pieces = request.events[0].new_fragment_ids
    assert set(pieces) <= set(request.states.fragment_ids)
    assert 1 not in request.states.fragment_ids
    np.testing.assert_allclose(momenta(run.world.before, pieces), whole, rtol=0, atol=1e-12)

    # The ball hits the heaviest piece next.
    now = run.world.after
    row = max(np.flatnonzero(np.isin(now.fragment_ids, pieces)), key=lambda i: now.masses[i])
    victim = int(now.fragment_ids[row])
    _, report = run.step(lambda states: [(2, victim, now.centers[row], -UP)])
    assert [(event.sequence, event.fragment_id) for event in report.events] == [(2, victim)]
    whole = momenta(run.world.after, [victim])
    request, _ = run.step()
    pieces = request.events[0].new_fragment_ids
    np.testing.assert_allclose(momenta(run.world.before, pieces), whole, rtol=0, atol=1e-12)


def test_two_bodies_break_in_one_step(start_run):
    run = start_run(breaking_scene(plates=2))
    _, report = run.step(lambda states: balls_on_plates(states, 2))
    assert [(event.sequence, event.body_id) for event in report.events] == [(1, 1), (2, 2)]
    request, _ = run.step()
    assert request.states.fracture_sequence == 2
    new_ids = np.concatenate([event.new_fragment_ids for event in request.events])
    np.testing.assert_array_equal(np.sort(new_ids), np.arange(5, 5 + len(new_ids)))
    run.step()


def test_a_plate_that_breaks_transmits_its_strength_and_no_more(start_run):
    run = start_run(breaking_scene())
    ball_mass = 7800.0 * 4.0 / 3.0 * np.pi * 0.03**3
    run.step(balls_on_plates)
    ball = run.world.after.linear[np.flatnonzero(run.world.after.fragment_ids == 2)[0]]
    assert ball_mass * (ball[2] + 20.0) == pytest.approx(0.2, rel=1e-9)


def test_a_blow_below_the_strength_breaks_nothing(start_run):
    scene = breaking_scene()
    slow = scene.bodies[1]._replace(linear_velocity=np.array([0.0, 0.0, 1.0]))
    run = start_run(scene._replace(bodies=(scene.bodies[0], slow)))
    for _ in range(3):
        _, report = run.step(balls_on_plates)
        assert report.events == []


def test_the_pattern_depends_on_the_seed(start_run):
    events = []
    for seed in (None, 5, 6):
        run = start_run(breaking_scene(), seed=seed)
        events.append(run.step(balls_on_plates)[1].events[0])
    assert events[0].cut_planes.tobytes() == events[1].cut_planes.tobytes() != events[2].cut_planes.tobytes()


def test_a_body_joins_at_its_start_time(start_run):
    scene = breaking_scene()
    thrown = scene.bodies[1]._replace(start_time=2 * scene.time_step)
    run = start_run(scene._replace(bodies=(scene.bodies[0], thrown)))
    named = [run.step()[0].states.fragment_ids.tolist() for _ in range(4)]
    assert named == [[1], [1], [1, 2], [1, 2]]

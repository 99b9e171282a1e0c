"""The engine: frames, free motion, no damping, no clamps, no leaks between worlds; compared with Bullet."""

from __future__ import annotations

import numpy as np
import pybullet
import pytest
from scipy.spatial.transform import Rotation

from fracture_collision.simulation.engine import (
    FrameState,
    MassProperties,
    RigidBodyWorld,
    free_velocities,
    mean_spins,
)
from fracture_collision.simulation.solver.contact_solver import kinetic_energy

STEP = 1.0 / 400.0


def lopsided(rng):
    arms = rng.normal(size=(6, 3)) * (0.3, 0.1, 0.05)
    inertia = np.trace(arms.T @ arms) * np.eye(3) - arms.T @ arms
    return MassProperties(1.7, rng.normal(size=3), inertia)


def tumbling(rng):
    orientation = Rotation.random(random_state=3).as_quat()
    return FrameState(rng.normal(size=3), orientation, rng.normal(size=3), rng.normal(size=3) * 20)


@pytest.fixture
def world():
    worlds = []

    def make():
        worlds.append(RigidBodyWorld(STEP))
        return worlds[-1]

    yield make
    for each in worlds:
        each.close()
        each.close()


def test_the_body_frame_is_returned_as_it_was_set(world):
    rng = np.random.default_rng(1)
    engine, properties, frame = world(), lopsided(rng), tumbling(rng)
    engine.add(5, properties, frame)
    states = engine.states()
    for got, expected in zip(states.frame(0), frame, strict=True):
        sign = np.sign(got @ expected) if len(expected) == 4 else 1.0
        np.testing.assert_allclose(sign * got, expected, atol=1e-14)
    rotation = Rotation.from_quat(frame.orientation)
    center = frame.position + rotation.apply(properties.center_of_mass)
    np.testing.assert_allclose(states.centers[0], center, atol=1e-14)
    turned = rotation.as_matrix() @ properties.inertia @ rotation.as_matrix().T
    np.testing.assert_allclose(states.inertias[0], turned, atol=1e-14)


@pytest.mark.parametrize("spin", [0.0, 1e-320, 1e-160, 1e-80, 1e-60, 1e-20])
def test_the_spin_of_a_body_that_hardly_turns_is_a_number(spin: float) -> None:
    """Squares of squares of it are not."""
    before = np.array([[spin, 2.0 * spin, -spin]])
    after = before * 1.001
    still = np.zeros((1, 3))
    velocities, free = np.hstack((still, before)), np.hstack((still, after))
    found = mean_spins(velocities, free, np.diag([1e-3, 2e-3, 3e-3])[None], np.full(1, STEP))
    np.testing.assert_allclose(found, before, rtol=0.01, atol=1e-12)  # [rad/s] rounding of the turn


@pytest.mark.parametrize("spin", [10.0, 1e3, 1e4])
def test_a_body_that_rotates_many_times_in_a_step_gains_no_energy(spin):
    """At ten thousand radians a second Newton's method does not converge over the whole step at once."""
    rng = np.random.default_rng(7)
    inertias = np.repeat(np.diag([1e-5, 2e-5, 2.9e-5])[None], 200, axis=0)
    velocities = np.zeros((200, 6))
    velocities[:, 3:] = spin * rng.normal(size=(200, 3))
    free = free_velocities(velocities, inertias, np.zeros(3), np.full(200, 0.01))
    masses = np.ones(1)
    for before, after in zip(velocities, free, strict=True):
        energies = [kinetic_energy(masses, inertias[:1], u[None]) for u in (before, after)]
        assert energies[1] == pytest.approx(energies[0], rel=1e-9)


def test_drift_moves_poses_and_leaves_velocities(world):
    rng = np.random.default_rng(4)
    engine = world()
    engine.add(1, lopsided(rng), FrameState(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), np.zeros(3)))
    before = engine.states()
    drift = np.array([[0.1, 0.2, 0.3]])
    still = np.zeros((1, 3))
    engine.advance(still, still, drift, np.array([[0.0, 0.0, 2.0]]))
    after = engine.states()
    np.testing.assert_allclose(after.centers - before.centers, STEP * drift, atol=1e-15)
    turned = Rotation.from_quat(after.frame_orientations[0]).as_rotvec()
    np.testing.assert_allclose(turned, [0, 0, 2.0 * STEP], atol=1e-14)
    np.testing.assert_allclose(after.linear, 0.0, atol=1e-15)
    np.testing.assert_allclose(after.angular, 0.0, atol=1e-12)


def test_added_and_removed_bodies_move_as_each_would_alone(world):
    rng = np.random.default_rng(7)
    bodies = {i: (lopsided(rng), tumbling(rng)._replace(orientation=Rotation.random(random_state=i).as_quat()))
              for i in range(1, 9)}  # fmt: skip
    comings, goings = {0: (1, 2, 3, 4), 2: (5,), 4: (6, 7, 8)}, {2: (2, 4), 3: (1,), 5: (7,)}

    def run(only):
        """All states of each body, step by step."""
        engine, seen = world(), {}
        for step in range(8):
            for i in goings.get(step, ()):
                if i in only:
                    engine.remove(i)
            for i in comings.get(step, ()):
                if i in only:
                    engine.add(i, *bodies[i])
            states = engine.states()
            assert states.fragment_ids.tolist() == sorted(states.fragment_ids.tolist())
            for row, i in enumerate(states.fragment_ids.tolist()):
                seen.setdefault(i, []).append([column[row].tobytes() for column in states])
            drift = np.full((len(states.masses), 3), 0.01)
            engine.advance(states.linear, states.angular, drift, -drift)
        return seen

    together = run(bodies)
    assert {i: len(seen) for i, seen in together.items()} == {1: 3, 2: 2, 3: 8, 4: 2, 5: 6, 6: 4, 7: 1, 8: 4}
    for i, seen in together.items():
        assert run([i]) == {i: seen}


def test_a_step_moves_a_body_as_bullet_does(world):
    """Bullet integrates by the same formulas; it rounds sin and cos as the processor's libm does."""
    rng = np.random.default_rng(8)
    client = pybullet.connect(pybullet.DIRECT)
    try:
        pybullet.setTimeStep(STEP, physicsClientId=client)
        for spin in (0.0, 1e-6, 0.02, 1.0, 100.0):
            turn = Rotation.random(random_state=rng).as_quat()
            velocity, angular = rng.normal(size=3), spin * rng.normal(size=3)
            body = pybullet.createMultiBody(baseMass=1.0, baseOrientation=turn.tolist(), physicsClientId=client)
            pybullet.changeDynamics(
                body, -1, localInertiaDiagonal=[1.0, 1.0, 1.0], linearDamping=0.0, angularDamping=0.0,
                maxJointVelocity=1e6, physicsClientId=client,
            )  # fmt: skip
            pybullet.resetBaseVelocity(body, velocity.tolist(), angular.tolist(), physicsClientId=client)
            engine = world()
            engine.add(1, MassProperties(1.0, np.zeros(3), np.eye(3)), FrameState(np.zeros(3), turn, velocity, angular))
            for _ in range(20):
                pybullet.stepSimulation(physicsClientId=client)
                states = engine.states()
                engine.advance(states.linear, states.angular, np.zeros((1, 3)), np.zeros((1, 3)))
            position, orientation = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
            np.testing.assert_allclose(engine.states().centers[0], position, atol=1e-13)
            assert abs(engine.states().frame_orientations[0] @ orientation) == pytest.approx(1.0, abs=1e-13)
            pybullet.removeBody(body, physicsClientId=client)
    finally:
        pybullet.disconnect(client)

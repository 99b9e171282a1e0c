"""The contact solver in whole runs, and impacts without loss along a row."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from worlds.small_scenes import GROUND, ball, box, small_scene

from fracture_collision.lockstep import Lockstep
from fracture_collision.world import Settings

GRAVITY = 9.81


STONE = {"density": 2400.0, "friction": 0.5, "restitution": 0.0, "rolling_arm": 0.0}
LOSSLESS = {"density": 1000.0, "friction": 0.0, "restitution": 1.0}


def make_scene(*bodies, stone=None, ground=GROUND, **more):
    return small_scene(STONE | (stone or {}), ground, *bodies, **{"time_step": 1.0 / 240.0, "duration": 2.0} | more)


# Solved exactly, (1)-(3) never gain energy: dE <= -|du|^2_M / 2. Gauss-Seidel stops before the exact solution; the
# remainder is this share of the energy, with potential energy measured from the ground.
ENERGY_GAIN = 2e-5


def run(scene, energy_gain=ENERGY_GAIN, **settings):
    """Reports of all steps, and the last states; no step may gain energy."""
    with Lockstep(scene, Settings(threads=1, **settings)) as lockstep:
        reports = [exchange.report for exchange in lockstep]
        states = lockstep.states()
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    rise = np.diff(energy) - [report.drift_energy for report in reports[1:]]
    assert (rise < energy_gain * np.abs(energy[:-1])).all()
    return reports, states


TUMBLING = [
    box(f"box {i}", [0.2, 0.15, 0.1], [0.02 * i, 0.0, 0.1 + 0.15 * i], rotation=[9.0 * i, 5.0, 0]) for i in range(4)
]


def test_no_energy_is_gained_where_the_contacts_are_solved_to_the_end():
    solver = {"iterations": 1000, "accuracy": 0.0}
    reports, _ = run(make_scene(*TUMBLING, duration=1.2, solver=solver), energy_gain=1e-9)
    assert reports[0].potential_energy - reports[-1].potential_energy > 5.0
    assert reports[-1].max_speed < 1e-6


def test_friction_is_a_cone():
    """A block sliding along the diagonal of the tangents slows down by mu g, no more, and keeps its direction."""
    velocity = np.array([1.0, 1.0, 0.0])
    block = box("block", [0.2, 0.2, 0.02], [0.0, 0.0, 0.01], linear_velocity=velocity.tolist())
    reports, states = run(make_scene(block, duration=0.2))
    expected = velocity * (1.0 - 0.5 * GRAVITY * 0.2 / np.sqrt(2.0))
    expected[2] = -GRAVITY / 240.0  # of the coming step, before contacts
    np.testing.assert_allclose(states.linear_velocities[0], expected, atol=0.03)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 0.9])
def test_a_ball_bounces_by_its_restitution(restitution):
    scene = make_scene(
        ball("ball", 0.05, [0.0, 0.0, 0.55]), stone={"restitution": restitution}, duration=0.9, time_step=1e-3
    )
    reports, _ = run(scene)
    speed = np.sqrt(2.0 * GRAVITY * 0.5)
    after = reports[1 + np.argmax(np.diff([r.max_speed for r in reports]) < 0.0)]
    assert after.max_speed == pytest.approx(restitution * speed, abs=0.02)


def test_a_sliding_ball_ends_up_rolling_at_five_sevenths():
    reports, states = run(make_scene(ball("ball", 0.05, [0.0, 0.0, 0.05], linear_velocity=[1.0, 0.0, 0.0])))
    assert states.linear_velocities[0, 0] == pytest.approx(5.0 / 7.0, rel=5e-3)
    assert states.angular_velocities[0, 1] == pytest.approx(states.linear_velocities[0, 0] / 0.05, rel=5e-3)


def test_rolling_resistance_stops_a_ball():
    """Rolling, a sphere of radius r decelerates by 5/7 g rho / r."""
    arm = 2e-3
    scene = make_scene(
        ball("ball", 0.05, [0.0, 0.0, 0.05], linear_velocity=[0.5, 0.0, 0.0], angular_velocity=[0.0, 10.0, 0.0]),
        stone={"rolling_arm": arm}, duration=1.0,
    )  # fmt: skip
    reports, states = run(scene)
    assert states.linear_velocities[0, 0] == pytest.approx(0.5 - 5.0 / 7.0 * GRAVITY * arm / 0.05, abs=0.01)
    reports, states = run(scene._replace(duration=3.0))
    assert reports[-1].max_speed < 1e-9


def test_bodies_that_do_not_touch_do_not_affect_each_other():
    """Islands are solved separately: tumbling boxes move byte for byte the same with and without a rolling ball."""
    alone = run(make_scene(*TUMBLING, duration=0.6))[1]
    other = ball("ball", 0.05, [3.0, 0.0, 0.05], linear_velocity=[1.0, 0.0, 0.0])
    beside = run(make_scene(*TUMBLING, other, duration=0.6))[1]
    assert len(beside.fragment_ids) == len(TUMBLING) + 1
    assert beside.linear_velocities[-1, 0] > 0.5
    assert beside.positions[:-1].tobytes() == alone.positions.tobytes()
    assert beside.orientations[:-1].tobytes() == alone.orientations.tobytes()


def test_answers_to_another_step_are_rejected():
    with Lockstep(make_scene(ball("ball", 0.05, [0.0, 0.0, 1.0])), Settings(threads=1)) as lockstep:
        simulation, world = lockstep.simulation, lockstep.world
        request = simulation.begin_step()
        answer = world.contacts(request.states)
        with pytest.raises(ValueError, match="needs the answer to"):
            simulation.finish_step(answer._replace(step=3), world.fragments())
        again = simulation.begin_step()
        assert again.states.step == request.states.step
        simulation.finish_step(answer, world.fragments())


def round_one(name: str, *position: float, **more: Any) -> dict[str, Any]:
    return ball(name, 0.05, position, **more)


def cube(name: str, *position: float, **more: Any) -> dict[str, Any]:
    return box(name, [0.1, 0.1, 0.1], position, **more)


either_shape = pytest.mark.parametrize("shape", [round_one, cube], ids=["ball", "cube"])


class Course(NamedTuple):
    """Of n bodies, at each of m steps."""

    centers: np.ndarray  # (m, n, 3) [m]
    linear: np.ndarray  # (m, n, 3) [m/s]
    momenta: np.ndarray  # (m, n, 3) [kg m2/s] angular
    energy: np.ndarray  # (m,) [J]


def course(bodies: list[dict[str, Any]], duration: float, gravity: float = 0.0, step: float = 0.0025) -> Course:
    scene = small_scene(LOSSLESS, *bodies, gravity=gravity, time_step=step, duration=duration)
    rows = []
    with Lockstep(scene, Settings(threads=1, lookahead=step)) as run:
        for each in run:
            states = run.simulation.dynamics.states()
            momenta = np.einsum("nij,nj->ni", states.inertias, states.angular)
            energy = each.report.kinetic_energy + each.report.potential_energy
            rows.append((states.centers, states.linear, momenta, energy))
    return Course(*map(np.array, zip(*rows, strict=True)))


@pytest.mark.parametrize(
    ("shape", "step", "lost"), [(round_one, 0.0025, 5e-5), (round_one, 0.01, 5e-4), (cube, 0.01, 5e-4)]
)
def test_a_bounce_without_loss_rises_as_high_as_it_fell(shape: Callable, step: float, lost: float) -> None:
    run = course([GROUND, shape("a", 0.0, 0.0, 0.55)], 3.0, gravity=9.81, step=step)
    z = run.centers[:, 0, 2]
    tops = np.flatnonzero((z[1:-1] >= z[:-2]) & (z[1:-1] > z[2:])) + 1
    assert len(tops) == 4
    for bounces, top in enumerate(tops, 1):
        assert run.energy[top] > (1.0 - lost * bounces) * run.energy[0]
    assert np.diff(run.energy).max() < 1e-12 * run.energy[0]


@either_shape
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_row_that_touches_passes_a_blow_on_to_as_many_at_its_end(shape: Callable, count: int) -> None:
    row = [
        shape(f"b{k}", 0.1 * k - 0.2 * (k < count), 0.0, 0.0, linear_velocity=[1.0 * (k < count), 0.0, 0.0])
        for k in range(5)
    ]
    run = course(row, 0.5)
    np.testing.assert_allclose(run.linear[-1, :, 0], [0.0] * (5 - count) + [1.0] * count, atol=1e-6)
    assert run.energy[-1] == pytest.approx(run.energy[0], rel=1e-9)


@pytest.mark.parametrize("restitution", [0.1, 0.3, 0.5, 0.8])
def test_a_light_ball_between_heavy_ones_passes_on_what_it_would_after_all_bounces(restitution: float) -> None:
    """Bounces end where they carry little: then all velocities are within 2 % of those after all of them."""
    radii, speeds = np.array([0.1, 0.03, 0.1]), np.array([1.0, 0.0, 0.0])
    places = np.cumsum(radii * 2.0) - radii
    row = [
        ball(f"b{k}", radii[k], [places[k], 0.0, 0.0], linear_velocity=[speeds[k], 0.0, 0.0]) for k in range(3)
    ]
    scene = small_scene(LOSSLESS | {"restitution": restitution}, *row, gravity=0.0, time_step=0.0025, duration=0.0075)
    with Lockstep(scene, Settings(threads=1, lookahead=0.0025)) as run:
        for _ in run:
            pass
        states = run.simulation.dynamics.states()
    right, masses = speeds.copy(), radii**3
    for turn in range(10_000):
        i = turn % 2
        approach, both = right[i] - right[i + 1], masses[i] + masses[i + 1]
        if approach > 0.0:
            right[i] -= (1.0 + restitution) * approach * masses[i + 1] / both
            right[i + 1] += (1.0 + restitution) * approach * masses[i] / both
    np.testing.assert_allclose(states.linear[:, 0], right, atol=0.02)
    assert masses @ states.linear[:, 0] == pytest.approx(masses @ speeds, rel=1e-9)
    assert masses @ states.linear[:, 0] ** 2 <= masses @ speeds**2


@pytest.mark.parametrize("spin", [10.0, 100.0, 360.0])
def test_a_free_spin_keeps_its_angular_momentum_and_energy(spin: float) -> None:
    block = box("a", [0.1, 0.06, 0.03], angular_velocity=[0.6 * spin, 0.64 * spin, 0.48 * spin])
    run = course([block], 1.0)
    change = run.momenta[:, 0] - run.momenta[0, 0]
    assert np.linalg.norm(change, axis=1).max() < 1e-11 * np.linalg.norm(run.momenta[0, 0])
    assert np.ptp(run.energy) < 1e-11 * run.energy[0]


def test_free_flight_is_a_parabola() -> None:
    run = course([cube("a", 0.0, 0.0, 0.0, linear_velocity=[1.0, 0.0, 2.0])], 0.5, gravity=9.81)
    t = 0.0025 * np.arange(1, len(run.centers) + 1)
    np.testing.assert_allclose(run.centers[:, 0, 2], 2.0 * t - 0.5 * 9.81 * t * t, atol=1e-12)
    np.testing.assert_allclose(run.centers[:, 0, 0], t, atol=1e-12)

"""The contact solver in whole runs with closed-form contacts."""

from __future__ import annotations

import numpy as np
import pytest
from truth.simulation_oracle import Oracle

from fracture_collision.simulation.scene.scene import parse_scene
from fracture_collision.simulation.simulation import Simulation

GRAVITY = 9.81


def make_scene(*bodies, **changes):
    stone = {"density": 2400.0, "friction": 0.5, "restitution": 0.0, "rolling_arm": 0.0}
    stone.update(changes.pop("stone", {}))
    content = {
        "seed": 1, "gravity": [0.0, 0.0, -GRAVITY], "time_step": 1.0 / 240.0, "duration": 2.0,
        "materials": {"stone": stone},
        "bodies": [
            {"name": "ground", "material": "stone", "static": True,
             "shape": {"plane": {"coefficients": changes.pop("ground", [0.0, 0.0, 1.0, 0.0])}}},
            *({"material": "stone", **body} for body in bodies),
        ],
    }  # fmt: skip
    return parse_scene({**content, **changes}, "test")


# Solved exactly, (1)-(3) never gain energy: dE <= -|du|^2_M / 2. Gauss-Seidel stops before the exact solution; the
# remainder is this share of the energy, with potential energy measured from the ground.
ENERGY_GAIN = 2e-5


def run(scene, energy_gain=ENERGY_GAIN):
    """Reports of all steps, and the last states; no step may gain energy."""
    simulation = Simulation(scene)
    oracle = Oracle(simulation.start_bodies())
    reports = []
    energy = None
    try:
        while not simulation.finished:
            request = simulation.begin_step()
            report = simulation.finish_step(oracle.contacts(request.states), oracle.registry())
            total = report.kinetic_energy + report.potential_energy - report.drift_energy
            if energy is not None:
                assert total - energy < energy_gain * abs(energy)
            energy = report.kinetic_energy + report.potential_energy
            reports.append(report)
        states = movable(simulation.begin_step().states)
    finally:
        simulation.close()
    return reports, states


def movable(states):
    """The states without the ground, fragment 1."""
    rows = states.fragment_ids != 1
    names = ("positions", "orientations", "linear_velocities", "angular_velocities")
    columns = {name: getattr(states, name).reshape(len(rows), -1)[rows].ravel() for name in names}
    return states._replace(fragment_ids=states.fragment_ids[rows], **columns)


def box(name, size, position, **more):
    return {"name": name, "shape": {"box": {"size": size}}, "position": position, **more}


def ball(name, radius, position, **more):
    return {"name": name, "shape": {"sphere": {"radius": radius}}, "position": position, **more}


def test_a_box_falls_and_comes_to_rest():
    reports, states = run(make_scene(box("box", [0.2, 0.1, 0.05], [0.0, 0.0, 0.4], rotation=[20.0, 30.0, 0.0])))
    assert reports[-1].max_speed < 1e-6
    assert -2e-4 < reports[-1].deepest_gap <= 0.0
    assert reports[-1].potential_energy < reports[0].potential_energy


def test_a_stack_of_boxes_stands():
    boxes = [
        box(f"box {i}", [0.2, 0.2, 0.1], [0.004 * (i % 2), 0.0, 0.05 + 0.102 * i], rotation=[0, 0, 7.0 * i])
        for i in range(8)
    ]
    reports, states = run(make_scene(*boxes, duration=2.5))
    assert reports[-1].max_speed < 1e-4
    assert reports[-1].deepest_gap > -3e-4
    heights = states.positions.reshape(-1, 3)[:, 2]
    np.testing.assert_allclose(np.sort(heights), 0.05 + 0.1 * np.arange(8), atol=1.2e-3)


def test_light_boxes_support_a_heavy_one():
    """Seven times as heavy as each of the three under it: hard for Gauss-Seidel alone."""
    boxes = [box(f"box {i}", [0.1, 0.1, 0.05], [0.0, 0.0, 0.025 + 0.05 * i]) for i in range(3)]
    reports, states = run(make_scene(*boxes, box("weight", [0.15] * 3, [0.0, 0.0, 0.225]), duration=1.5))
    assert reports[-1].max_speed < 1e-3
    assert reports[-1].deepest_gap > -5e-4


def test_no_energy_is_gained_where_the_contacts_are_solved_to_the_end():
    boxes = [
        box(f"box {i}", [0.2, 0.15, 0.1], [0.02 * i, 0.0, 0.1 + 0.15 * i], rotation=[9.0 * i, 5.0, 0]) for i in range(4)
    ]
    reports, _ = run(make_scene(*boxes, duration=1.2, solver={"iterations": 1000, "accuracy": 0.0}), energy_gain=1e-9)
    assert reports[0].potential_energy - reports[-1].potential_energy > 5.0
    assert reports[-1].max_speed < 1e-6


@pytest.mark.parametrize(("degrees", "slides"), [(25.0, False), (28.0, True)])
def test_a_block_slides_beyond_the_angle_of_friction(degrees, slides):
    """Friction 0.5 holds up to atan 0.5 = 26.6 degrees; above, a block slides with g (sin - mu cos)."""
    slope = np.radians(degrees)
    normal = [-np.sin(slope), 0.0, np.cos(slope)]
    position = 0.0251 * np.array(normal)
    block = box("block", [0.2, 0.2, 0.05], position.tolist(), rotation=[0.0, -degrees, 0.0])
    reports, states = run(make_scene(block, ground=[*normal, 0.0], duration=1.0))
    expected = GRAVITY * (np.sin(slope) - 0.5 * np.cos(slope)) * 1.0 if slides else 0.0
    assert reports[-1].max_speed == pytest.approx(expected, abs=5e-3)


def test_friction_is_a_cone():
    """A block sliding along the diagonal of the tangents slows down by mu g, no more, and keeps its direction."""
    velocity = np.array([1.0, 1.0, 0.0])
    block = box("block", [0.2, 0.2, 0.02], [0.0, 0.0, 0.01], linear_velocity=velocity.tolist())
    reports, states = run(make_scene(block, duration=0.2))
    expected = velocity * (1.0 - 0.5 * GRAVITY * 0.2 / np.sqrt(2.0))
    expected[2] = -GRAVITY / 240.0  # of the coming step, before contacts
    np.testing.assert_allclose(states.linear_velocities, expected, atol=0.03)


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
    assert states.linear_velocities[0] == pytest.approx(5.0 / 7.0, rel=5e-3)
    assert states.angular_velocities[1] == pytest.approx(states.linear_velocities[0] / 0.05, rel=5e-3)


def test_rolling_resistance_stops_a_ball():
    """Rolling, a sphere of radius r decelerates by 5/7 g rho / r."""
    arm = 2e-3
    scene = make_scene(
        ball("ball", 0.05, [0.0, 0.0, 0.05], linear_velocity=[0.5, 0.0, 0.0], angular_velocity=[0.0, 10.0, 0.0]),
        stone={"rolling_arm": arm}, duration=1.0,
    )  # fmt: skip
    reports, states = run(scene)
    assert states.linear_velocities[0] == pytest.approx(0.5 - 5.0 / 7.0 * GRAVITY * arm / 0.05, abs=0.01)
    reports, states = run(scene._replace(duration=3.0))
    assert reports[-1].max_speed < 1e-9


def test_a_fast_ball_stops_at_the_surface_it_has_not_reached():
    """A gap may close within the step to the rest gap and no further: the ball neither penetrates nor hovers."""
    scene = make_scene(
        ball("ball", 0.05, [0.0, 0.0, 0.0515], linear_velocity=[0.0, 0.0, -8.0]), duration=0.05
    )
    reports, states = run(scene)
    assert min(report.deepest_gap for report in reports) > -1e-6
    assert states.positions[2] == pytest.approx(0.05 + 0.05 * scene.solver.rest_gap, abs=1e-6)


def test_a_collision_keeps_momentum():
    """Two balls collide off centre with friction in free space: linear and angular momentum to rounding."""
    pair = [
        ball("one", 0.05, [0.0, 0.0, 1.0], linear_velocity=[3.0, 0.0, 0.0], angular_velocity=[5.0, 40.0, -9.0]),
        ball("two", 0.03, [0.1, 0.03, 1.02], linear_velocity=[-1.0, 0.0, 0.0]),
    ]
    scene = make_scene(*pair, gravity=[0.0, 0.0, 0.0], duration=0.05, stone={"restitution": 0.4})
    reports, states = run(scene)
    assert max(report.contacts for report in reports) == 1
    mass = 2400.0 * 4.0 / 3.0 * np.pi * np.array([0.05, 0.03]) ** 3
    spin = 0.4 * mass * np.array([0.05, 0.03]) ** 2

    def momenta(x, v, w):
        return np.concatenate((mass @ v, (mass[:, None] * np.cross(x, v) + spin[:, None] * w).sum(axis=0)))

    keys = ("position", "linear_velocity", "angular_velocity")
    start = [np.array([body.get(key, [0.0] * 3) for body in pair]) for key in keys]
    end = [a.reshape(-1, 3) for a in (states.positions, states.linear_velocities, states.angular_velocities)]
    assert np.abs(end[1][1] - start[1][1]).max() > 0.1
    np.testing.assert_allclose(momenta(*end), momenta(*start), atol=1e-12)


def test_equal_runs_give_equal_bytes():
    boxes = [
        box(f"box {i}", [0.2, 0.15, 0.1], [0.02 * i, 0.0, 0.1 + 0.15 * i], rotation=[9.0 * i, 5.0, 0]) for i in range(4)
    ]
    first, second = (run(make_scene(*boxes, duration=0.6))[1] for _ in range(2))
    for x, y in zip(first, second, strict=True):
        assert np.asarray(x).tobytes() == np.asarray(y).tobytes()


def test_bodies_that_do_not_touch_do_not_affect_each_other():
    """Islands are solved separately: tumbling boxes move byte for byte the same with and without a rolling ball."""
    boxes = [
        box(f"box {i}", [0.2, 0.15, 0.1], [0.02 * i, 0.0, 0.1 + 0.15 * i], rotation=[9.0 * i, 5.0, 0]) for i in range(4)
    ]
    alone = run(make_scene(*boxes, duration=0.6))[1]
    other = ball("ball", 0.05, [3.0, 0.0, 0.05], linear_velocity=[1.0, 0.0, 0.0])
    beside = run(make_scene(*boxes, other, duration=0.6))[1]
    assert len(beside.fragment_ids) == len(boxes) + 1
    assert beside.linear_velocities[-3] > 0.5
    assert beside.positions[:-3].tobytes() == alone.positions.tobytes()
    assert beside.orientations[:-4].tobytes() == alone.orientations.tobytes()


def test_answers_to_another_step_are_rejected():
    simulation = Simulation(make_scene(ball("ball", 0.05, [0.0, 0.0, 1.0])))
    oracle = Oracle(simulation.start_bodies())
    request = simulation.begin_step()
    answer = oracle.contacts(request.states)
    with pytest.raises(ValueError, match="needs the answer to"):
        simulation.finish_step(answer._replace(step=3), oracle.registry())
    again = simulation.begin_step()
    assert again.states.step == request.states.step
    simulation.finish_step(answer, oracle.registry())
    simulation.close()

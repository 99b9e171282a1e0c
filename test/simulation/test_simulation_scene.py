"""Scene files: errors for invalid scenes, and a hand that drags bodies along a track."""

from __future__ import annotations

import copy

import numpy as np
import pytest
from worlds.small_scenes import ball, brick, small_scene

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.actors.hand import HandSettings, HeldBody, kick
from fracture_collision.simulation.scene.scene import SceneError, load_scene, parse_scene
from fracture_collision.simulation.simulation import Simulation
from fracture_collision.world import Settings

VALID = {
    "seed": 1, "gravity": [0.0, 0.0, -9.81], "time_step": 0.01, "duration": 1.0,
    "materials": {"stone": {"density": 2000.0, "friction": 0.5, "fracture": {"strength": 1.0, "minimum_mass": 0.1}}},
    "bodies": [
        {"name": "ground", "material": "stone", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}},
        {"name": "brick", "material": "stone", "shape": {"brick": {"size_xyz": [0.2, 0.1, 0.1], "edge_length": 0.05}}},
    ],
}  # fmt: skip


def test_start_bodies_are_returned_on_every_call_and_announced_once():
    simulation = Simulation(parse_scene(VALID, "said"))
    first, again = simulation.start_bodies(), simulation.start_bodies()
    assert [body.name for body in first] == [body.name for body in again] == ["ground", "brick"]
    assert simulation.begin_step().bodies == []
    simulation.close()


DELETE = object()


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("time_step",), 0.0, "time_step: needs more than 0"),
        (("time_step",), "soon", "time_step: needs a finite number, got 'soon'"),
        (("gravity",), [0.0, 1.0], "gravity: needs 3 numbers"),
        (("gravity",), [0.0, 1.0, float("nan")], "gravity.2: needs a finite number"),
        (("seed",), -1, "seed: needs a whole number"),
        (("duration",), DELETE, "duration: missing"),
        (("wind",), 3, "wind: unknown field"),
        (("solver",), {"sweeps": 3}, "solver.sweeps: unknown field"),
        (("materials", "stone", "friction"), -0.5, "materials.stone.friction: needs at least 0"),
        (("materials", "stone", "restitution"), 1.5, "materials.stone.restitution: needs at most 1"),
        (("materials", "stone", "fracture", "strength"), DELETE, "materials.stone.fracture.strength: missing"),
        (("materials", "stone", "fracture", "pattern"), {"seed": 2}, "materials.stone.fracture.pattern.seed: unknown"),
        (("bodies",), [], "bodies: needs a list"),
        (("bodies", 0, "static"), False, r"bodies\[0\].static: a plane cannot move"),
        (("bodies", 0, "static"), "yes", r"bodies\[0\].static: needs true or false"),
        (("bodies", 0, "shape", "plane", "coefficients"), [0, 0, 2, 0], r"plane.coefficients: the normal"),
        (("bodies", 1, "material"), "glass", r"bodies\[1\].material: 'glass' is none of stone"),
        (("bodies", 1, "name"), "ground", "bodies: the name 'ground' occurs 2 times"),
        (("bodies", 1, "shape"), {"pyramid": {}}, r"bodies\[1\].shape: needs just one of"),
        (("bodies", 1, "shape"), {"sphere": {"radius": 0}}, r"bodies\[1\].shape.sphere.radius: needs more than 0"),
        (("bodies", 1, "shape", "brick", "edge_length"), -1.0, r"bodies\[1\].shape.brick.edge_length"),
        (("bodies", 1, "shape", "brick", "edge_length"), "x", r"bodies\[1\].shape.brick"),
        (("bodies", 1, "shape", "brick", "size"), 3, r"bodies\[1\].shape.brick.size: unknown field"),
    ],
)  # fmt: skip
def test_errors_name_the_field(path, value, words):
    content = copy.deepcopy(VALID)
    place = content
    for key in path[:-1]:
        place = place[key]
    if value is DELETE:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    with pytest.raises(SceneError, match=words):
        parse_scene(content, "broken")


def test_a_file_that_is_not_yaml(tmp_path):
    path = tmp_path / "broken.yaml"
    path.write_text("bodies: [", encoding="utf-8")
    with pytest.raises(SceneError, match="not YAML"):
        load_scene(path)
    path.write_text("- 1", encoding="utf-8")
    with pytest.raises(SceneError, match="scene: needs fields"):
        load_scene(path)


BODIES = (brick("brick", [0.2, 0.1, 0.1], 0.05, [0.0, 0.0, 0.5]), ball("ball", 0.05, [1.0, 0.0, 0.5]))
CLAY = {"density": 1000.0, "friction": 0.5, "fracture": {"strength": 100.0, "minimum_mass": 0.01}}


def scene(track, duration=1.0, gravity=0.0, **hand):
    return small_scene(
        CLAY, *BODIES, gravity=gravity, time_step=0.005, duration=duration, hand={"track": track, **hand}
    )


def settled(what):
    with Lockstep(what, Settings(threads=1)) as run:
        reports = [exchange.report for exchange in run]
        states = run.states()
    return reports, states.positions.reshape(-1, 3), states


@pytest.mark.parametrize("gravity", [0.0, 9.81])
def test_a_held_body_follows_the_hand_and_hangs_below_it(gravity):
    lifted = [0.0, 0.0, 0.9]
    track = [[0.0, 1.0, 0.0, 0.5, "ball"], [0.5, *lifted, "ball"], [3.0, *lifted, "ball"]]
    reports, positions, _ = settled(scene(track, 2.99, gravity))
    # a spring of frequency f sags by g / (2 pi f)^2
    expected = np.array(lifted) - [0.0, 0.0, gravity / (2.0 * np.pi * HandSettings().frequency) ** 2]
    assert positions[1] == pytest.approx(expected, abs=1e-4)
    work = sum(report.hand_energy for report in reports)
    mass = 1000.0 * 4.0 / 3.0 * np.pi * 0.05**3
    assert reports[-1].max_speed == pytest.approx(gravity * reports[-1].time, rel=1e-6)  # the brick, falling free
    # velocities are updated before positions: per step, gravity adds m (g h)^2 / 2 beyond the change in height
    lifting = mass * gravity * (expected[2] - 0.5) + len(reports) * 0.5 * mass * (gravity * 0.005) ** 2
    assert work == pytest.approx(lifting, rel=1e-3, abs=1e-6)


def test_energy_rises_by_the_work_of_the_hand():
    track = [[0.0, 0.0, 0.0, 0.55, "brick"], [0.3, 0.3, 0.2, 0.9, "brick"], [1.0, -0.2, 0.0, 0.5, ""]]
    reports, _, _ = settled(scene(track))
    energy = np.cumsum([report.hand_energy for report in reports])
    assert [report.kinetic_energy for report in reports] == pytest.approx(energy, rel=1e-6, abs=1e-9)
    assert energy[-1] > 0.1


def test_an_open_hand_does_nothing_and_takes_a_late_body_on_arrival():
    reports, _, _ = settled(scene([[0.0, 0.0, 0.0, 0.5, ""], [1.0, 1.0, 0.0, 0.5, ""]], 0.2))
    assert all(report.hand_energy == 0.0 and report.kinetic_energy == 0.0 for report in reports)
    what = scene([[0.0, 1.0, 0.0, 0.6, "ball"], [9.0, 1.0, 0.0, 0.6, "ball"]], 0.4)
    late = what._replace(bodies=(what.bodies[0], what.bodies[1]._replace(start_time=0.2)))
    reports, _, _ = settled(late)
    pulled = [report.hand_energy != 0.0 for report in reports]
    assert not any(pulled[:40]) and all(pulled[41:60])


def test_the_hand_pulls_no_harder_than_its_limit():
    inertia, center = np.diag([0.1, 0.2, 0.3]), np.zeros(3)
    far, still = np.array([0.0, 10.0, 0.0]), np.zeros(3)
    for limit in (1.0, 50.0):
        body = HeldBody(2.0, inertia, center, np.zeros(6), center)
        change = kick(HandSettings(force_limit=limit), body, far, still, 0.01)
        assert change == pytest.approx([0.0, limit * 0.01 / 2.0, 0.0, 0.0, 0.0, 0.0])


def test_the_impulse_obeys_the_implicit_spring():
    rng = np.random.default_rng(3)
    settings, mass, h = HandSettings(5.0, 0.7, 1e9), 1.7, 0.004
    inertia = np.diag([0.01, 0.02, 0.015])
    center, point, hand, velocity, hand_velocity = rng.normal(size=(5, 3)) * 0.3
    before = np.concatenate((velocity, rng.normal(size=3)))
    change = kick(settings, HeldBody(mass, inertia, center, before, point), hand, hand_velocity, h)
    after = before + change
    at_point = after[:3] + np.cross(after[3:], point - center)
    swing = 2.0 * np.pi * settings.frequency
    spring = mass * swing**2 * (point + h * at_point - hand)
    damper = 2.0 * settings.damping_ratio * mass * swing * (at_point - hand_velocity)
    assert mass * change[:3] == pytest.approx(-h * (spring + damper))
    assert inertia @ change[3:] == pytest.approx(np.cross(point - center, mass * change[:3]))


def test_a_commanded_hand_takes_moves_and_releases_the_nearest_piece():
    what = scene([[0.0, 0.0, 0.0, 0.0, ""], [1.0, 0.0, 0.0, 0.0, ""]])._replace(hand=None)
    with Lockstep(what, Settings(threads=1)) as run:
        assert not run.simulation.grab("brick", np.zeros(3))  # not in motion yet
        run.step()
        assert run.simulation.strike(1, np.zeros(3), 2.0)
        run.step()
        run.step()
        assert run.simulation.grab("brick", np.array([0.1, 0.0, 0.5]))
        held = run.simulation.drag.held
        run.simulation.drag.move(np.array([0.3, 0.0, 0.5]), np.zeros(3))
        before = run.states()
        for _ in range(80):
            run.step()
        after = run.states()
        row = np.flatnonzero(before.fragment_ids == held)[0]
        moved = (after.positions - before.positions).reshape(-1, 3)
        assert moved[row, 0] > 0.1
        run.simulation.drag.release()
        assert run.simulation.drag.held is None
        assert run.step().report.hand_energy == 0.0
        with pytest.raises(KeyError):
            run.simulation.grab("nobody", np.zeros(3))


@pytest.mark.parametrize(
    ("track", "words"),
    [
        (3, "hand.track: needs the name of a CSV file"),
        ("no_such.csv", "hand.track: .*no_such.csv"),
        ([[0.0, 0.0, 0.0, 0.0, ""]], "hand.track: needs at least two rows"),
        ([[0.0, 0.0, 0.0, 0.0, ""], [0.0, 0.0, 0.0, 0.0, ""]], r"hand.track\[1\]: time 0.0 s does not follow"),
        ([[0.0, 0.0, 0.0, 0.0, "cat"], [1.0, 0.0, 0.0, 0.0, ""]], r"hand.track\[0\]: no body 'cat'"),
        ([[0.0, 0.0, 0.0, 0.0, ""], [1.0, 0.0, float("nan"), 0.0, ""]], r"hand.track\[1\]: needs finite"),
        ([[0.0, 0.0, 0.0, ""], [1.0, 0.0, 0.0, ""]], r"hand.track\[0\]: needs time, x, y, z, holds"),
    ],
)
def test_errors_name_the_row(track, words):
    with pytest.raises(SceneError, match=words):
        scene(track)


def test_a_track_file_is_read_from_the_folder_of_the_scene(tmp_path):
    hand = load_scene("bunnies").hand
    assert len(hand.track.times) > 100 and set(hand.track.holds) == {"", "bunny 1", "bunny 2", "bunny 4", "bunny 5"}
    content = VALID | {"bodies": [{**BODIES[1], "material": "stone"}], "hand": {"track": "hand.csv"}}
    file = tmp_path / "hand.csv"
    file.write_text("# a hand\ntime,x,y,z,holds\n0,0,0,0,ball\n1,1,0,0,\n")
    track = parse_scene(content, "drag", folder=tmp_path).hand.track
    assert track.holds == ("ball", "")
    position, velocity, name = track.at(0.25)
    assert (position.tolist(), velocity.tolist(), name) == ([0.25, 0.0, 0.0], [1.0, 0.0, 0.0], "ball")
    assert track.at(1.0)[2] == "" and track.at(5.0)[0].tolist() == [1.0, 0.0, 0.0]
    file.write_text("x,y\n1,2\n")
    with pytest.raises(SceneError, match="does not begin with the columns time,x,y,z,holds"):
        parse_scene(content, "drag", folder=tmp_path)

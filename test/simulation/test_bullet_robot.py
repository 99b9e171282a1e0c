"""Robots in PyBullet: loads, saturating motors, impacts, bytes, and robots that break things.

config/robots/three_links.urdf in closed form: in its posture at angles 0 the boom and the hand lie along x, with the
joints `lift` and `tilt` at x = 0 and 0.42 m.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from worlds.small_scenes import GROUND, ball, brick, small_scene

from fracture_collision import extras
from fracture_collision.lockstep import Lockstep
from fracture_collision.share import share_directory
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.rotations import turned_back
from fracture_collision.simulation.scene.scene import ENGINES, OWN, Scene, SceneError, load_scene
from fracture_collision.world import Settings

pytest.importorskip("pybullet")

ROBOTS = share_directory() / "config" / "robots"
THREE_LINKS, IIWA = str(ROBOTS / "three_links.urdf"), str(ROBOTS / "lbr_iiwa.urdf")
JOINTS, TORQUES = ("turn", "lift", "tilt"), (200.0, 200.0, 60.0)
GRAVITY = 9.81
# (mass [kg], x of its centre [m]) beyond each joint
BEYOND_LIFT, BEYOND_TILT = ((3.0, 0.2), (1.5, 0.5)), ((1.5, 0.08),)
# [kg m2] about the joint `turn`: post, boom and hand about their centres, and the masses at their distances
INERTIA = 0.0043 + 0.041 + 3.0 * 0.2**2 + 0.004 + 1.5 * 0.5**2
HAND_TOP = 0.47 + 0.025
BALL = ball("ball", 0.05, [0.5, 0.12, 0.47])


def motor(joint: str, torque: float, rows: Any = ((0.0, 0.0),), key: str = "position") -> dict[str, Any]:
    return {"joint": joint, "torque": torque, key: [list(row) for row in rows]}


def held(torques: tuple[float, ...] = TORQUES) -> list[dict[str, Any]]:
    return [motor(joint, torque) for joint, torque in zip(JOINTS, torques, strict=True)]


def scene(motors: list, bodies: list = (), material: dict | None = None, **fields: Any) -> Scene:  # type: ignore[assignment]
    clay = {"density": 2000.0, "friction": 0.6, **(material or {})}
    robot = {"urdf": fields.pop("urdf", THREE_LINKS), "material": "stone", "motors": motors, **fields.pop("robot", {})}
    return small_scene(clay, *(bodies or [GROUND]), robot=robot, **fields)


def load(density: float, torques: tuple[float, ...] = TORQUES) -> Scene:
    """A brick of 0.0012 m3 above the hand, its middle 0.5 m from `lift`."""
    load = brick("load", [0.2, 0.1, 0.06], 0.03, [0.5, 0.0, HAND_TOP + 0.0302])
    return scene(held(torques), [load], {"density": density})


def run_of(what: Scene, looks_ahead: bool = True, engine: str = OWN) -> Lockstep:
    return Lockstep(with_engine(what, engine), Settings(threads=1, lookahead=what.time_step if looks_ahead else 0.0))


def row_of(run: Lockstep, name: str) -> int:
    ids = run.simulation.dynamics.states().fragment_ids.tolist()
    return ids.index(1 + [body.name for body in run.simulation._scene.bodies].index(name))


def digest(run: Lockstep, steps: int) -> str:
    """Of everything that happens in so many steps."""
    found = hashlib.sha256()
    for _ in range(steps):
        exchange = run.step()
        robot = run.simulation.robot
        assert robot is not None
        joints = robot.joints()
        for values in (*exchange.states[2:], *exchange.contacts[5:], *joints[1:]):
            found.update(np.ascontiguousarray(values).tobytes())
    return found.hexdigest()


# --- loads -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("looks_ahead", [True, False], ids=["looking ahead", "not looking ahead"])
@pytest.mark.parametrize("engine", ENGINES)
def test_a_held_load_needs_the_torques_of_equilibrium(engine: str, looks_ahead: bool) -> None:
    mass = 9.6
    with run_of(load(mass / 0.0012), looks_ahead, engine) as run:
        for _ in range(120):
            report = run.step().report
        joints, states, i = run.simulation.robot.joints(), run.simulation.dynamics.states(), row_of(run, "load")
        assert states.masses[i] == pytest.approx(mass, rel=1e-9)
        x = float(states.centers[i, 0])
        lift = -GRAVITY * (sum(m * at for m, at in BEYOND_LIFT) + mass * x)
        tilt = -GRAVITY * (sum(m * at for m, at in BEYOND_TILT) + mass * (x - 0.42))
        np.testing.assert_allclose(joints.torques, [0.0, lift, tilt], rtol=1e-3, atol=1e-6)
        assert np.abs(states.linear[i]).max() < 1e-6 and report.deepest_gap > -1e-5


@pytest.mark.parametrize("engine", ENGINES)
def test_a_load_on_two_links_needs_the_torques_of_equilibrium(engine: str) -> None:
    """It lies on boom and hand, each of which learns of the other's contacts by the passes alone."""
    lying = brick("load", [0.36, 0.1, 0.06], 0.03, [0.4, 0.0, 0.47 + 0.03 + 0.0302])
    what = scene(held(), [lying], {"density": 3000.0})
    with run_of(what, engine=engine) as run:
        for _ in range(200):
            exchange = run.step()
        joints, states, i = run.simulation.robot.joints(), run.simulation.dynamics.states(), row_of(run, "load")
    contacts = exchange.contacts
    names = {what.bodies[b - 1].name for a, b in zip(contacts.fragment_a, contacts.fragment_b, strict=True) if a == 1}
    assert names == {"robot boom 2", "robot hand"}
    lift = -GRAVITY * (sum(m * at for m, at in BEYOND_LIFT) + states.masses[i] * states.centers[i, 0])
    assert joints.torques[1] == pytest.approx(lift, rel=1e-3)
    assert joints.torques[2] < -GRAVITY * 1.5 * 0.08 - 0.5, "the hand bears a part"
    assert np.abs(states.linear[i]).max() < 1e-6 and exchange.report.deepest_gap > -1e-5


def test_a_motor_gives_way_where_its_torque_does_not_suffice() -> None:
    """60.3 N m are needed: with 65 the load stays, with 60 it sinks, as its torque is what is missing."""
    with run_of(load(8000.0, (200.0, 65.0, 60.0))) as run:
        list(zip(range(200), run, strict=False))
        assert abs(run.simulation.robot.joints().angles[1]) < 1e-3
    with run_of(load(8000.0, (200.0, 60.0, 60.0))) as run:
        angles, torques = [], []
        for _ in range(200):
            run.step()
            joints = run.simulation.robot.joints()
            angles.append(joints.angles[1])
            torques.append(joints.torques[1])
        states, i = run.simulation.dynamics.states(), row_of(run, "load")
        assert np.abs(np.array(torques[3:]) + 60.0).max() < 1e-6
        assert np.diff(angles[3:]).min() > 0.0 and angles[-1] > 0.02, "down"
        assert states.centers[i, 2] < HAND_TOP + 0.03 - 0.5 * 0.02, "with its load"


def test_a_load_at_rest_is_lifted_when_the_motor_moves() -> None:
    """Long after it would have fallen asleep."""
    what = load(2000.0)
    lift, tilt = ([(0.6, 0.0), (0.9, angle)] for angle in (-20.0, 20.0))
    motors = [*held()[:1], motor("lift", 200.0, lift), motor("tilt", 60.0, tilt)]
    with run_of(what._replace(robot=scene(motors).robot)) as run:
        heights, reports = [], []
        for _ in range(440):
            reports.append(run.step().report)
            heights.append(float(run.simulation.dynamics.states().centers[row_of(run, "load"), 2]))
    assert np.ptp(heights[120:235]) < 1e-6
    assert heights[-1] - heights[235] == pytest.approx(0.42 * np.sin(np.radians(20.0)), abs=2e-3)
    energy = [report.kinetic_energy + report.potential_energy for report in reports]
    work = sum(report.hand_energy + report.drift_energy for report in reports[236:])
    # where the hand starts, and where the load lands on it, by m g h / 2 times the change of speed: 0.03 J
    assert work == pytest.approx(energy[-1] - energy[235], abs=0.04) and work > 3.0


# --- impacts ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("restitution", "looks_ahead"), [(0.0, True), (0.5, True), (0.5, False)])
@pytest.mark.parametrize("engine", ENGINES)
def test_an_impact_of_a_free_arm_keeps_angular_momentum(restitution: float, engine: str, looks_ahead: bool) -> None:
    """Motors off, no gravity: about the joint, the arm of closed form and the ball have as much as before."""
    clay = {"restitution": restitution, "friction": 0.0}
    what = scene(held((0.0, 0.0, 0.0)), [BALL], clay, gravity=0.0)
    speed, blow = 2.0, 0.0  # blow: speed of the ball right after it
    turn = 0.03982  # [rad] at which the hand's side, 0.05 m from its axis, touches the ball
    lever = 0.5 * np.cos(turn) + 0.12 * np.sin(turn)
    assert 0.12 * np.cos(turn) - 0.5 * np.sin(turn) == pytest.approx(0.05 + 0.05, abs=1e-4)
    with run_of(what, looks_ahead, engine) as run:
        run.simulation.robot.set_joints(np.zeros(3), np.array([speed, 0.0, 0.0]))
        for _ in range(40):
            report = run.step().report
            blow = blow or float(np.linalg.norm(run.simulation.dynamics.states().linear[row_of(run, "ball")]))
        joints, states, i = run.simulation.robot.joints(), run.simulation.dynamics.states(), row_of(run, "ball")
    mass = states.masses[i]
    momentum = mass * np.cross(states.centers[i], states.linear[i])[2]
    assert momentum > 0.2 * INERTIA * speed, "it was hit"
    assert INERTIA * joints.speeds[0] + momentum == pytest.approx(INERTIA * speed, rel=1e-3)
    # one point, without friction: the closed form of the blow
    reduced = 1.0 / (1.0 / mass + lever**2 / INERTIA)
    impulse = (1.0 + restitution) * reduced * speed * lever
    assert blow == pytest.approx(impulse / mass, rel=1e-3)
    np.testing.assert_allclose(joints.speeds[1:], 0.0, atol=1e-9)
    assert report.deepest_gap == 0.0


def test_a_blow_of_a_fast_arm_does_not_go_deep() -> None:
    """The hand moves 12 mm in a step; looking ahead, it stops at the surface."""
    deepest = {}
    for looks_ahead in (True, False):
        what = scene(held((0.0, 0.0, 0.0)), [BALL], gravity=0.0)
        with run_of(what, looks_ahead) as run:
            run.simulation.robot.set_joints(np.zeros(3), np.array([9.7, 0.0, 0.0]))
            deepest[looks_ahead] = min(run.step().report.deepest_gap for _ in range(30))
    assert deepest[True] > -1e-4 and deepest[False] < -3e-3


# --- motors, shapes --------------------------------------------------------------------------------------------------


def test_motors_follow_their_tables() -> None:
    turn = motor("turn", 200.0, [(0.1, 0.0), (0.5, 60.0)], "velocity")
    lift = motor("lift", 200.0, [(0.1, 0.0), (0.3, -30.0)])
    with run_of(scene([turn, lift, motor("tilt", 60.0)])) as run:
        for _ in range(120):  # until 0.3 s
            run.step()
        joints = run.simulation.robot.joints()
        assert joints.names == JOINTS
        np.testing.assert_allclose(np.degrees(joints.speeds[0]), 60.0 * (0.3 - 0.0025 - 0.1) / 0.4, rtol=1e-6)
        assert np.degrees(joints.angles[1]) == pytest.approx(-30.0, abs=0.05)
        for _ in range(120):
            run.step()
        np.testing.assert_allclose(np.degrees(run.simulation.robot.joints().speeds[0]), 60.0, rtol=1e-6)


def test_a_joint_stops_at_its_limit() -> None:
    """At 3 rad, where the motor would go on."""
    with run_of(scene([motor("turn", 50.0, [(0.0, 400.0)], "velocity"), *held()[1:]])) as run:
        for _ in range(240):
            run.step()
        joints = run.simulation.robot.joints()
    assert joints.angles[0] == pytest.approx(3.0, abs=0.01) and abs(joints.speeds[0]) < 1e-3


@pytest.mark.parametrize("urdf", ["kuka_iiwa/model.urdf", IIWA], ids=["meshes", "primitives"])
def test_shapes_stand_where_bullet_has_the_links(urdf: str) -> None:
    motors = [motor(f"lbr_iiwa_joint_{j}", 100.0, [(0.0, 10.0 * j)]) for j in range(1, 8)]
    what = scene(motors, urdf=urdf, robot={"position": [0.3, -0.2, 0.1], "rotation": [10.0, 20.0, 30.0]})
    with run_of(what) as run:
        robot, frames = run.simulation.robot, run.simulation.robot.frames()
        bodies = [what.bodies[i - 1] for i in robot.fragment_ids.tolist()]
    assert len(set(robot.links.tolist())) == 7 and all(body.name.startswith("robot lbr_iiwa_link_") for body in bodies)
    np.testing.assert_allclose(frames.position, [body.position for body in bodies], atol=1e-6)
    turns = np.array([body.orientation for body in bodies])
    assert np.abs(np.abs((frames.orientation * turns).sum(axis=1)) - 1.0).max() < 1e-9
    assert [body.name for body in what.bodies if body.is_static] == ["ground", "robot lbr_iiwa_link_0"]


# --- bytes -----------------------------------------------------------------------------------------------------------


def struck() -> Scene:
    """An arm under power strikes a standing brick, which breaks and falls."""
    fracture = {"strength": 0.5, "minimum_mass": 0.1, "pattern": {"seeds": 6, "minimum_nodes": 6}}
    standing = brick("brick", [0.1, 0.1, 0.56], 0.05, [0.5, 0.0, 0.2801])
    motors = [motor("turn", 200.0, [(0.0, -30.0), (0.3, 30.0)]), *held()[1:]]
    return scene(motors, [GROUND, standing], {"fracture": fracture})


def test_equal_runs_and_copies_have_equal_bytes() -> None:
    steps, rest = 30, 90
    with run_of(struck()) as first:
        begun = digest(first, steps)
        assert first.step().registry.fracture_sequence == 0, "nothing has broken that the service of the copy lacks"
        copied = copy.deepcopy(first.simulation)
        ended = digest(first, rest)
        assert len(first.simulation.dynamics.states().masses) > 4 + 3, "it broke"
    with run_of(struck()) as second:
        assert digest(second, steps) == begun
        second.step()
        assert digest(second, rest) == ended
    with run_of(struck()) as third:
        third.simulation.close()
        third.simulation = copied
        assert digest(third, rest) == ended


@pytest.mark.parametrize("engine", ENGINES)
def test_the_robot_does_not_enter_shards_that_wait_for_each_other(engine: str) -> None:
    """Its tool moves 8 mm in a step, through a crowd of shards, which gain no energy but by it."""
    what = load_scene("vase")._replace(duration=1.2)
    with run_of(what, engine=engine) as run:
        reports = [exchange.report for exchange in run]
    assert reports[-1].fragments > reports[0].fragments + 15
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    given = np.array([report.drift_energy + report.hand_energy for report in reports])
    assert (np.diff(energy) - given[1:]).max() < 1e-3 * given.max()
    assert min(report.deepest_gap for report in reports) > -0.006


@pytest.mark.slow
def test_a_waiter_carries_a_vase_until_it_tips_it_off() -> None:
    what = load_scene("waiter")
    hand = 1 + [body.name for body in what.bodies].index("robot hand")
    places = []
    with run_of(what) as run:
        for exchange in run:
            states = run.simulation.dynamics.states()
            if exchange.report.time <= 2.0:
                at = states.frame_orientations[states.fragment_ids.tolist().index(hand)]
                arm = states.centers[row_of(run, "vase")] - states.centers[states.fragment_ids.tolist().index(hand)]
                places.append(turned_back(at, arm))
                assert not exchange.report.events
    assert np.ptp(places[20:], axis=0).max() < 1e-3, "it does not slip"
    assert exchange.report.fragments > 4 + 4, "it broke"


# --- scene files -----------------------------------------------------------------------------------------------------


def robots() -> Iterator[tuple[dict[str, Any], str]]:
    turn = motor("turn", 1.0)
    yield {"motors": []}, "robot.motors: needs a list"
    yield {"motors": [motor("elbow", 1.0)]}, r"robot.motors\[0\].joint: no joint 'elbow'; there are turn, lift, tilt"
    yield {"motors": [turn, turn]}, r"robot.motors\[1\].joint: 'turn' has a motor already"
    yield {"motors": [{"joint": "turn", "torque": 1.0}]}, r"robot.motors\[0\]: needs position or velocity, got neither"
    yield {"motors": [{**turn, "velocity": [[0, 0]]}]}, "needs position or velocity, got position and velocity"
    yield {"motors": [{**turn, "torque": -1.0}]}, r"robot.motors\[0\].torque: needs at least 0"
    yield {"motors": [motor("turn", 1.0, [(0.0, 0.0), (0.0, 1.0)])]}, r"robot.motors\[0\].position\[1\]: time 0.0 s"
    yield {"motors": [{**turn, "gain": 1.0}]}, r"robot.motors\[0\].gain: unknown field"
    yield {"urdf": "nowhere.urdf"}, "robot.urdf: nowhere.urdf: no such file, neither in"
    yield {"material": "butter"}, "robot.material: 'butter' is none of stone"
    yield {"colour": "orange"}, "robot.colour: unknown field"


@pytest.mark.parametrize(("robot", "words"), list(robots()))
def test_invalid_robots_are_rejected_with_an_explanation(robot: dict[str, Any], words: str) -> None:
    motors = robot.pop("motors", held())
    with pytest.raises(SceneError, match=words):
        scene(motors, robot=robot)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("<robot", "<robot <"), "not well-formed"),
        (('parent link="foot"', 'parent link="hand"'), "its joints form a loop"),
        (('type="revolute"', 'type="planar"'), "joint turn: its type 'planar' is none of revolute"),
        (('size="0.16 0.1 0.05"', 'size="0.16 0.1"'), "size: needs 3 finite numbers, got '0.16 0.1'"),
        (('radius="0.045"', 'radius="0"'), "cylinder radius: needs more than 0"),
        (('<box size="0.16 0.1 0.05"/>', '<mesh filename="none.stl"/>'), "mesh 'none.stl': no such file beside"),
    ],
)
def test_invalid_urdf_files_are_rejected_with_an_explanation(tmp_path, change: tuple[str, str], words: str) -> None:
    file = tmp_path / "robot.urdf"
    file.write_text((ROBOTS / "three_links.urdf").read_text().replace(*change))
    with pytest.raises(SceneError, match=f"robot.urdf: .*{words}"):
        scene(held(), urdf=str(file))


def test_without_pybullet_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    with pytest.raises(extras.MissingExtra, match=r"a robot of pybullet_data needs pybullet: .*\[bullet\]"):
        scene(held(), urdf="kuka_iiwa/model.urdf")

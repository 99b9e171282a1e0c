"""The engine MuJoCo: closed forms, scenes, and a model with actuators that feels what it holds."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from worlds.small_scenes import GROUND, ball, box, brick, small_scene

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene, parse_scene
from fracture_collision.world import Settings

mujoco = pytest.importorskip("mujoco", reason="no wheels for Python 3.10")

GRAVITY, STEP = 9.81, 0.0025
STONE = {"density": 2000.0, "friction": 0.5}


def run_of(scene: Scene) -> Lockstep:
    return Lockstep(with_engine(scene, "mujoco"), Settings(threads=1, lookahead=scene.time_step))


def on_a_slope(degrees: float) -> Scene:
    """A brick on a plane, both turned about an axis that is none of the contact's tangents."""
    tangent = np.radians(degrees)
    normal = [np.sin(tangent) * 0.6, np.sin(tangent) * 0.8, np.cos(tangent)]
    plane = {"name": "slope", "static": True, "shape": {"plane": {"coefficients": [*normal, 0.0]}}}
    resting = box("box", [0.2, 0.2, 0.1], [0.0501 * x for x in normal], rotation=rotation_to(normal))
    return small_scene(STONE, plane, resting)


def rotation_to(normal: list[float]) -> list[float]:
    """Angles [degrees] about the fixed x, y and z axes that turn the z axis to `normal`."""
    x, y, z = normal
    return [float(np.degrees(-np.arcsin(y))), float(np.degrees(np.arctan2(x, z))), 0.0]


def test_a_box_stays_on_a_slope_just_below_the_cone() -> None:
    with run_of(on_a_slope(26.0)) as run:
        for _ in range(100):
            run.step()
        before = run.simulation.dynamics.states().centers.copy()
        for _ in run:
            pass
        after = run.simulation.dynamics.states()
    assert np.abs(after.centers - before).max() < 1e-6


def test_a_box_slides_down_a_slope_by_coulomb_and_stays_on_it() -> None:
    """MuJoCo's own friction lifts it off by 46 mm."""
    angle = np.radians(40.0)
    normal = np.array([np.sin(angle) * 0.6, np.sin(angle) * 0.8, np.cos(angle)])
    heights, without = [], 0
    with run_of(on_a_slope(40.0)) as run:
        for exchange in run:
            states = run.simulation.dynamics.states()
            heights.append(float(states.centers[0] @ normal))
            without += not len(exchange.contacts.gaps)
        speed = float(np.linalg.norm(states.linear[0]))
    assert without == 0
    assert speed == pytest.approx(GRAVITY * (np.sin(angle) - 0.5 * np.cos(angle)), rel=2e-3)
    assert np.ptp(heights[100:]) < 5e-5


@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.8])
def test_a_ball_bounces_as_its_material_says(restitution: float) -> None:
    fallen = ball("ball", 0.05, [0.0, 0.0, 0.4], linear_velocity=[0.0, 0.0, -3.0])
    scene = small_scene(STONE | {"restitution": restitution}, GROUND, fallen, duration=0.25)
    with run_of(scene) as run:
        before = after = 0.0
        for _ in run:
            speed = float(run.simulation.dynamics.states().linear[0, 2])
            before, after = min(before, speed), max(after, speed)
    assert after == pytest.approx(-restitution * before, abs=0.02)


def test_a_stack_rests() -> None:
    boxes = [box(f"box {k}", [0.1, 0.1, 0.1], [0.0, 0.0, 0.05 + 0.1001 * k]) for k in range(10)]
    with run_of(small_scene(STONE, GROUND, *boxes, duration=2.0)) as run:
        deepest = [exchange.contacts.gaps.min(initial=0.0) for exchange in run][-1]
        states = run.simulation.dynamics.states()
    assert np.abs(states.linear).max() < 1e-5
    assert np.abs(states.centers[:, :2]).max() < 1e-5
    assert deepest > -0.002 * 0.05


def test_free_flight_is_a_parabola_and_keeps_energy() -> None:
    thrown = box("box", [0.3, 0.2, 0.1], [0.0, 0.0, 5.0], linear_velocity=[1.0, 0.0, 3.0],
                 angular_velocity=[1.0, 30.0, 2.0])  # fmt: skip
    with run_of(small_scene(STONE, thrown, duration=0.5)) as run:
        reports = [exchange.report for exchange in run]
        center = run.simulation.dynamics.states().centers[0]
    t = len(reports) * STEP
    assert center[2] == pytest.approx(5.0 + 3.0 * t - 0.5 * GRAVITY * t * t, abs=1e-11)
    energies = [report.kinetic_energy + report.potential_energy for report in reports]
    assert np.ptp(energies) < 1e-4 * abs(energies[0])


def test_a_pane_breaks_and_gains_no_energy() -> None:
    with run_of(load_scene("pane")) as run:
        reports = [exchange.report for exchange in run]
    assert reports[-1].fragments > reports[0].fragments
    gains = [
        after.kinetic_energy + after.potential_energy - before.kinetic_energy - before.potential_energy
        for before, after in pairwise(reports)
        if after.fragments == before.fragments and not after.events
    ]
    assert max(gains) < 1e-6 * 22.0


def test_processes_have_equal_bytes(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("fracture-collision")
    command = [program, "scene", "pane", "--engine", "mujoco", "--no-pictures"]
    reports = []
    for name in ("one", "other"):
        subprocess.run([*command, "--steps", "60", "--out", str(tmp_path / name)], check=True, capture_output=True)
        reports.append(json.loads((tmp_path / name / "report.json").read_text()))
    one, other = reports
    assert one["engine"] == "mujoco" and one["digest"] == other["digest"]


def test_a_bounce_beside_a_blow_that_breaks_is_as_fast_as_asked() -> None:
    """A ball strikes a brick, which passes on what it bears to a stone, just as another meets this from beside."""
    toward = np.array([0.5, -np.sqrt(0.75), 0.0])  # from the other to the stone
    row = [
        ball("striker", 0.1, [-0.2001, 0.0, 0.0], linear_velocity=[10.0, 0.0, 0.0]),
        brick("weak", [0.2, 0.2, 0.2], 0.1, material="weak"),
        ball("stone", 0.1, [0.2001, 0.0, 0.0]),
        ball("other", 0.03, list(np.array([0.2001, 0.0, 0.0]) - 0.1301 * toward), linear_velocity=list(2.0 * toward)),
    ]
    stone = STONE | {"restitution": 0.5, "friction": 0.0}
    weak = {"weak": stone | {"fracture": {"strength": 4.0, "minimum_mass": 1.0, "pattern": {"seeds": 4}}}}
    scene = small_scene(stone, *row, gravity=0.0, duration=0.02, materials=weak)
    with run_of(scene) as run:
        report = run.step().report
        states = run.simulation.dynamics.states()
    stone_id, other_id = 3, 4
    by_id = dict(zip(states.fragment_ids.tolist(), states.linear, strict=True))
    assert report.events  # the brick breaks
    assert np.linalg.norm(by_id[stone_id]) > 0.1  # what the brick passed on
    assert (by_id[stone_id] - by_id[other_id]) @ toward == pytest.approx(0.5 * 2.0, rel=1e-3)


def test_a_copy_goes_on_as_the_original() -> None:
    with run_of(load_scene("pane")) as run:
        for _ in range(30):
            run.step()
        dynamics = copy.deepcopy(run.simulation.dynamics)
        states = run.simulation.dynamics.states()
        assert dynamics.states().centers.tobytes() == states.centers.tobytes()
        assert dynamics._warm_start.impulses.tobytes() == run.simulation.dynamics._warm_start.impulses.tobytes()


ARM = """
<mujoco>
  <worldbody>
    <body name="upper" pos="0 0 0.5">
      <joint name="shoulder" type="hinge" axis="0 1 0" damping="0.1"/>
      <geom name="bone" type="box" size="0.18 0.03 0.03" pos="0.18 0 -0.03" mass="2"/>
      <body name="hand" pos="0.4 0 0">
        <joint name="wrist" type="hinge" axis="0 1 0" damping="0.1"/>
        <geom name="palm" type="box" size="0.1 0.1 0.02" pos="0.1 0 0" mass="1"/>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position name="shoulder" joint="shoulder" kp="3000" kv="60" forcerange="-{limit} {limit}"/>
    <position name="wrist" joint="wrist" kp="3000" kv="60"/>
  </actuator>
</mujoco>
"""


def holding(folder: Path, density: float, limit: float = 1000.0) -> Scene:
    """A brick of 0.0012 m3 on the hand of an arm, half a metre from its shoulder."""
    (folder / "arm.xml").write_text(ARM.format(limit=limit))
    held = brick("brick", [0.2, 0.1, 0.06], 0.05, [0.51, 0.0, 0.5502])
    content = {
        "time_step": STEP, "duration": 1.0, "gravity": [0.0, 0.0, -GRAVITY], "engine": "mujoco",
        "materials": {"stone": {"density": density, "friction": 0.8}},
        "model": {"file": "arm.xml", "material": "stone"}, "bodies": [held | {"material": "stone"}],
    }  # fmt: skip
    return parse_scene(content, "holding", folder=folder)


def test_actuators_feel_what_the_hand_holds(tmp_path: Path) -> None:
    """9.6 kg: torques are those of statics, at the angles that the servos give way to."""
    density = 8000.0
    scene = holding(tmp_path, density)
    with run_of(scene) as run:
        exchanges = list(run)
        dynamics = run.simulation.dynamics
        states, data, model = dynamics.states(), dynamics._data, dynamics._model
    assert np.abs(states.linear).max() < 1e-4
    assert exchanges[-1].contacts.gaps.min(initial=0.0) > -0.002 * 0.1
    reports = [exchange.report for exchange in exchanges]
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    given = sum(report.hand_energy + report.drift_energy for report in reports[1:])
    assert energy[-1] < energy[0] and given == pytest.approx(energy[-1] - energy[0], rel=0.02), "the arm gives way"
    mass = 0.0012 * density
    assert states.masses[0] == pytest.approx(mass, rel=1e-9)
    arms = data.xipos[1:3, 0], states.centers[0, 0]
    wrist = data.xanchor[1, 0]
    exact = [
        GRAVITY * (2.0 * arms[0][0] + 1.0 * arms[0][1] + mass * arms[1]),
        GRAVITY * (1.0 * (arms[0][1] - wrist) + mass * (arms[1] - wrist)),
    ]
    assert model.nu == 2
    np.testing.assert_allclose(-data.actuator_force, exact, rtol=1e-3)


def test_a_limited_motor_gives_way(tmp_path: Path) -> None:
    with run_of(holding(tmp_path, 8000.0, limit=40.0)) as run:
        data, angles = run.simulation.dynamics._data, []
        for _ in run:
            if data.qpos[0] > 0.1:
                assert data.actuator_force[0] == -40.0
            angles.append(data.qpos[0])
            if angles[-1] > 0.5:
                break
    assert angles[-1] > 0.5  # it sinks


def test_a_model_needs_the_engine(tmp_path: Path) -> None:
    scene = holding(tmp_path, 2000.0)
    with pytest.raises(SceneError, match="needs mujoco, not own"):
        with_engine(scene, "own")
    with pytest.raises(SceneError, match="'box2d' is none of own, mujoco"):
        with_engine(scene, "box2d")

"""The panel of `fracture-collision play` in a real Chromium: each control reaches its nodes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient
from sensor_msgs.msg import JointState
from stages.browser import opened, until
from stages.live_page import LivePage, choose, knob, live_page, on_a_plate

from fracture_collision.cli.commands import main
from fracture_collision.cli.replay import INCOMPLETE
from fracture_collision.ros.wire import qos
from fracture_collision.viewer.film.recorded_run import read_run

PLATES = 4
# With software rendering, on the processors that run the nodes, these take minutes.
pytestmark = pytest.mark.slow
BUDGET_EXHAUSTED = 1


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("play")


@pytest.fixture(scope="module")
def one_scene(browser: Any, folder: Path) -> Iterator[LivePage]:
    with live_page("plates", folder) as made:
        yield made


@pytest.fixture
def page(browser: Any, one_scene: LivePage) -> Iterator[Any]:
    with opened(browser, one_scene.address) as shown:
        shown.get_by_label("shadows").uncheck()  # they dominate the time of a software renderer
        yield shown


@pytest.fixture
def scene(one_scene: LivePage, page: Any) -> LivePage:
    """A scene of untouched plates."""
    if one_scene.status.scene == "plates" and one_scene.status.fragments == PLATES:
        return one_scene
    begin_plates(one_scene, page)
    return one_scene


def begin_plates(scene: LivePage, page: Any) -> None:
    run_id = scene.status.run_id
    if scene.status.scene == "plates":
        page.get_by_role("button", name="start over").click()
    else:
        choose(page, "scene", "plates")
    scene.until(lambda: scene.status.run_id != run_id and scene.status.step > 5, "another run")


def smash(scene: LivePage, page: Any) -> None:
    page.mouse.click(*on_a_plate(page))
    scene.until(lambda: scene.status.fragments > PLATES + 5, "a ball and shards")


def test_recordings_of_the_page_open_and_replay(scene: LivePage, page: Any, folder: Path) -> None:
    page.get_by_label("record").check()
    page.get_by_text("recording into").wait_for()
    bag = folder / "bag_1"
    until(lambda: (bag / "metadata.yaml").exists(), bool)
    smash(scene, page)
    broken = scene.states[-1].fracture_sequence
    page.get_by_label("record").uncheck()
    page.get_by_text("is complete").wait_for()
    run = read_run(bag)
    assert run.states[-1].fracture_sequence >= broken > 0
    assert set(run.states[-1].fragment_ids) <= run.body_of.keys()
    done = CliRunner().invoke(main, ["replay", str(bag)])
    # The recording may begin or end between states and their answer, and a busy recorder may miss one (INCOMPLETE).
    assert done.exit_code in (0, INCOMPLETE), done.output
    assert "answers equal the recorded ones, byte for byte" in done.output, done.output
    # a second recording beside it
    page.get_by_label("record").check()
    until(lambda: (folder / "bag_2" / "metadata.yaml").exists(), bool)
    page.get_by_label("record").uncheck()
    page.get_by_text("bag_2 is complete").wait_for()


def test_sliders_reach_the_simulator_the_service_and_its_answers(scene: LivePage, page: Any) -> None:
    knob(page, "slow motion").fill("0.05")
    scene.until(lambda: scene.status.rate == 0.05 and 0.0 < scene.status.achieved_rate < 0.06, "slow motion")
    knob(page, "slow motion").fill("1")
    scene.until(lambda: scene.status.rate == 1.0, "the clock's pace")
    service = AsyncParameterClient(scene.ears.node, "collision_node")

    def has(name: str, value: Any) -> None:
        def it_has() -> bool:
            future = service.get_parameters([name])
            scene.until(future.done, "an answer of the service")
            return parameter_value_to_python(future.result().values[0]) == value

        scene.until(it_has, f"{name} {value}")

    def most_contacts() -> int:
        return max(np.diff(scene.answer.pair_begin), default=0)

    smash(scene, page)
    scene.until(lambda: most_contacts() > 1, "pairs with several contacts")
    knob(page, "penetration_tolerance").fill("0.02")
    has("penetration_tolerance", 0.02)
    knob(page, "contacts_per_pair").fill("1")
    has("contacts_per_pair", 1)
    scene.until(lambda: most_contacts() == 1, "pairs with one contact each")
    knob(page, "contacts_per_pair").fill("8")
    has("contacts_per_pair", 8)
    knob(page, "penetration_tolerance").fill("0")
    has("penetration_tolerance", 0.0)
    scene.until(lambda: most_contacts() > 1, "pairs with several contacts")

    (ahead,) = scene.ears.parameters("lookahead")
    assert ahead > 0.0
    choose(page, "method", "glondu2014")
    has("method", "glondu2014")
    has("lookahead", 0.0)
    step = scene.status.step
    scene.until(lambda: scene.status.step > step + 5, "answers by the other method")
    choose(page, "method", "exact")
    has("method", "exact")
    has("lookahead", ahead)

    # the other direction: parameters set by another client appear on the panel
    assert scene.ears.set_parameters(contacts_per_pair=5) == [""]
    until(lambda: knob(page, "contacts_per_pair").input_value(), lambda value: value == "5")
    assert scene.ears.set_parameters(contacts_per_pair=8) == [""]
    until(lambda: knob(page, "contacts_per_pair").input_value(), lambda value: value == "8")


def test_a_scene_with_a_robot_is_chosen_and_moved(scene: LivePage, page: Any) -> None:
    joints: list[JointState] = []
    topic = qos.JOINT_STATES
    listener = scene.ears.node.create_subscription(topic.message_class, topic.name, joints.append, topic.qos)
    assert not page.get_by_text("joint 1").count()
    choose(page, "scene", "vase")
    scene.until(lambda: scene.status.scene == "vase" and bool(joints), "a vase and a robot")
    until(lambda: [knob(page, f"joint {j}").input_value() for j in range(1, 8)],
          lambda seen: seen == ["-50", "50", "0", "-70", "0", "-40", "0"])  # fmt: skip
    knob(page, "joint 1").fill("-30")
    scene.until(lambda: abs(joints[-1].position[0] - np.radians(-30.0)) < 1e-4, "a robot that has turned")
    until(lambda: knob(page, "torque 2, N m").input_value(), lambda seen: seen.endswith(" of 320") and seen[0] != "0")
    assert np.allclose(joints[-1].position[1:], np.radians([50.0, 0.0, -70.0, 0.0, -40.0, 0.0]), atol=1e-4)
    knob(page, "joint 7").fill("175")
    scene.until(lambda: abs(joints[-1].position[6] - np.radians(175.0)) < 1e-3, "a joint at its limit")
    assert not scene.status.refused
    scene.ears.node.destroy_subscription(listener)
    begin_plates(scene, page)
    until(lambda: page.get_by_text("joint 1").count(), lambda count: not count)

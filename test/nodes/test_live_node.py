"""A live scene over DDS: a user's commands and their effects."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from stages.live_player import PLATE, Player
from stages.ros_stage import StageWithClients

from fracture_collision.ros.nodes.live_client import LiveClient
from fracture_collision.share import share_directory


@pytest.fixture(scope="module")
def one_player(shared_stage: StageWithClients) -> Player:
    return Player(shared_stage)


@pytest.fixture
def player(one_player: Player) -> Player:
    """A scene whose plates are untouched."""
    one_player.begin_again()
    return one_player


def test_a_ball_breaks_a_plate_and_a_reset_makes_it_whole(player: Player) -> None:
    assert player.status.fragments == 4 and player.status.scene == "plates"
    player.hands.throw(PLATE - [0.0, 0.5, 0.0], [0.0, 7.0, 0.3])
    player.until(lambda: player.status.fragments > 10, "shards")
    player.begin_again()
    assert player.status.fragments == 4
    player.steps_go_on()
    assert player.service.exit_status() is None


def test_pause_step_and_slow_motion(player: Player) -> None:
    assert not player.answer(player.hands.step()).success, "only while it is paused"
    player.steps_go_on()
    assert player.answer(player.hands.pause(True)).success
    player.until(lambda: player.status.paused, "a pause")
    step = player.status.step
    assert player.answer(player.hands.step()).success
    player.until(lambda: player.status.step == step + 1, "one step")
    stays_at(player, step + 1)
    before = player.status.run_id
    assert player.answer(player.hands.reset()).success
    player.until(lambda: player.status.run_id != before and player.status.step == 1, "the first step of another run")
    stays_at(player, 1)
    assert player.status.fragments == 4
    assert player.answer(player.hands.pause(False)).success
    player.steps_go_on()
    result = player.answer(player.hands.set_parameters(rate=0.05)).results[0]
    assert result.successful, result.reason
    player.until(lambda: player.status.rate == 0.05 and 0.0 < player.status.achieved_rate < 0.06, "slow motion")
    assert not player.answer(player.hands.set_parameters(rate=0.0)).results[0].successful


def stays_at(player: Player, step: int) -> None:
    """In a pause."""
    count = len(player.told)
    player.until(lambda: len(player.told) > count + 3, "more news")
    assert player.status.step == step and player.status.paused


def test_a_hand_follows_a_user_in_a_scene_at_a_tenth_of_real_time(player: Player) -> None:
    assert player.answer(player.hands.set_parameters(rate=0.1)).results[0].successful
    player.until(lambda: 0.05 < player.status.achieved_rate < 0.15, "slow motion")
    player.hands.drag(player.status.run_id, 5, np.zeros(3), PLATE + [0.0, -0.2, 0.2])
    begin = player.status.step
    # 0.06 s, half a second or more for the user: the spring's own frequency would bring the plate less than half way
    player.until(lambda: player.status.step > begin + 24, "0.06 s")
    assert np.linalg.norm(player.place(5) - (PLATE + [0.0, -0.2, 0.2])) < 0.05
    player.until(lambda: player.status.step > begin + 120, "rest")
    assert np.linalg.norm(player.place(5) - (PLATE + [0.0, -0.2, 0.2])) < 0.01
    player.hands.let_go()
    begin = player.status.step
    player.until(lambda: player.status.step > begin + 40, "0.1 s")
    there = player.place(5)
    player.until(lambda: player.status.step > begin + 60, "0.15 s")
    assert player.place(5)[2] < there[2] - 0.01, "it falls"
    player.answer(player.hands.set_parameters(rate=1.0))


def test_a_hammer_is_added_and_driven(player: Player) -> None:
    known = player.newest_ids()
    player.hands.steer([0.0, 1.0, 0.0])
    player.until(lambda: bool(player.newest_ids() - known), "a hammer")
    (hammer,) = player.newest_ids() - known
    begin = player.place(hammer)
    player.until(lambda: player.place(hammer)[1] > begin[1] + 0.1, "a hammer that moves")
    assert abs(player.place(hammer)[2] - begin[2]) < 0.01


def test_another_scene_is_loaded_and_invalid_commands_rejected(player: Player) -> None:
    here, still = [0.0, -1.0, 1.0], [0.0, 0.0, 0.0]
    for act, words in (
        (lambda: player.hands.throw(here, still, density=np.inf), "throw_ball: density: inf"),
        (lambda: player.hands.drag(player.status.run_id, 4711, still, here), "hand_target: fragment_id: 4711"),
        (lambda: player.hands.steer([np.inf, 0.0, 0.0]), "cmd_vel: linear: "),
    ):
        act()
        player.until(lambda words=words: words in player.status.refused, f"a refusal with {words}")
    player.steps_go_on()
    assert player.status.fragments == 4
    player.begin_again("pane")
    assert player.status.scene == "pane" and not player.status.refused


def test_scenes_are_loaded_by_name_and_errors_reveal_no_file_content(stage: StageWithClients, tmp_path: Path) -> None:
    own, secret = tmp_path / "my_pane.yaml", tmp_path / "passwords"
    own.write_text((share_directory() / "config" / "scenes" / "pane.yaml").read_text())
    secret.write_text("hunter2\n")
    # a renamed node takes its private names along
    simulator = stage.start("live_simulator_node", "-r", "__node:=playground", scene=str(own))
    ears = stage.client()
    hands = LiveClient(ears.node, "playground")
    ears.spin_until(hands.is_there, "a live scene of another name")
    assert not LiveClient(ears.node).is_there()

    def answer(future):
        ears.spin_until(future.done, "an answer")
        return future.result()

    def set_next(scene: str):
        return answer(hands.set_parameters(next_scene=scene)).results[0]

    folder = share_directory() / "config" / "scenes"
    told = set()
    for path in (secret, tmp_path / "nowhere", folder / "pane.yaml", "../my_pane.yaml", "no such scene", tmp_path):
        result = set_next(str(path))
        assert not result.successful and "plates" in result.reason
        told.add(result.reason)
    assert len(told) == 1, "nothing is told of what there is"
    for scene in ("reference_sphere:coarse_inside", str(own), ""):
        assert set_next(scene).successful
    assert answer(hands.reset()).success
    own.write_text(secret.read_text())
    refused = answer(hands.reset())
    assert not refused.success and "hunter2" not in refused.message and "log of playground" in refused.message
    assert "hunter2" in simulator.log_text()


def test_joint_states_and_rejected_joint_commands(player: Player) -> None:
    player.hands.command_joints([0.0] * 7)
    player.until(lambda: player.status.refused == "joint_commands: the scene has no robot", "words")
    player.joints.clear()
    player.begin_again("vase")
    player.until(lambda: bool(player.joints), "joint states")
    first = player.joints[-1]
    names = list(first.name)
    assert names == [f"lbr_iiwa_joint_{j}" for j in range(1, 8)] and np.abs(first.velocity).max() < 1e-3
    assert 10.0 < np.abs(first.effort).max() < 320.0, "its weight"
    player.hands.command_joints([3.0], names[:1])
    player.until(lambda: player.status.refused.startswith("joint_commands: lbr_iiwa_joint_1: 3 rad is not"), "words")
    player.steps_go_on()
    np.testing.assert_allclose(player.joints[-1].position, first.position, atol=1e-5)
    player.hands.command_joints([1.0], names[:1])
    player.until(lambda: abs(player.joints[-1].position[0] - 1.0) < 1e-4, "a robot that has arrived")

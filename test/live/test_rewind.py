"""Going back in a live scene: copies of its state, and the same course from them, byte for byte."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.served_scene import ServedScene

from fracture_collision.simulation.live import INTERVAL, KEPT, REACH, Ball, History, LiveScene
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.simulation import StepReport
from fracture_collision.world import Settings

PLATE = np.array([-0.45, 0.0, 0.7227])  # [m] the first plate
BALL = Ball(PLATE - [0.0, 0.4, 0.0], np.array([0.0, 7.0, 0.3]), 0.04, 2000.0)


class Course(ServedScene):
    """A live scene from its beginning or from a moment."""

    def __init__(self, live: LiveScene, history: History, looks_ahead: bool) -> None:
        super().__init__(live.simulation, Settings(lookahead=0.0025 if looks_ahead else 0.0))
        self.live, self.history = live, history
        for body in live.simulation.start_bodies():
            self.world.add_body(body)
        for event in history.events:
            self.world.add_fracture(event)

    def step(self, count: int = 1) -> StepReport:
        for _ in range(count):
            self.history.keep(self.live)
            report = super().step()
            self.history.add(self.requests[-1].events)
        return report

    def sent(self) -> list[bytes]:
        """States and events as bytes, a step each."""
        return [
            b"".join(np.asarray(column).tobytes() for record in (request.states, *request.events) for column in record)
            for request in self.requests
        ]


def course(scene: str = "plates", looks_ahead: bool = True) -> Course:
    return Course(LiveScene(load_scene(scene), 7, looks_ahead), History(), looks_ahead)


@pytest.mark.parametrize("looks_ahead", [True, False], ids=["looking ahead", "not looking ahead"])
@pytest.mark.parametrize(
    "before", [20, *(pytest.param(n, marks=pytest.mark.slow) for n in (1, 24, 60))],
    ids=lambda n: f"{n} steps after the throw",
)  # fmt: skip
def test_a_scene_goes_on_from_a_copy_as_it_did(looks_ahead: bool, before: int) -> None:
    first = course(looks_ahead=looks_ahead)
    first.step(10)
    first.live.throw(BALL)
    first.step(before)
    copied, events, begin = first.live.copied(), first.history.events, len(first.requests)
    first.step(60)
    for _ in range(2):  # the copy itself stays as it is
        again = Course(copied.copied(), History(events=events), looks_ahead)
        again.step(60)
        assert again.sent() == first.sent()[begin:]
    assert len(first.requests[-1].states.fragment_ids) > 10, "it broke"


def test_a_scene_with_a_robot_goes_on_as_it_did() -> None:
    first = course("vase")
    first.live.command_joints([], np.radians([30.0, 40.0, 0.0, -60.0, 0.0, 20.0, 0.0]).tolist())
    first.step(40)
    copied, begin = first.live.copied(), len(first.requests)
    first.step(150)
    again = Course(copied, History(events=first.history.events[:0]), True)
    again.step(150)
    assert again.sent() == first.sent()[begin:]
    for theirs, ours in zip(again.live.simulation.robot.joints(), first.live.simulation.robot.joints(), strict=True):
        np.testing.assert_array_equal(theirs, ours)


@pytest.mark.slow
def test_a_rewind_goes_ten_seconds_back_or_to_the_beginning() -> None:
    run = course("pane")
    assert run.history.moment(0.0) is None
    run.step(400)  # 1 s
    assert run.history.moment(run.live.simulation.time - REACH).time == 0.0
    while run.live.simulation.time < KEPT + 5.0:
        run.step(100)
    times = [moment.time for moment in run.history._moments]
    np.testing.assert_allclose(np.diff(times), INTERVAL, atol=run.live.simulation._scene.time_step)
    now = run.live.simulation.time
    assert now - KEPT - INTERVAL <= times[0] <= now - KEPT + INTERVAL, "what is kept is bounded"
    moment = run.history.moment(now - REACH)
    assert REACH <= now - moment.time < REACH + 2 * INTERVAL
    earlier = run.history.until(moment)
    again = earlier.moment(moment.time - REACH).time
    assert again < moment.time - REACH + INTERVAL and again in times, "a second rewind goes further"
    assert earlier._moments[-1] is moment


def test_events_of_a_moment_are_those_that_the_service_had() -> None:
    run = course()
    run.step(2)
    run.live.throw(BALL)
    run.step(415)
    assert run.history.events
    beginning, *later = run.history._moments
    assert not run.history.until(beginning).events and len(later) == 2
    for moment in later:
        begin = round(moment.time / 0.0025)
        sequences = [event.sequence for request in run.requests[:begin] for event in request.events]
        assert [event.sequence for event in run.history.until(moment).events] == sequences != []
        again = Course(moment.live.copied(), run.history.until(moment), True)
        again.step(10)
        assert again.sent() == run.sent()[begin : begin + 10]


def test_the_hand_lets_go_and_the_hammer_stops() -> None:
    run = course()
    run.step(2)
    run.live.steer(np.array([0.0, 1.0, 0.0]))
    run.live.drag(5, np.zeros(3), PLATE + [0.0, -0.1, 0.2])
    run.step(20)
    copied = run.live.copied()
    copied.rest()
    assert copied.simulation.drag.held is None and not copied._hammer._velocity.any()
    assert run.live.simulation.drag.held == 5 and run.live._hammer._velocity.any(), "the original goes on"
    assert copied._hammer in copied.simulation._pushers and copied._hammer is not run.live._hammer


def test_copies_share_meshes_and_nothing_that_changes() -> None:
    run = course("vase")
    run.step(20)
    theirs, ours = run.live.copied().simulation._cast, run.live.simulation._cast
    assert ours.breakable
    for body_id, body in ours.breakable.items():
        copied = theirs.breakable[body_id]
        assert copied is not body and copied._edges is body._edges and copied._vertices is body._vertices
        assert not np.shares_memory(copied._node_fragments, body._node_fragments)
    assert all(theirs.body_of[i] is body for i, body in ours.body_of.items())

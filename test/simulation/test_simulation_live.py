"""A live scene: balls, a hand, a hammer; bodies that leave the scene, and rejected commands."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from worlds.served_scene import PlayedScene

from fracture_collision.records import ADD, REMOVE
from fracture_collision.simulation.live import MOST_BALLS, Ball, CommandRefused

PLATE = np.array([-0.45, 0.0, 0.7227])
STILL = np.zeros(3)


class Run(PlayedScene):
    def announced(self, operation: int) -> list[int]:
        return [body.body_id for request in self.requests for body in request.bodies if body.operation == operation]


@pytest.fixture
def run(request: pytest.FixtureRequest) -> Iterator[Run]:
    made = Run(looks_ahead=getattr(request, "param", True))
    yield made
    made.live.close()


def test_balls_of_the_scene_are_not_thrown_in_a_live_run(run: Run) -> None:
    assert run.step(120).fragments == 4, "the scene's first ball would have come at step 100"
    assert [body.name for body in run.requests[0].bodies] == [
        "ground", "shelf", "rack", "wall", "plate 1", "plate 2", "plate 3", "plate 4",
    ]  # fmt: skip
    run.live.throw(Ball(PLATE - [0.0, 0.4, 0.0], np.array([0.0, 7.0, 0.3]), 0.04, 2000.0))
    assert run.step(60).fragments > 10


def test_the_oldest_balls_are_removed(run: Run) -> None:
    for k in range(MOST_BALLS + 3):
        run.live.throw(Ball(np.array([0.1 * k - 0.6, -2.0, 1.0]), STILL, 0.04, 2000.0))
        report = run.step()
    balls = [body_id for body_id in run.announced(ADD) if body_id > 8]
    assert len(balls) == MOST_BALLS + 3 and run.announced(REMOVE) == balls[:3]
    assert report.fragments == 4 + MOST_BALLS
    named = set(run.requests[-1].states.fragment_ids)
    assert set(balls[3:]) <= named and balls[0] not in run.world.fragments().body_ids
    assert run.step(50).fragments == 4 + MOST_BALLS


def test_a_hand_keeps_a_piece_of_a_body_that_breaks(run: Run) -> None:
    run.step(5)
    # the message that releases this grip may be overwritten by that of the next, which takes hold anew
    run.live.drag(5, np.array([0.1, 0.0, 0.0]), PLATE + [0.0, -0.3, 0.1])
    first = run.live.simulation.drag._grip
    run.live.drag(5, STILL, PLATE + [0.0, -0.3, 0.1])
    assert np.linalg.norm(run.live.simulation.drag._grip.point - first.point) > 0.05
    run.step(100)
    lifted = run.place(5)
    assert np.linalg.norm(lifted - (PLATE + [0.0, -0.3, 0.1])) < 0.05
    assert run.live.simulation.strike(5, STILL, 3.0)
    run.step()
    held = run.live.simulation.drag.held
    assert held not in (None, 5)
    run.live.drag(5, STILL, PLATE + [0.0, -0.3, 0.3])  # as the page sends it, unaware of the fracture
    run.step(100)
    assert run.live.simulation.drag.held == held and run.place(held)[2] > lifted[2] + 0.1
    run.live.drag(0, STILL, STILL)
    assert run.live.simulation.drag.held is None


def test_a_held_body_may_be_removed(run: Run) -> None:
    run.live.throw(Ball(np.array([0.0, -2.0, 1.0]), STILL, 0.04, 2000.0))
    run.step()
    (ball,) = [body_id for body_id in run.announced(ADD) if body_id > 8]
    run.live.drag(ball, STILL, np.array([0.0, -2.0, 1.2]))
    run.step(20)
    run.live.simulation.take_out(ball)
    run.step(20)
    assert run.live.simulation.drag.held is None and ball not in run.requests[-1].states.fragment_ids
    with pytest.raises(KeyError):
        run.live.simulation.take_out(ball)
    with pytest.raises(KeyError):
        run.live.simulation.take_out(1)  # the ground


@pytest.mark.parametrize("run", [True, False], ids=["looking ahead", "not looking ahead"], indirect=True)
def test_a_hammer_follows_commands_and_breaks_bodies(run: Run) -> None:
    run.live.steer(STILL)
    assert run.step(5).fragments == 4, "no hammer for a command to stand still"
    run.live.steer(np.array([-0.5, 0.0, 0.0]))
    run.step(80)
    (hammer,) = [body_id for body_id in run.announced(ADD) if body_id > 8]
    begin = run.place(hammer)
    run.step(40)
    np.testing.assert_allclose(run.place(hammer) - begin, [-0.05, 0.0, 0.0], atol=2e-3)
    run.live.steer(np.array([0.0, 3.0, 0.0]))
    assert run.step(80).fragments > 10
    run.live.steer(STILL)
    run.step(400)  # with lookahead it takes a second to push through the pieces
    there = run.place(hammer)
    assert run.step(50).fragments > 10
    assert np.linalg.norm(run.place(hammer) - there) < 5e-3


@pytest.mark.parametrize("offset", [0.07, *(pytest.param(x, marks=pytest.mark.slow) for x in (-0.06, 0.0))])
def test_a_ball_at_30_metres_a_second_breaks_the_plate_it_hits_and_stops_before_the_wall(
    run: Run, offset: float
) -> None:
    run.live.throw(Ball(PLATE + [offset, -1.0, 0.0], np.array([0.0, 30.0, 0.0]), 0.04, 2000.0))
    fragments = run.step().fragments
    (ball,) = [body_id for body_id in run.announced(ADD) if body_id > 8]
    for _ in range(900):  # it may roll along the shelf and fall off its end
        before, report = run.place(ball), run.step()
        assert run.place(ball)[1] < 1.0 - 0.04 + 1e-3, "the wall's front is at 1 m"
        assert run.place(ball)[2] > 0.04 - 1e-3, "the floor"
    assert report.fragments > fragments + 10
    assert np.linalg.norm(run.place(ball) - before) < 0.5 * 0.0025, "it has stopped, or rolls"


def test_invalid_arguments_are_rejected_with_an_explanation(run: Run) -> None:
    live = run.live
    run.step(2)
    for act, arguments, words in (
        (live.throw, [Ball(PLATE * np.nan, STILL, 0.04, 2000.0)], "position: "),
        (live.throw, [Ball(PLATE * 1e9, STILL, 0.04, 2000.0)], "position: "),
        (live.throw, [Ball(PLATE, np.full(3, 100.0), 0.04, 2000.0)], "velocity: "),
        (live.throw, [Ball(PLATE, STILL, np.nan, 2000.0)], "radius: nan"),
        (live.throw, [Ball(PLATE, STILL, 0.04, -1.0)], "density: -1"),
        (live.steer, [np.array([0.0, 0.0, 5.0])], "linear: 5 m/s"),
        (live.drag, [99, STILL, STILL], "fragment_id: 99"),
        (live.drag, [1, STILL, STILL], "fragment_id: 1 "),
        (live.drag, [5, STILL, STILL * np.nan], "target: "),
    ):
        with pytest.raises(CommandRefused, match=words):
            act(*arguments)
        assert run.step(2).fragments == 4


def test_equal_commands_give_equal_runs() -> None:
    def states() -> list[bytes]:
        run = Run()
        run.live.throw(Ball(PLATE - [0.0, 0.3, 0.0], np.array([0.0, 7.0, 0.3]), 0.04, 2000.0))
        run.step(30)
        run.live.close()
        return [request.states.positions.tobytes() for request in run.requests]

    assert states() == states()

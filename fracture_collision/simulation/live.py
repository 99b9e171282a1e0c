"""An interactive scene: it runs without an end time and takes commands between its steps.

The user replaces the scene's own actors: spheres with a start time are left out, a recorded hand does not move, and a
robot holds its first posture. Everything else is the scene's, and the physics is that of simulation.py.

Its last seconds are kept as copies of its state, to go back to (`History`). A copy of a hundred fragments takes 0.3 ms.
The alternative, recorded commands and a second run through all steps since, would let the user wait. Meshes and
descriptions of bodies are shared by all copies. A scene that continues from a copy takes the same course, byte for
byte, if its user does the same.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fracture_collision.portable_math import lengths
from fracture_collision.records import FractureEvent
from fracture_collision.simulation.actors.hand import Hammer
from fracture_collision.simulation.actors.robot import RobotPlan
from fracture_collision.simulation.config.shapes import Shape
from fracture_collision.simulation.scene.scene import Material, Scene, SceneBody
from fracture_collision.simulation.simulation import Simulation

BALL = Material(density=2000.0, friction=0.6, restitution=0.2, rolling_arm=5e-4, fracture=None)
STEEL = Material(density=7800.0, friction=0.4, restitution=0.1, rolling_arm=5e-4, fracture=None)
HAMMER_RADIUS = 0.04  # [m]; of steel: 2.1 kg
IN_FRONT = 0.35  # [m] from the mean position of the movable bodies to the hammer's first place, along -y
MOST_BALLS = 12  # beyond this the oldest is removed
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])

# Limits of commands: no ball as large as a house, or as fast as sound.
RADII = (0.005, 0.25)  # [m]
DENSITIES = (10.0, 20000.0)  # [kg/m3]
MOST_SPEED = 40.0  # [m/s] of a ball
MOST_HAMMER_SPEED = 4.0  # [m/s]
FARTHEST = 100.0  # [m] from the world's origin
SLOWEST_HAND = 0.1  # simulated time over real time; below it a hand lags, as the force on what it pulls is limited


class Ball(NamedTuple):
    """Fields of ThrowBall.msg."""

    position: np.ndarray  # (3,) [m]
    velocity: np.ndarray  # (3,) [m/s]
    radius: float  # [m]
    density: float  # [kg/m3]


class CommandRefused(ValueError):
    """A rejected command; nothing has changed. The text names the field."""


class LiveScene:
    """An interactive run of `scene`. The owner steps `simulation`. looks_ahead: as in Simulation."""

    def __init__(self, scene: Scene, seed: int, looks_ahead: bool = False) -> None:
        kept = tuple(body for body in scene.bodies if not _is_thrown(body))
        robot = None if scene.robot is None else scene.robot.standing()
        self.simulation = Simulation(scene._replace(bodies=kept, hand=None, robot=robot), seed, None, looks_ahead)
        self._home = _hammer_home(kept, scene.robot)
        self._hammer: Hammer | None = None
        self._balls: deque[int] = deque()
        self._thrown = 0
        self._taken = 0  # fragment that the hand was commanded to take, even if it has broken since
        self._grip = np.zeros(3)  # [m] where, in its body frame

    def throw(self, ball: Ball) -> None:
        """Throw a ball, from the next step on. Raises CommandRefused."""
        _finite("position", ball.position)
        _finite("velocity", ball.velocity)
        _within("position", float(np.abs(ball.position).max()), (0.0, FARTHEST), "m")
        _within("velocity", float(lengths(ball.velocity)), (0.0, MOST_SPEED), "m/s")
        _within("radius", ball.radius, RADII, "m")
        _within("density", ball.density, DENSITIES, "kg/m3")
        if len(self._balls) == MOST_BALLS:
            self.simulation.take_out(self._balls.popleft())
        self._thrown += 1
        material = BALL._replace(density=float(ball.density))
        body = _sphere(f"thrown {self._thrown}", float(ball.radius), material, ball.position, ball.velocity)
        self._balls.append(self.simulation.throw(body))

    def drag(self, fragment_id: int, grip: np.ndarray, target: np.ndarray) -> None:
        """Move the hand as HandTarget.msg defines. Raises CommandRefused."""
        hand = self.simulation.drag
        if not fragment_id:
            self._taken = 0
            hand.release()
            return
        _finite("grip", grip)
        _finite("target", target)
        _within("target", float(np.abs(target).max()), (0.0, FARTHEST), "m")
        if fragment_id != self._taken or not np.array_equal(grip, self._grip):
            self._taken, self._grip = fragment_id, np.array(grip)
            if not self.simulation.hold(fragment_id, grip, target):
                self._taken = 0
                raise CommandRefused(f"fragment_id: {fragment_id} is not a movable fragment")
        hand.move(np.asarray(target, np.float64), np.zeros(3))

    def keep_pace(self, rate: float) -> None:
        """`rate`: simulated time over real time, now. Where it is low, the hand is quicker: users are in real time."""
        self.simulation.drag.quicken(1.0 / min(max(rate, SLOWEST_HAND), 1.0))

    def steer(self, velocity: np.ndarray) -> None:
        """Move the hammer with `velocity` (3,) [m/s], world axes, until the next command. Raises CommandRefused.

        The first non-zero velocity brings the hammer into the scene.
        """
        _finite("linear", velocity)
        _within("linear", float(lengths(velocity)), (0.0, MOST_HAMMER_SPEED), "m/s")
        if self._hammer is None:
            if not np.any(velocity):
                return
            body = _sphere("hammer", HAMMER_RADIUS, STEEL, self._home, np.zeros(3))
            self._hammer = Hammer(self.simulation.throw(body), self._home)
            self.simulation.add_pusher(self._hammer)
        self._hammer.steer(velocity)

    def command_joints(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Move the robot to `positions` [rad] of the joints `names`, or of all in order if that is empty.

        Raises CommandRefused.
        """
        if self.simulation.robot is None:
            raise CommandRefused("the scene has no robot")
        try:
            self.simulation.robot.command(names, positions)
        except ValueError as error:
            raise CommandRefused(str(error)) from error

    def copied(self) -> LiveScene:
        """A copy between two steps; both take the same course if the same happens to them."""
        return copy.deepcopy(self)

    def rest(self) -> None:
        """Let go of what the hand holds, and stop the hammer: the commands of a user who is not there."""
        self.drag(0, np.zeros(3), np.zeros(3))
        if self._hammer is not None:
            self._hammer.steer(np.zeros(3))

    def close(self) -> None:
        """Release the simulation's resources."""
        self.simulation.close()


def _is_thrown(body: SceneBody) -> bool:
    return body.start_time > 0.0 and body.shape.kind == "sphere"


def _hammer_home(bodies: tuple[SceneBody, ...], robot: RobotPlan | None) -> np.ndarray:
    actors = {part.body for part in robot.shapes} if robot is not None else set()
    places = [body.position for body in bodies if not body.is_static and body.name not in actors]
    middle = np.mean(places, axis=0) if places else np.array([0.0, 0.0, 0.5])
    return middle - np.array([0.0, IN_FRONT, 0.0])


def _sphere(name: str, radius: float, material: Material, position: np.ndarray, velocity: np.ndarray) -> SceneBody:
    return SceneBody(
        name, Shape("sphere", radius=radius), material, False, np.array(position, np.float64), UPRIGHT, 0.0,
        np.array(velocity, np.float64), np.zeros(3),
    )  # fmt: skip


def _finite(name: str, values: np.ndarray) -> None:
    if not np.all(np.isfinite(values)):
        raise CommandRefused(f"{name}: {np.asarray(values).tolist()} is not finite")


def _within(name: str, value: float, limits: tuple[float, float], unit: str) -> None:
    if not limits[0] <= value <= limits[1]:
        raise CommandRefused(f"{name}: {value:.4g} {unit} is not between {limits[0]:g} and {limits[1]:g} {unit}")


INTERVAL = 0.5  # [s] of simulated time between two copies
REACH = 10.0  # [s] that a rewind goes back
KEPT = 20.0  # [s] so that there is something left to go back to after a rewind


class Moment(NamedTuple):
    """A live scene between two steps."""

    time: float  # [s] simulated
    events: int  # that the service had by then
    live: LiveScene  # a copy, which no step changes


class History:
    """The moments of one run, and its events from the beginning."""

    def __init__(self, moments: Sequence[Moment] = (), events: Sequence[FractureEvent] = ()) -> None:
        self._moments = deque(moments)  # in order of time
        self._events = list(events)

    @property
    def events(self) -> list[FractureEvent]:
        """All events that the service has, in order."""
        return list(self._events)

    def add(self, events: Sequence[FractureEvent]) -> None:
        """Add those that the service gets; events that it has already do not count."""
        self._events += [event for event in events if event.sequence > len(self._events)]

    def keep(self, live: LiveScene) -> None:
        """Keep a copy, if it is time for one. Called between two steps."""
        time = live.simulation.time
        if self._moments and time < self._moments[-1].time + INTERVAL:
            return
        self._moments.append(Moment(time, len(self._events), live.copied()))
        while len(self._moments) > 1 and self._moments[1].time <= time - KEPT:
            self._moments.popleft()

    def moment(self, time: float) -> Moment | None:
        """The last moment until `time` [s], else the first one that is kept; None if there is none."""
        earlier = [moment for moment in self._moments if moment.time <= time]
        return earlier[-1] if earlier else next(iter(self._moments), None)

    def until(self, moment: Moment) -> History:
        """The history of a scene that goes on from this one of the moments."""
        return History([each for each in self._moments if each.time <= moment.time], self._events[: moment.events])

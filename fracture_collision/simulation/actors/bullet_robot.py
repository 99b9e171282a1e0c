"""A robot in PyBullet, which has its joints, limits, motors and dynamics; no shapes, and nothing else beside it.

Bullet's solver cannot be given contacts. What it takes is forces: a step can be tried with impulses on the links, and
taken back. Between two steps the state is that of the joints alone, so that going back, and a copy, are exact.

Equal runs are equal to the last bit on one kind of processor; on another they may differ, as Bullet calls libm.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any
from xml.etree import ElementTree

import numpy as np

from fracture_collision.extras import need

need("bullet", "a robot")

import pybullet  # noqa: E402

from fracture_collision.simulation.actors.joint_goals import JointGoals, JointLimits  # noqa: E402
from fracture_collision.simulation.actors.robot import (  # noqa: E402
    JointStates,
    Push,
    RobotPlan,
    read_urdf,
)
from fracture_collision.simulation.engine import FrameState  # noqa: E402
from fracture_collision.simulation.rotations import (  # noqa: E402
    crossed,
    quaternion_products,
    rotation_matrices,
    turned,
)

# Attributes of BulletRobot that belong to a client of Bullet.
_OF_BULLET = {"_client", "_robot", "_joint_numbers", "_link_numbers"}
UPRIGHT = [0.0, 0.0, 0.0, 1.0]


class BulletRobot:
    """A Robot of a URDF file. A copy takes the same course as the original."""

    def __init__(self, plan: RobotPlan, ids: Mapping[str, int], time_step: float, gravity: np.ndarray) -> None:
        """`ids`: of the plan's shapes, by the names of their bodies; gravity (3,) [m/s2]; time_step [s]."""
        self._plan, self._gravity, self._time_step = plan, gravity, time_step
        moving = read_urdf(plan.urdf).moving()
        self._names = tuple(joint.name for joint in moving)
        self._damping = {joint.child: joint.damping for joint in moving}
        shapes = sorted((shape for shape in plan.shapes if not shape.is_static), key=lambda shape: ids[shape.body])
        self.fragment_ids = np.array([ids[shape.body] for shape in shapes], np.uint32)
        self._link_names = tuple(dict.fromkeys(shape.link for shape in shapes))
        self.links = np.array([self._link_names.index(shape.link) for shape in shapes], np.int64)
        self._places = np.array([shape.position for shape in shapes]).reshape(-1, 3)
        self._turns = np.array([shape.orientation for shape in shapes]).reshape(-1, 4)
        start = plan.start_angles()
        self._angles = np.array([start.get(name, 0.0) for name in self._names])
        self._speeds, self._torques = np.zeros((2, len(self._names)))
        self.limits: JointLimits = plan.limits()
        self._goals: JointGoals | None = None  # None: the motors follow their tables
        self._steps = 0
        self._frames: FrameState | None = None  # None: not read since the last change
        self._client: int | None = None

    def __deepcopy__(self, memo: dict[int, Any]) -> BulletRobot:
        """A copy whose client of Bullet is made when it is needed: most copies are never stepped."""
        made = BulletRobot.__new__(BulletRobot)
        memo[id(self)] = made
        shared = {"_plan": self._plan}
        its = {name: value for name, value in vars(self).items() if name not in _OF_BULLET | set(shared)}
        vars(made).update(shared | copy.deepcopy(its, memo), _client=None)
        return made

    def __del__(self) -> None:
        self.close()

    def frames(self) -> FrameState:
        """As in Robot."""
        if self._frames is None:
            self._put_back()
            self._frames = self._read()
        return self._frames

    def trial(self, pushes: Sequence[Push]) -> FrameState:
        """As in Robot."""
        self._step(pushes)
        return self._read()

    def commit(self, pushes: Sequence[Push]) -> None:
        """As in Robot."""
        self._step(pushes)
        self._frames = self._read()
        states = pybullet.getJointStates(self._robot, self._joint_numbers, physicsClientId=self._client)
        self._angles, self._speeds, self._torques = (np.array([state[k] for state in states]) for k in (0, 1, 3))
        self._steps += 1
        if self._goals is not None:
            self._goals = self._goals.advanced(self.limits, self._time_step)

    def command(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """As in Robot."""
        goals = self._goals
        if goals is None:  # from where the tables have the motors now
            aims = dict(zip(self._names, self._angles.tolist(), strict=True))
            time = self._steps * self._time_step
            aims |= {motor.joint: motor.track.at(time)[0] for motor in self._plan.motors if motor.controls_position}
            angles = np.array([aims[name] for name in self.limits.names])
            goals = JointGoals(angles, np.zeros(len(angles)), angles)
        self._goals = goals.commanded(self.limits, names, positions)

    def joints(self) -> JointStates:
        """As in Robot."""
        return JointStates(self._names, self._angles.copy(), self._speeds.copy(), self._torques.copy())

    def set_joints(self, angles: np.ndarray, speeds: np.ndarray) -> None:
        """Move the joints at once, between two steps.

        angles (k,) [rad], [m] and speeds (k,) [rad/s], [m/s] in the order of `joints`. ValueError for other shapes,
        and for values that are not finite.
        """
        angles, speeds = np.array(angles, np.float64), np.array(speeds, np.float64)
        for name, values in (("angles", angles), ("speeds", speeds)):
            if values.shape != self._angles.shape or not np.isfinite(values).all():
                raise ValueError(f"{name}: needs {len(self._names)} finite numbers, got {values.tolist()}")
        self._angles, self._speeds, self._frames = angles, speeds, None

    def close(self) -> None:
        """Release the client of Bullet; it is made again if it is needed."""
        if self._client is not None:
            with suppress(pybullet.error):  # gone already, at the interpreter's end
                pybullet.disconnect(physicsClientId=self._client)
            self._client = None

    def _connect(self) -> None:
        self._client = pybullet.connect(pybullet.DIRECT)
        at = {"physicsClientId": self._client}
        pybullet.setGravity(*self._gravity.tolist(), **at)
        pybullet.setTimeStep(self._time_step, **at)
        pybullet.setPhysicsEngineParameter(deterministicOverlappingPairs=1, numSubSteps=0, **at)
        plan = self._plan
        with NamedTemporaryFile("w", suffix=".urdf", encoding="utf-8") as file:
            file.write(_without_shapes(plan.urdf))
            file.flush()
            robot = self._robot = pybullet.loadURDF(
                file.name, plan.position.tolist(), plan.orientation.tolist(), useFixedBase=True,
                flags=pybullet.URDF_USE_INERTIA_FROM_FILE, **at,
            )  # fmt: skip
        told = [pybullet.getJointInfo(robot, j, **at) for j in range(pybullet.getNumJoints(robot, **at))]
        numbers, links = ({row[column].decode(): row[0] for row in told} for column in (1, 12))
        self._joint_numbers = [numbers[name] for name in self._names]
        self._link_numbers = [links[name] for name in self._link_names]
        pybullet.changeDynamics(robot, -1, linearDamping=0.0, angularDamping=0.0, **at)
        for link, number in links.items():
            damping = self._damping.get(link, 0.0)
            pybullet.changeDynamics(
                robot, number, linearDamping=0.0, angularDamping=0.0, jointDamping=damping, **at
            )
        for number in self._joint_numbers:  # Bullet begins with a motor that brakes each joint
            pybullet.setJointMotorControl2(robot, number, pybullet.VELOCITY_CONTROL, force=0.0, **at)

    def _put_back(self) -> None:
        """Set Bullet's joints to the present state."""
        if self._client is None:
            self._connect()
        pybullet.resetJointStatesMultiDof(
            self._robot, self._joint_numbers, [[angle] for angle in self._angles.tolist()],
            [[speed] for speed in self._speeds.tolist()], physicsClientId=self._client,
        )  # fmt: skip

    def _step(self, pushes: Sequence[Push]) -> None:
        """A step of Bullet from the present state."""
        self._put_back()
        self._command()
        for link, impulse, point in pushes:
            pybullet.applyExternalForce(
                self._robot, self._link_numbers[link], (impulse / self._time_step).tolist(), point.tolist(),
                pybullet.WORLD_FRAME, physicsClientId=self._client,
            )  # fmt: skip
        pybullet.stepSimulation(physicsClientId=self._client)

    def _command(self) -> None:
        """Set the motors for a step from now."""
        time, goals, limits = self._steps * self._time_step, self._goals, self.limits
        after = None if goals is None else goals.advanced(limits, self._time_step)
        for motor in self._plan.motors:
            value, rate = motor.track.at(time)
            number = self._joint_numbers[self._names.index(motor.joint)]
            at = {"force": motor.torque, "velocityGain": motor.velocity_gain, "physicsClientId": self._client}
            if goals is not None and after is not None:
                i = limits.names.index(motor.joint)
                value, rate = goals.angles[i], (after.angles[i] - goals.angles[i]) / self._time_step
                # It does not hurry back to where something kept it from.
                at["maxVelocity"] = limits.speeds[i]
            if motor.controls_position or goals is not None:
                pybullet.setJointMotorControl2(
                    self._robot, number, pybullet.POSITION_CONTROL, targetPosition=value, targetVelocity=rate,
                    positionGain=motor.position_gain, **at,
                )  # fmt: skip
            else:
                pybullet.setJointMotorControl2(
                    self._robot, number, pybullet.VELOCITY_CONTROL, targetVelocity=value, **at
                )

    def _read(self) -> FrameState:
        """Frames of the bodies from Bullet's links, whose velocities are those of their centres of mass."""
        states = pybullet.getLinkStates(
            self._robot, self._link_numbers, computeLinkVelocity=1, computeForwardKinematics=1,
            physicsClientId=self._client,
        )  # fmt: skip
        centers, origins, turns, linear, angular = (
            np.array([state[k] for state in states])[self.links] for k in (0, 4, 5, 6, 7)
        )
        positions = origins + turned(rotation_matrices(turns), self._places)
        orientations = quaternion_products(turns, self._turns)
        return FrameState(positions, orientations, linear + crossed(angular, positions - centers), angular)


def _without_shapes(urdf: Path) -> str:
    """The text of a URDF file without meshes, which would take Bullet longer to read than all else."""
    robot = ElementTree.parse(urdf).getroot()
    for link in robot.iter("link"):
        for element in [*link.findall("visual"), *link.findall("collision")]:
            link.remove(element)
    return ElementTree.tostring(robot, encoding="unicode")

"""A robot arm in a scene, a KUKA LBR iiwa (config/robots): its parts, its kinematics, its recorded swing.

Each link is represented by one to three spheres, the flange carries a block to strike with, and the foot is a box that
cannot move; to the collision service they are bodies like any other. `arm_control` makes them follow their links.

Forward kinematics: the frame of link j is that of link j - 1, moved by the joint's `origin` and turned about its
`axis` by the joint's angle (REP-103 axes; URDF's rpy are rotations about fixed x, y, z axes in this order).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np

from fracture_collision.portable_math import cosine, lengths, sine
from fracture_collision.records import documented
from fracture_collision.share import share_directory
from fracture_collision.simulation.config.scene_fields import ROTATION, Fields, SceneError
from fracture_collision.simulation.config.shapes import Shape
from fracture_collision.simulation.rotations import (
    DEGREE,
    from_euler_angles,
    quaternion_products,
    rotation_matrices,
    turned,
    turned_by,
)


class JointLimits(NamedTuple):
    """Of k joints, in the order of the chain."""

    names: tuple[str, ...]
    lower: np.ndarray  # (k,) [rad]
    upper: np.ndarray  # (k,) [rad]
    speeds: np.ndarray  # (k,) [rad/s]


class Chain(NamedTuple):
    """k revolute joints, each at the end of the previous link."""

    limits: JointLimits
    links: tuple[str, ...]  # k + 1 names, from the base link
    places: np.ndarray  # (k, 3) [m], of the joint in the frame of the previous link
    turns: np.ndarray  # (k, 4) unit quaternions x y z w, likewise
    axes: np.ndarray  # (k, 3) unit, in the joint's frame


def read_chain(file: Path) -> Chain:
    """The revolute joints of a URDF file, in its order. ValueError if they do not form one chain or lack an element."""
    joints = [joint for joint in ElementTree.parse(file).getroot().iter("joint") if joint.get("type") == "revolute"]
    for before, after in zip(joints[:-1], joints[1:], strict=True):
        if _attribute(before, "child", "link") != _attribute(after, "parent", "link"):
            raise ValueError(
                f"{file}: joint {after.get('name')} does not follow {before.get('name')}: needs one chain of joints"
            )
    lower, upper, speeds = (np.concatenate([_numbers(joint, "limit", key) for joint in joints])
                            for key in ("lower", "upper", "velocity"))  # fmt: skip
    limits = JointLimits(tuple(joint.get("name", "") for joint in joints), lower, upper, speeds)
    axes = np.array([_numbers(joint, "axis", "xyz") for joint in joints])
    return Chain(
        limits,
        (_attribute(joints[0], "parent", "link"), *(_attribute(joint, "child", "link") for joint in joints)),
        np.array([_numbers(joint, "origin", "xyz") for joint in joints]),
        np.array([from_euler_angles(_numbers(joint, "origin", "rpy")) for joint in joints]),
        axes / lengths(axes)[:, None],
    )


def link_frames(
    chain: Chain, position: np.ndarray, orientation: np.ndarray, angles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Origins (k, 3) [m] and orientations (k, 4) of the links after each joint, given the base link's frame."""
    origins, orientations = np.empty_like(chain.places), np.empty_like(chain.turns)
    local = joint_turns(chain, angles)
    for j in range(len(angles)):
        position = position + turned_by(orientation, chain.places[j])
        orientation = quaternion_products(orientation[None], local[j : j + 1])[0]
        origins[j], orientations[j] = position, orientation
    return origins, orientations


def joint_turns(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Orientations (k, 4) of the links after each joint, in the frame of the link before it."""
    half = 0.5 * np.asarray(angles)
    about = np.column_stack((sine(half)[:, None] * chain.axes, cosine(half)))
    return quaternion_products(chain.turns, about)


def _numbers(joint: ElementTree.Element, tag: str, key: str) -> np.ndarray:
    return np.array([float(number) for number in _attribute(joint, tag, key).split()])


def _attribute(joint: ElementTree.Element, tag: str, key: str) -> str:
    element = joint.find(tag)
    value = None if element is None else element.get(key)
    if value is None:
        raise ValueError(f"joint {joint.get('name')}: needs <{tag} {key}=...>")
    return value


URDF = Path("config", "robots", "lbr_iiwa.urdf")
JOINTS = 7
COLUMNS = ["time", *(f"joint_{j}" for j in range(1, JOINTS + 1))]
LOOK = 1e-3  # [s] sampling interval of the check of a swing's speed


class Part(NamedTuple):
    """A primitive that represents a link, alone or with others."""

    name: str
    link: int  # 0: the foot, which cannot move; j: turns with joint j
    center: tuple[float, float, float]  # [m], in the link's frame
    shape: Shape


def _ball(link: int, which: str, center: tuple[float, float, float], radius: float) -> Part:
    return Part(f"arm link {link}{which}", link, center, Shape("sphere", radius=radius))


# Fitted by eye into the extents of the robot's own link meshes; mesh vertices lie no farther than 3.5 cm outside them.
# The URDF shows the same parts.
PARTS = (
    Part("arm foot", 0, (0.0, 0.0, 0.079), Shape("box", size=(0.24, 0.24, 0.158))),
    _ball(1, "a", (0.0, 0.0, 0.07), 0.085),
    _ball(1, "b", (0.0, -0.025, 0.20), 0.09),
    _ball(2, "a", (0.0, 0.0, 0.05), 0.085),
    _ball(2, "b", (0.0, 0.13, 0.01), 0.075),
    _ball(3, "a", (0.0, 0.0, 0.055), 0.07),
    _ball(3, "b", (0.0, 0.035, 0.205), 0.075),
    _ball(4, "a", (0.0, 0.0, 0.035), 0.075),
    _ball(4, "b", (0.0, 0.12, 0.01), 0.072),
    _ball(5, "a", (0.0, 0.0, 0.04), 0.07),
    _ball(5, "b", (0.0, 0.05, 0.13), 0.05),
    _ball(5, "c", (0.0, 0.075, 0.215), 0.05),
    _ball(6, "", (0.0, 0.0, 0.0), 0.075),
    _ball(7, "", (0.0, 0.0, 0.02), 0.052),
    Part("arm tool", 7, (0.0, 0.0, 0.115), Shape("box", size=(0.08, 0.08, 0.14))),
)
MOVING = PARTS[1:]


@documented
class ArmSettings(NamedTuple):
    """Limits of the arm's joints, and the stiffness with which it holds its parts.

    Fields:
      speed_limit: [rad/s] of a joint; the URDF's own limit counts as well
      acceleration_limit: [rad/s2] of a joint on its way to a commanded angle
      force_limit: [N] with which the arm holds each of its parts, and so pushes
      frequency: [Hz] natural frequency of a part about its place: the arm's stiffness
      damping_ratio: of that motion; 1: critical
      lag_limit: [m] joints wait for a part that lags this far
    """

    speed_limit: float = 3.0
    acceleration_limit: float = 15.0
    force_limit: float = 500.0
    frequency: float = 25.0
    damping_ratio: float = 1.0
    lag_limit: float = 0.03


class Arm(NamedTuple):
    """An arm in a scene."""

    settings: ArmSettings
    position: np.ndarray  # (3,) [m] of its foot, world
    orientation: np.ndarray  # (4,) unit quaternion x y z w
    times: np.ndarray  # (k,) [s], ascending, of its swing
    angles: np.ndarray  # (k, 7) [rad] of the joints then; monotone cubics between, the nearest row outside

    def standing(self) -> Arm:
        """The same arm without its swing: it keeps its first angles until commanded."""
        return self._replace(times=self.times[:1], angles=self.angles[:1])

    def swing(self) -> Callable[[float], np.ndarray]:
        """The function from time [s] to angles (7,) [rad]."""
        first, last = self.times[0], self.times[-1]
        if first == last:
            return lambda _time: self.angles[0]
        curve = _curve(self)
        return lambda time: curve(min(max(time, first), last))


class ArmKinematics:
    """Poses of an arm's parts from its joint angles."""

    def __init__(self, position: np.ndarray, orientation: np.ndarray) -> None:
        self._position, self._orientation = position, orientation
        self._chain = read_chain(_file())
        self._links = np.array([part.link - 1 for part in MOVING])
        self._centers = np.array([part.center for part in MOVING])

    @property
    def limits(self) -> JointLimits:
        """Names and limits of the joints, in their order."""
        return self._chain.limits

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the links, from the foot, which does not move."""
        return self._chain.links

    def transforms(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Origins (7, 3) [m] and orientations (7, 4) of the links that move, each in the frame of the link before."""
        return self._chain.places, joint_turns(self._chain, angles)

    def places(self, angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Centres (n, 3) [m] and orientations (n, 4) of the parts that move, in their order; world frame."""
        origins, turns = link_frames(self._chain, self._position, self._orientation, angles)
        origins, turns = origins[self._links], turns[self._links]
        return origins + turned(rotation_matrices(turns), self._centers), turns


def joint_limits() -> JointLimits:
    """Joint limits, independent of the arm's pose."""
    return ArmKinematics(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])).limits


def robot_description() -> str:
    """The arm's URDF; it has no meshes, so any machine can show it."""
    return _file().read_text()


def parse_arm(fields: Fields, folder: Path | None) -> Arm:
    """`swing` is a CSV file beside the scene, or a list of its rows: a time [s] and seven angles [degrees]."""
    settings = ArmSettings(**fields.numbers(ArmSettings, above=ArmSettings._fields))
    position = fields.vector("position", "[m] of its foot", 3, (0.0, 0.0, 0.0))
    rotation = fields.vector("rotation", f"[degrees] of its foot, {ROTATION}", 3, (0.0, 0.0, 0.0))
    orientation = from_euler_angles(DEGREE * rotation)
    words = "rows of time [s] and seven joint angles [degrees]; it stands as in the first row until then"
    rows, _ = fields.timed_rows("swing", words, COLUMNS, folder)
    fields.finish()
    arm = Arm(settings, position, orientation, rows[:, 0].copy(), DEGREE * rows[:, 1:])
    _require_possible(arm, joint_limits(), fields.name("swing"))
    return arm


def require_within(limits: JointLimits, angles: Sequence[float] | np.ndarray) -> None:
    """Raise ValueError if one of the seven `angles` [rad] is beyond its joint's limits."""
    for name, angle, lower, upper in zip(limits.names, angles, limits.lower, limits.upper, strict=True):
        if not lower <= angle <= upper:
            raise ValueError(f"{name}: {angle:.4g} rad is not between {lower:.4g} and {upper:.4g} rad")


def _file() -> Path:
    return share_directory() / URDF


def _require_possible(arm: Arm, limits: JointLimits, path: str) -> None:
    for i, angles in enumerate(arm.angles):
        try:
            require_within(limits, angles)
        except ValueError as error:
            raise SceneError(f"{path}[{i}]: {error}") from error
    if len(arm.times) == 1:
        return
    times = np.arange(arm.times[0], arm.times[-1], LOOK)
    speeds = np.abs(_curve(arm)(times, 1))
    most = np.minimum(limits.speeds, arm.settings.speed_limit)
    when, joint = np.unravel_index(np.argmax(speeds / most), speeds.shape)
    if speeds[when, joint] > most[joint]:
        raise SceneError(
            f"{path}: {limits.names[joint]} turns with {speeds[when, joint]:.3g} rad/s at {times[when]:.3g} s, more"
            f" than {most[joint]:.3g} rad/s"
        )


def _curve(arm: Arm) -> Any:
    """Monotone from row to row, so within the joints' limits as its rows are. Begins and ends at rest."""
    from scipy.interpolate import PchipInterpolator  # late: half a second

    times = np.concatenate((arm.times[:1] - 1.0, arm.times, arm.times[-1:] + 1.0))
    return PchipInterpolator(times, np.concatenate((arm.angles[:1], arm.angles, arm.angles[-1:])))

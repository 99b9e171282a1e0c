"""Robots of URDF files in a scene: what the file and the scene's field `robot` describe, and the protocol of an engine.

A robot is a tree of links on a fixed base. Each collision shape of a link is a body of the collision service, in the
frame of the shape; those of links that no joint moves are static. `bullet_robot` moves the others.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Protocol
from xml.etree import ElementTree

import numpy as np

from fracture_collision.extras import need
from fracture_collision.geometry import round_solids
from fracture_collision.portable_math import cosine, lengths, sine
from fracture_collision.simulation.actors.joint_goals import JointLimits
from fracture_collision.simulation.config.scene_fields import (
    MAX_TRACK_BYTES,
    ROTATION,
    Fields,
    SceneError,
    quoted,
    read_text,
)
from fracture_collision.simulation.config.shapes import Shape
from fracture_collision.simulation.engine import FrameState
from fracture_collision.simulation.rotations import DEGREE, from_euler_angles, quaternion_products, turned_by


class Push(NamedTuple):
    """An impulse on a link in a step."""

    link: int  # as in Robot.links
    impulse: np.ndarray  # (3,) [N s], world axes
    point: np.ndarray  # (3,) [m] where it acts, world


class JointStates(NamedTuple):
    """Of k joints that move."""

    names: tuple[str, ...]
    angles: np.ndarray  # (k,) [rad]; of a prismatic joint [m]
    speeds: np.ndarray  # (k,) [rad/s], [m/s]
    torques: np.ndarray  # (k,) [N m], [N] of the motors in the last step


class Robot(Protocol):
    """A robot with an engine of its own, stepped together with that of the other bodies.

    Frames are FrameState of arrays: a row for each of the m bodies, in the order of `fragment_ids`.
    """

    fragment_ids: np.ndarray  # (m,) uint32, ascending, of the bodies that move with the robot's links
    links: np.ndarray  # (m,) int64, of each the link; equal numbers move as one

    def frames(self) -> FrameState:
        """Present frames of its bodies."""

    def trial(self, pushes: Sequence[Push]) -> FrameState:
        """The frames after a step with motors and `pushes`; the robot stays as it is."""

    def commit(self, pushes: Sequence[Push]) -> None:
        """Take the step."""

    @property
    def limits(self) -> JointLimits:
        """Of the joints that take commands: those with a motor."""

    def command(self, names: Sequence[str], positions: Sequence[float]) -> None:
        """Move joints to `positions` from now on, as in JointGoals.commanded; the others stay. Raises ValueError."""

    def joints(self) -> JointStates:
        """Present angles and speeds, and the torques of the last step."""

    def close(self) -> None:
        """Release the engine's resources."""


class Track(NamedTuple):
    """Values over time, linear from row to row; the nearest row's outside."""

    times: np.ndarray  # (k,) [s], ascending
    values: np.ndarray  # (k,) [rad], [rad/s]; of a prismatic joint [m], [m/s]

    def at(self, time: float) -> tuple[float, float]:
        """The value at `time` [s], and its rate from then on [1/s]."""
        i = int(np.searchsorted(self.times, time, side="right")) - 1
        if i < 0 or i + 1 >= len(self.times):
            return float(self.values[min(max(i, 0), len(self.times) - 1)]), 0.0
        rate = float((self.values[i + 1] - self.values[i]) / (self.times[i + 1] - self.times[i]))
        return float(self.values[i]) + (time - float(self.times[i])) * rate, rate


class Motor(NamedTuple):
    """What drives a joint."""

    joint: str
    controls_position: bool  # else speed
    track: Track  # of the joint's angle, or speed
    torque: float  # [N m], [N] at most
    position_gain: float  # share of the position error that it takes out in a step
    velocity_gain: float  # likewise of the velocity error


class LinkShape(NamedTuple):
    """A collision shape."""

    body: str  # name of its body in the scene
    link: str
    position: np.ndarray  # (3,) [m] in the link's frame
    orientation: np.ndarray  # (4,) unit quaternion x y z w, likewise
    shape: Shape
    is_static: bool  # no joint moves the link


class RobotPlan(NamedTuple):
    """A robot in a scene."""

    urdf: Path
    position: np.ndarray  # (3,) [m] of its base link, world
    orientation: np.ndarray  # (4,) unit quaternion x y z w
    motors: tuple[Motor, ...]
    shapes: tuple[LinkShape, ...]
    speed_limit: float  # [rad/s], [m/s] of a joint on its way to a commanded angle
    acceleration_limit: float  # [rad/s2], [m/s2] likewise

    def standing(self) -> RobotPlan:
        """The same robot without its tables: its motors hold where it begins until commanded."""
        start = self.start_angles()
        held = (
            motor._replace(
                controls_position=True, track=Track(np.zeros(1), np.array([start.get(motor.joint, 0.0)]))
            )
            for motor in self.motors
        )
        return self._replace(motors=tuple(held))

    def limits(self) -> JointLimits:
        """Of the joints with a motor, in the order of the URDF file."""
        driven = {motor.joint for motor in self.motors}
        joints = [joint for joint in read_urdf(self.urdf).moving() if joint.name in driven]
        lower, upper, speeds = (np.array([each[k] for each in (j.limits for j in joints)]) for k in range(3))
        names = tuple(joint.name for joint in joints)
        units, speeds = tuple(UNITS[joint.kind] for joint in joints), np.minimum(speeds, self.speed_limit)
        return JointLimits(names, lower, upper, speeds, self.acceleration_limit, units)

    def description(self) -> str:
        """The URDF, with the motors' torques as limits of effort, 0 without a motor."""
        tree = ElementTree.fromstring(read_text(self.urdf, MAX_TRACK_BYTES))
        torques = {motor.joint: motor.torque for motor in self.motors}
        for joint in tree.findall("joint"):
            for limit in joint.findall("limit"):
                limit.set("effort", f"{torques.get(joint.get('name', ''), 0.0):g}")
        return ElementTree.tostring(tree, encoding="unicode")

    def start_angles(self) -> dict[str, float]:
        """Angles [rad], [m] of the joints with a motor for their position, at the start; others begin at 0."""
        return {motor.joint: motor.track.at(0.0)[0] for motor in self.motors if motor.controls_position}

    def start_frames(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Position (3,) [m] and orientation (4,) of each shape at the start; world frame."""
        links = _link_frames(read_urdf(self.urdf), self.position, self.orientation, self.start_angles())
        return [_moved(links[shape.link], shape.position, shape.orientation) for shape in self.shapes]


# Joints that turn, joints that slide; "fixed" ones do neither.
TURNING, SLIDING = ("revolute", "continuous"), ("prismatic",)
UNITS = {**dict.fromkeys(TURNING, "rad"), **dict.fromkeys(SLIDING, "m")}  # of joint positions
BODY_PREFIX = "robot "  # of the names of its shapes as bodies
_Frame = tuple[np.ndarray, np.ndarray]


class Joint(NamedTuple):
    """A joint of a URDF file."""

    name: str
    kind: str
    parent: str
    child: str
    position: np.ndarray  # (3,) [m] in the parent's frame
    orientation: np.ndarray  # (4,) unit quaternion x y z w, likewise
    axis: np.ndarray  # (3,) unit, in the joint's frame
    damping: float  # [N m s/rad], [N s/m]
    limits: tuple[float, float, float, float]  # lower, upper [rad], [m], speed, effort; inf without

    def frame(self, angle: float) -> _Frame:
        """The frame of its child in that of its parent, at `angle` [rad], [m]."""
        place, turn = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        if self.kind in TURNING:
            half = np.array(0.5 * angle)
            turn = np.append(float(sine(half)) * self.axis, float(cosine(half)))
        elif self.kind in SLIDING:
            place = angle * self.axis
        return _moved((self.position, self.orientation), place, turn)


class Urdf(NamedTuple):
    """The tree of a URDF file."""

    root: str  # the base link
    joints: tuple[Joint, ...]  # each after that of its parent link
    shapes: tuple[tuple[str, np.ndarray, np.ndarray, ElementTree.Element], ...]  # link, position, orientation, element

    def moving(self) -> tuple[Joint, ...]:
        """The joints that are not fixed."""
        return tuple(joint for joint in self.joints if joint.kind != "fixed")

    def fixed_links(self) -> set[str]:
        """Links that no joint moves."""
        fixed = {self.root}
        for joint in self.joints:
            if joint.kind == "fixed" and joint.parent in fixed:
                fixed.add(joint.child)
        return fixed


def read_urdf(file: Path) -> Urdf:
    """The links and joints of a URDF file. ValueError, with an explanation, if they do not form one tree."""
    return parse_urdf(read_text(file, MAX_TRACK_BYTES), str(file))


def parse_urdf(text: str, file: str) -> Urdf:
    """As read_urdf, of the content of `file`."""
    try:
        robot = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise ValueError(f"{file}: {error}") from error
    links = [link.get("name", "") for link in robot.findall("link")]
    found = {joint.child: joint for joint in map(_joint, robot.findall("joint"))}
    roots = [link for link in links if link not in found]
    if len(roots) != 1 or any(joint.parent not in links or joint.child not in links for joint in found.values()):
        raise ValueError(f"{file}: needs one tree of links, got {len(roots)} without a parent")
    order = [roots[0]]
    for link in order:
        order += [joint.child for joint in found.values() if joint.parent == link]
    if len(order) < len(links):
        raise ValueError(f"{file}: its joints form a loop")
    shapes = [
        (link.get("name", ""), *_origin(element), shape)
        for link in robot.findall("link") for element in link.findall("collision")
        for geometry in element.findall("geometry") for shape in geometry
    ]  # fmt: skip
    return Urdf(roots[0], tuple(found[link] for link in order[1:]), tuple(shapes))


def parse_robot(fields: Fields, folder: Path | None) -> RobotPlan:
    """`urdf` is a file beside the scene, or of pybullet_data: MissingExtra if that is not installed. SceneError."""
    name = fields.text("urdf", "URDF file beside the scene, or a name of pybullet_data: kuka_iiwa/model.urdf")
    position = fields.vector("position", "[m] of its base link", 3, (0.0, 0.0, 0.0))
    rotation = fields.vector("rotation", f"[degrees] of its base link, {ROTATION}", 3, (0.0, 0.0, 0.0))
    try:
        file = _find(name, folder)
        urdf = read_urdf(file)
        shapes = _shapes(urdf, file)
    except (ValueError, OSError) as error:
        raise SceneError(f"{fields.name('urdf')}: {error}") from error
    motors = tuple(
        _motor(Fields(each, f"{fields.name('motors')}[{i}]"), urdf, folder)
        for i, each in enumerate(fields.sequence("motors", "its motors; a joint without one turns freely"))
    )
    for i, motor in enumerate(motors):
        if motor.joint in [other.joint for other in motors[:i]]:
            raise SceneError(f"{fields.name('motors')}[{i}].joint: {quoted(motor.joint)} has a motor already")
    words = "of a joint on its way to a commanded angle; of a prismatic joint [m/s"
    speed = fields.number("speed_limit", f"[rad/s] {words}]; the URDF's own limit counts as well", 3.0, above=0.0)
    acceleration = fields.number("acceleration_limit", f"[rad/s2] {words}2]", 15.0, above=0.0)
    fields.finish()
    return RobotPlan(file, position, from_euler_angles(DEGREE * rotation), motors, shapes, speed, acceleration)


def _motor(fields: Fields, urdf: Urdf, folder: Path | None) -> Motor:
    moving = {joint.name: joint for joint in urdf.moving()}
    name = fields.text("joint", "of the URDF file")
    if name not in moving:
        raise SceneError(f"{fields.name('joint')}: no joint {quoted(name)}; there are {', '.join(moving)}")
    given = [key for key in ("position", "velocity") if key in fields.keys()]  # noqa: SIM118
    if len(given) != 1:
        raise SceneError(f"{fields.name('')[:-1]}: needs position or velocity, got {' and '.join(given) or 'neither'}")
    unit = "[s] and {} or, of a prismatic joint, {}; linear between. Either this or {}"
    words = {
        "position": unit.format("angle [degrees]", "[m]", "velocity"),
        "velocity": unit.format("speed [degrees/s]", "[m/s]", "position"),
    }
    rows, _ = fields.timed_rows(given[0], f"rows of time {words[given[0]]}", ["time", given[0]], folder)
    scale = DEGREE if moving[name].kind in TURNING else 1.0
    motor = Motor(
        name, given[0] == "position", Track(rows[:, 0].copy(), scale * rows[:, 1]),
        fields.number("torque", "[N m] at most; of a prismatic joint [N]", minimum=0.0),
        fields.number("position_gain", "share of the position error that it takes out in a step", 0.3, minimum=0.0),
        fields.number("velocity_gain", "share of the velocity error that it takes out in a step", 1.0, minimum=0.0),
    )  # fmt: skip
    fields.finish()
    return motor


def _find(name: str, folder: Path | None) -> Path:
    file = (folder or Path()) / name
    if file.is_file():
        return file
    need("bullet", f"no file {file}; a robot of pybullet_data")
    import pybullet_data

    packaged = Path(pybullet_data.getDataPath(), name)
    if not packaged.is_file():
        raise ValueError(f"{name}: no such file, neither in {folder or Path()} nor in pybullet_data")
    return packaged


def _joint(element: ElementTree.Element) -> Joint:
    kind, name = element.get("type", ""), element.get("name", "")
    if kind not in (*TURNING, *SLIDING, "fixed"):
        raise ValueError(f"joint {name}: its type {quoted(kind)} is none of {', '.join((*TURNING, *SLIDING))}, fixed")
    axis = _numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0))
    size = float(lengths(axis))
    if not size > 0.0:
        raise ValueError(f"joint {name}: its axis is 0")
    parent, child = element.find("parent"), element.find("child")
    if parent is None or child is None:
        raise ValueError(f"joint {name}: needs a parent and a child link")
    damping = float(_numbers(element.find("dynamics"), "damping", (0.0,))[0])
    ends = parent.get("link", ""), child.get("link", "")
    limit = element.find("limit")
    turns = kind == "continuous"
    defaults = {"lower": -math.inf, "upper": math.inf, "velocity": math.inf, "effort": math.inf}
    lower, upper, speed, effort = (
        default if limit is None or limit.get(key) is None or (turns and key in ("lower", "upper"))
        else float(_numbers(limit, key, (0.0,))[0])
        for key, default in defaults.items()
    )  # fmt: skip
    return Joint(name, kind, *ends, *_origin(element), axis / size, damping, (lower, upper, speed, effort))


def _origin(element: ElementTree.Element) -> _Frame:
    origin = element.find("origin")
    still = (0.0, 0.0, 0.0)
    return _numbers(origin, "xyz", still), from_euler_angles(_numbers(origin, "rpy", still))


def _numbers(element: ElementTree.Element | None, key: str, default: tuple[float, ...]) -> np.ndarray:
    text = None if element is None else element.get(key)
    numbers = default if text is None else tuple(float(number) for number in text.split())
    if len(numbers) != len(default) or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{key}: needs {len(default)} finite numbers, got {quoted(text)}")
    return np.array(numbers)


def _shapes(urdf: Urdf, file: Path) -> tuple[LinkShape, ...]:
    fixed, made, names = urdf.fixed_links(), [], []
    for link, position, orientation, element in urdf.shapes:
        names.append(link)
        count = names.count(link)
        name = f"{BODY_PREFIX}{link}" if count == 1 else f"{BODY_PREFIX}{link} {count}"
        made.append(LinkShape(name, link, position, orientation, _shape(element, file, link), link in fixed))
    if not made:
        raise ValueError(f"{file}: its links have no collision shapes")
    return tuple(made)


def _shape(element: ElementTree.Element, file: Path, link: str) -> Shape:
    if element.tag == "box":
        return Shape("box", size=tuple(_positive(element, "size", 3)))
    if element.tag == "sphere":
        return Shape("sphere", radius=_positive(element, "radius", 1)[0])
    if element.tag == "cylinder":
        (height,), (radius,) = _positive(element, "length", 1), _positive(element, "radius", 1)
        return Shape("cylinder", size=(height, radius), surface=round_solids.cylinder(height, radius))
    if element.tag == "mesh":
        return _hull(_mesh_file(element.get("filename", ""), file), _numbers(element, "scale", (1.0, 1.0, 1.0)))
    raise ValueError(f"link {link}: {element.tag} is none of box, sphere, cylinder, mesh")


def _positive(element: ElementTree.Element, key: str, count: int) -> list[float]:
    numbers = _numbers(element, key, (0.0,) * count).tolist()
    if not min(numbers) > 0.0:
        raise ValueError(f"{element.tag} {key}: needs more than 0, got {numbers}")
    return numbers


def _mesh_file(name: str, urdf: Path) -> Path:
    """A mesh's path is relative to the URDF file; package://P/... to the nearest folder above it that has it."""
    inner = name.removeprefix("file://").removeprefix("package://")
    found = [folder / inner for folder in urdf.resolve().parents if (folder / inner).is_file()]
    if not found:
        raise ValueError(f"mesh {quoted(name)}: no such file beside {urdf}")
    return found[0]


def _hull(file: Path, scale: np.ndarray) -> Shape:
    need("meshing", "a robot whose links have meshes")
    import trimesh

    mesh: Any = trimesh.load(file, force="mesh")
    mesh.apply_scale(scale)
    hull = mesh.convex_hull
    return Shape("hull", surface=(np.array(hull.vertices, np.float64), np.array(hull.faces, np.int64)))


def _link_frames(
    urdf: Urdf, position: np.ndarray, orientation: np.ndarray, angles: Mapping[str, float]
) -> dict[str, _Frame]:
    """Frames of all links by name, given that of the base link and the joints' angles [rad], [m], 0 without."""
    frames: dict[str, _Frame] = {urdf.root: (position, orientation)}
    for joint in urdf.joints:
        frames[joint.child] = _moved(frames[joint.parent], *joint.frame(angles.get(joint.name, 0.0)))
    return frames


def _moved(frame: _Frame, position: np.ndarray, orientation: np.ndarray) -> _Frame:
    """A frame given in another one; world frame."""
    at, turn = frame
    return at + turned_by(turn, position), quaternion_products(turn[None], orientation[None])[0]

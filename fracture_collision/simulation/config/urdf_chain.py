"""A URDF file: its chain of revolute joints, the frames of its links for given joint angles, its text for others.

Forward kinematics: the frame of link j is that of link j - 1, moved by the joint's `origin` and turned about its
`axis` by the joint's angle (REP-103 axes; URDF's rpy are rotations about fixed x, y, z axes in this order).
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from fracture_collision.portable_math import cosine, lengths, sine
from fracture_collision.simulation.rotations import from_euler_angles, quaternion_products, turned_by


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

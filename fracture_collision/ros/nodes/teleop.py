"""Publishes keys of a terminal as cmd_vel, for the hammer of a live scene or any other subscriber.

A terminal reports key presses, repeatedly while a key is held, but no releases. So a key moves the hammer until no
other has come for a while, longer than a keyboard's delay before it repeats.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import rclpy
from geometry_msgs.msg import Twist, Vector3
from rclpy.duration import Duration
from rclpy.node import Node

from fracture_collision.ros.processes.own_context import own_context
from fracture_collision.ros.wire import qos

HOLD = 0.6  # [s] a key moves for
LAST_WORD = Duration(seconds=1)  # for all subscribers to acknowledge the final stop
RESEND = 0.05  # [s] between two commands while a key moves
# key codes -> direction (x, y, z) in the world: x to the right, y away, z up as the scenes stand
DIRECTIONS = {
    b"\x1b[C": (1, 0, 0), b"\x1b[D": (-1, 0, 0), b"\x1b[A": (0, 1, 0), b"\x1b[B": (0, -1, 0),
    b"\x1bOC": (1, 0, 0), b"\x1bOD": (-1, 0, 0), b"\x1bOA": (0, 1, 0), b"\x1bOB": (0, -1, 0),
    b"d": (1, 0, 0), b"a": (-1, 0, 0), b"w": (0, 1, 0), b"s": (0, -1, 0),
    b"\x1b[5~": (0, 0, 1), b"\x1b[6~": (0, 0, -1), b"r": (0, 0, 1), b"f": (0, 0, -1),
}  # fmt: skip
FASTER, SLOWER, STOP, END = b"+", b"-", b" ", (b"q", b"\x03", b"\x04")
STEP = 1.25  # factor of the speed, for each key press
SPEEDS = (0.05, 4.0)  # [m/s]


class Told(NamedTuple):
    """The current state."""

    direction: tuple[int, int, int]  # zeros: at rest
    speed: float  # [m/s]
    listeners: int


def split_keys(data: bytes) -> list[bytes]:
    """Key codes in a terminal's input; an escape sequence is one."""
    keys = []
    while data:
        known = max((code for code in DIRECTIONS if data.startswith(code)), key=len, default=data[:1])
        keys.append(known)
        data = data[len(known) :]
    return keys


def drive(domain_id: int, namespace: str, speed: float, told: Callable[[Told], None]) -> None:
    """Reads keys from stdin, a terminal, until an end key; leaves the hammer at rest."""
    context = own_context(domain_id)
    node = rclpy.create_node("teleop", context=context, namespace=namespace or None)
    try:
        _drive(node, speed, told)
    finally:
        node.destroy_node()
        context.try_shutdown()


def _drive(node: Node, speed: float, told: Callable[[Told], None]) -> None:
    topic = qos.CMD_VEL
    publisher = node.create_publisher(topic.message_class, topic.name, topic.qos)
    direction, left = (0, 0, 0), 0.0
    try:
        with _key_by_key(sys.stdin.fileno()) as keys:
            while rclpy.ok(context=node.context):
                told(Told(direction, speed, publisher.get_subscription_count()))
                came = keys(RESEND)
                if any(key in END for key in came):
                    return
                left -= RESEND
                for key in came:
                    if key in (FASTER, SLOWER):
                        speed = min(max(speed * (STEP if key == FASTER else 1.0 / STEP), SPEEDS[0]), SPEEDS[1])
                    elif key == STOP:
                        direction, left = (0, 0, 0), 0.0
                    elif key in DIRECTIONS:
                        direction, left = DIRECTIONS[key], HOLD
                if left <= 0.0:
                    direction = (0, 0, 0)
                publisher.publish(_twist(direction, speed))
    finally:
        publisher.publish(Twist())
        publisher.wait_for_all_acked(LAST_WORD)


def _twist(direction: tuple[int, int, int], speed: float) -> Twist:
    x, y, z = (speed * part for part in direction)
    return Twist(linear=Vector3(x=x, y=y, z=z))


@contextmanager
def _key_by_key(descriptor: int) -> Iterator[Callable[[float], list[bytes]]]:
    """Switches a terminal to input key by key, without echo."""
    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)

    def keys(seconds: float) -> list[bytes]:
        ready, _, _ = select.select([descriptor], [], [], seconds)
        data = os.read(descriptor, 1024) if ready else None
        if data == b"":
            return [END[0]]  # the terminal is gone
        return split_keys(data or b"")

    try:
        yield keys
    finally:
        termios.tcsetattr(descriptor, termios.TCSADRAIN, before)

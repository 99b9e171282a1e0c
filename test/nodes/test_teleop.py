"""`fracture-collision teleop`: keys from a pseudo-terminal become velocities."""

from __future__ import annotations

import os
import pty
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import suppress

import pytest
from click.testing import CliRunner
from stages.ros_client import ServiceClient

from fracture_collision.cli.commands import main
from fracture_collision.ros.nodes.teleop import split_keys
from fracture_collision.ros.processes.node_process import free_domain_id, loopback_environment
from fracture_collision.ros.wire import qos


class Terminal:
    """A keyboard on a pseudo-terminal, and a node subscribed to the velocities."""

    def __init__(self) -> None:
        domain_id = free_domain_id()
        self.ears = ServiceClient(domain_id)
        self.said: list[tuple[float, float, float]] = []
        topic = qos.CMD_VEL
        self.ears.node.create_subscription(topic.message_class, topic.name, self._hear, 10)
        self._keyboard, inside = pty.openpty()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fracture_collision.cli", "teleop", "--speed", "0.5"], stdin=inside, stdout=inside,
            stderr=subprocess.STDOUT, env=loopback_environment(domain_id) | {"TERM": "xterm"}, start_new_session=True,
        )  # fmt: skip
        os.close(inside)
        os.set_blocking(self._keyboard, False)
        self.shown = b""
        self.until(lambda: b"subscribers: 1" in self.shown, "somebody who listens")

    def _hear(self, message) -> None:
        self.said.append((message.linear.x, message.linear.y, message.linear.z))

    def press(self, keys: bytes) -> None:
        os.write(self._keyboard, keys)

    def until(self, condition: Callable[[], bool], what: str) -> None:
        def look() -> bool:
            with suppress(OSError):  # nothing to read, or the process has ended
                self.shown += os.read(self._keyboard, 1 << 16)
            return condition()

        self.ears.spin_until(look, what)

    def hears(self, velocity: tuple[float, float, float]) -> None:
        self.said.clear()
        self.until(lambda: velocity in self.said, f"{velocity}")

    def ended(self) -> int:
        self.until(lambda: self.process.poll() is not None, "its end")
        return self.process.returncode

    def close(self) -> None:
        self.process.kill()
        self.process.wait()
        os.close(self._keyboard)
        self.ears.close()


@pytest.fixture
def terminal() -> Iterator[Terminal]:
    made = Terminal()
    yield made
    made.close()


def test_keys_drive_while_they_are_pressed(terminal: Terminal) -> None:
    terminal.press(b"\x1b[A")
    terminal.hears((0.0, 0.5, 0.0))
    terminal.hears((0.0, 0.0, 0.0))  # no key is pressed any more
    terminal.press(b"+\x1b[5~")
    terminal.hears((0.0, 0.0, 0.625))
    terminal.press(b"a")
    terminal.hears((-0.625, 0.0, 0.0))
    terminal.press(b" ")
    terminal.hears((0.0, 0.0, 0.0))
    terminal.press(b"q")
    assert terminal.ended() == 0
    assert b"Traceback" not in terminal.shown


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_the_last_command_is_to_stop(terminal: Terminal, order: signal.Signals) -> None:
    terminal.press(b"d")
    terminal.hears((0.5, 0.0, 0.0))
    terminal.process.send_signal(order)
    assert terminal.ended() == 0
    terminal.until(lambda: terminal.said[-1] == (0.0, 0.0, 0.0), "a stop")
    assert b"Traceback" not in terminal.shown


def test_keys_that_arrive_together_are_separated() -> None:
    assert split_keys(b"\x1b[Aw\x1bOC\x1b[6~x") == [b"\x1b[A", b"w", b"\x1bOC", b"\x1b[6~", b"x"]


def test_teleop_without_a_terminal_reports_an_error() -> None:
    answer = CliRunner().invoke(main, ["teleop"])
    assert answer.exit_code == 2 and "terminal" in answer.output

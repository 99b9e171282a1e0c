"""How every node's process starts and ends.

rclpy shuts its context down on SIGINT and SIGTERM, and then calls the handler that was there before: Python's own,
which raises KeyboardInterrupt between any two bytecodes. Inside numba that may crash (see cli/console.py). So a handler
that raises nothing is installed instead, and a node ends at its next call of rclpy.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType
from typing import TypeVar

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from fracture_collision.process import full_disk
from fracture_collision.process.full_disk import full_disk_words
from fracture_collision.ros.processes.node_help import answer_to, fault_of_arguments, name_of
from fracture_collision.ros.processes.parameters import warn_of_unknown
from fracture_collision.ros.processes.shared_memory import remove_dead_segments
from fracture_collision.ros.processes.this_machine import keep_to_this_machine

AnyNode = TypeVar("AnyNode", bound=Node)

# [s] From SIGINT or SIGTERM, or from the end of the node's work, to the end of its process, whatever DDS does.
LONGEST_END = 10.0


class Fatal(RuntimeError):
    """The node cannot continue; its text is all that the user needs to see."""


_nothing_to_lose = False


@contextmanager
def nothing_to_lose() -> Iterator[None]:
    """While kernels load, which takes minutes with a cold cache: a signal ends the process at once."""
    global _nothing_to_lose
    _nothing_to_lose = True
    try:
        yield
    finally:
        _nothing_to_lose = False


def age_of(pid: int) -> float:
    """[s] since a process was started, in ticks of 10 ms. Raises OSError if there is none."""
    words = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    started = int(words[19])  # [ticks since boot]: field 22 of proc(5)
    return time.clock_gettime(time.CLOCK_BOOTTIME) - started / os.sysconf("SC_CLK_TCK")


def _on_signal(_signal: int, _frame: FrameType | None) -> None:
    if _nothing_to_lose:
        os._exit(0)


def _end_in_time() -> None:
    """Ends the process with status 1 after LONGEST_END, if it still runs, and prints the traceback of each thread.

    Does not need the interpreter: a call into DDS may not return.
    """
    faulthandler.dump_traceback_later(LONGEST_END, exit=True)


def _watch_signals() -> None:
    """Calls `_end_in_time` on SIGINT and SIGTERM.

    It also does while the main thread is in a call that does not return and Python's own handlers are not called.
    """
    heard, told = socket.socketpair()
    told.setblocking(False)
    signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)

    def watch() -> None:
        with told:  # must stay open as long
            while not set(heard.recv(64)) & {signal.SIGINT, signal.SIGTERM}:
                pass
            _end_in_time()
            threading.Event().wait()

    threading.Thread(target=watch, daemon=True, name="signals").start()


def run_node(make_node: Callable[[], AnyNode], work: Callable[[AnyNode], None]) -> int:
    """Runs `work` on a node of the class `make_node`; returns the process's exit status.

    If the arguments request help or the version it prints these (node_help.py), and creates no node. Arguments that
    rclpy would ignore are rejected with status 2.

    SIGINT and SIGTERM end it cleanly, with status 0: they are the usual way to stop a node. A process that still runs
    LONGEST_END later ends with status 1. A full disk: full_disk.STATUS.
    """
    if (answer := answer_to(make_node, sys.argv[1:])) is not None:
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # a pager may end first
        print(answer)
        return 0
    if fault := fault_of_arguments(sys.argv[1:]):
        print(f"{name_of(make_node)}: {fault}", file=sys.stderr)
        return 2
    for order in (signal.SIGINT, signal.SIGTERM):
        signal.signal(order, _on_signal)
    _watch_signals()
    remove_dead_segments()  # of a killed node that this one may replace
    keep_to_this_machine(os.environ)
    try:
        rclpy.init()
    except (rclpy_implementation.RCLError, rclpy_implementation.UnknownROSArgsError) as error:
        print(f"{name_of(make_node)}: {error}", file=sys.stderr)
        return 1
    node = None
    try:
        node = make_node()
        warn_of_unknown(node)
        work(node)
        return 0
    except ExternalShutdownException:
        return 0
    except rclpy_implementation.RCLError:
        if rclpy.ok():
            raise
        return 0  # shut down between two calls of rclpy, so that the second failed
    except (Fatal, InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"{node.get_name() if node else name_of(make_node)}: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        if not (words := full_disk_words(error)):
            raise
        with suppress(OSError):  # a log may be on the same disk
            print(f"{node.get_name() if node else name_of(make_node)}: {words}", file=sys.stderr, flush=True)
        return full_disk.STATUS
    finally:
        _end_in_time()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()

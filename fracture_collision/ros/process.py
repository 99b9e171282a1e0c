"""How every node's process starts and ends.

rclpy shuts its context down on SIGINT and SIGTERM, and then calls the handler that was there before: Python's own,
which raises KeyboardInterrupt between any two bytecodes. Where numba is at work that may crash (see cli/console.py).
So a handler that raises nothing stands there instead, and nodes end where they next ask rclpy for something.
"""

from __future__ import annotations

import faulthandler
import os
import signal
import socket
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from fracture_collision.ros.own_ports import fault_of_own_ports
from fracture_collision.ros.parameters import warn_of_unknown
from fracture_collision.ros.shared_memory import remove_left_behind
from fracture_collision.ros.successor_ports import orphaned_ports_held
from fracture_collision.share import share_directory

# [s] From SIGINT or SIGTERM, or from where the node's work is over, to the end of its process, whatever DDS does.
LONGEST_END = 10.0
PORTS_INTERVAL = 1.0  # [s] between two looks at the node's ports
# Looks in a row that find a fault: Fast DDS itself opens a port anew now and then.
FAULTY_LOOKS = 3


class Fatal(RuntimeError):
    """The node cannot go on; its text is all that the user needs to see."""


# Where Fast DDS looks for profiles: version 2, then 3.
_PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")

_nothing_to_lose = False


@contextmanager
def nothing_to_lose() -> Iterator[None]:
    """For loading kernels, which takes minutes where none are in the cache: a signal ends the process at once."""
    global _nothing_to_lose
    _nothing_to_lose = True
    try:
        yield
    finally:
        _nothing_to_lose = False


def _on_signal(_signal: int, _frame: FrameType | None) -> None:
    if _nothing_to_lose:
        os._exit(0)


def _end_in_time() -> None:
    """The process ends with status 1 in LONGEST_END if it has not ended before, and says where each thread was. Takes
    no part of Python to happen: a call into DDS may not come back.
    """
    faulthandler.dump_traceback_later(LONGEST_END, exit=True)


def _watch_signals() -> None:
    """Calls `_end_in_time` on SIGINT and SIGTERM, also while the main thread is in a call that does not come back: then
    Python's own handlers are not called.
    """
    heard, told = socket.socketpair()
    told.setblocking(False)
    signal.set_wakeup_fd(told.fileno(), warn_on_full_buffer=False)

    def watch() -> None:
        with told:  # which has to live as long
            while not set(heard.recv(64)) & {signal.SIGINT, signal.SIGTERM}:
                pass
            _end_in_time()
            threading.Event().wait()

    threading.Thread(target=watch, daemon=True, name="signals").start()


def _has_default_transports() -> bool:
    """Of Fast DDS: those of the user's own profiles, or of other middleware, are not ours to judge."""
    if rclpy.get_rmw_implementation_identifier() != "rmw_fastrtps_cpp":
        return False
    profiles = {os.environ.get(name, "") for name in _PROFILES} - {""}
    if profiles:
        return profiles == {str(_own_profile())}
    return os.environ.get("FASTDDS_BUILTIN_TRANSPORTS", "DEFAULT") == "DEFAULT"


def _watch_ports(node: Node) -> None:
    """Raises Fatal where the node's ports do not work; later, while it spins, from one of its timers."""
    if not _has_default_transports():
        return
    domain_id = node.context.get_domain_id()
    if fault := fault_of_own_ports(domain_id):
        raise Fatal(f"it would receive nothing: {fault}")
    faults = 0

    def look() -> None:
        nonlocal faults
        fault = fault_of_own_ports(domain_id)
        faults = faults + 1 if fault else 0
        if faults >= FAULTY_LOOKS:
            raise Fatal(f"it receives nothing any more: {fault}")

    node.create_timer(PORTS_INTERVAL, look, clock=Clock(clock_type=ClockType.STEADY_TIME))


def _own_profile() -> Path:
    return share_directory() / "config" / "this_machine.xml"


def _choose_profiles() -> None:
    """With ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST Fast DDS uses no other interface than loopback, unless the user has
    profiles of his own; other middleware does not look. The range alone keeps a node from being found; who knows the
    machine's address would still get in.
    """
    is_local = os.environ.get("ROS_AUTOMATIC_DISCOVERY_RANGE") == "LOCALHOST"
    if is_local and not any(os.environ.get(name) for name in _PROFILES):
        os.environ[_PROFILES[0]] = str(_own_profile())


def run_node(make_node: Callable[[], Node], work: Callable[[Node], None]) -> int:
    """Runs `work` on the node that `make_node` makes; returns the process's exit status.

    SIGINT and SIGTERM end it cleanly, with status 0: that is how nodes are told to go. A process that has not ended
    LONGEST_END later ends with status 1, as does one whose ports do not work.
    """
    for order in (signal.SIGINT, signal.SIGTERM):
        signal.signal(order, _on_signal)
    _watch_signals()
    remove_left_behind()  # of one that was killed, and that this one perhaps takes the place of
    _choose_profiles()
    rclpy.init()
    node = None
    try:
        with orphaned_ports_held(rclpy.get_default_context().get_domain_id()):
            node = make_node()
        _watch_ports(node)
        warn_of_unknown(node)
        work(node)
        return 0
    except ExternalShutdownException:
        return 0
    except rclpy_implementation.RCLError:
        if rclpy.ok():
            raise
        return 0  # told to end between two calls of rclpy, and the second could not be made any more
    except (Fatal, InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"{node.get_name() if node else 'node'}: {error}", file=sys.stderr)
        return 1
    finally:
        _end_in_time()
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()

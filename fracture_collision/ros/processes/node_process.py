"""Nodes as child processes on this machine alone: for the command line and for tests."""

from __future__ import annotations

import ctypes
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import IO, Any

from fracture_collision.process.full_disk import REMEDY, STATUS
from fracture_collision.ros.processes.shared_memory import remove_dead_segments
from fracture_collision.ros.processes.this_machine import LOCALHOST, RANGE, as_the_user_has_it

# Domains above this have ports that Linux assigns to any process (REP 2000's "safe on all platforms").
HIGHEST_DOMAIN_ID = 101
# DDSI-RTPS 2.2, 9.6.1.1: the first port of a domain is that of its multicast discovery.
PORT_BASE, PORTS_A_DOMAIN = 7400, 250
_SET_PARENT_DEATH_SIGNAL = 1  # prctl's PR_SET_PDEATHSIG
_SESSION = Path("/proc/self/autogroup")  # of Linux
_TRIES, _AGAIN = 10, 0.05  # [s]
# Domains claimed by this process: more than it uses at a time, and few enough for others to find one.
_MOST_CLAIMS = 8
_claims: deque[socket.socket] = deque()


def free_domain_id() -> int:
    """A ROS domain id that seems unused on this machine. Raises RuntimeError if all are in use.

    Its discovery port is not bound on all interfaces, and no other call of this function has claimed it recently.
    """
    candidates = list(range(1, HIGHEST_DOMAIN_ID + 1))
    random.shuffle(candidates)  # concurrent searches should not find the same one
    for domain_id in candidates:
        # nodes on loopback bind no visible port, so the process that starts them holds a socket name
        claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as discovery:
            try:
                claim.bind(f"\0fracture_collision/domain/{domain_id}")
                discovery.bind(("", PORT_BASE + PORTS_A_DOMAIN * domain_id))
            except OSError:
                claim.close()
                continue
        _claims.append(claim)
        if len(_claims) > _MOST_CLAIMS:
            _claims.popleft().close()
        return domain_id
    raise RuntimeError("all ROS domains of this machine are in use")


def default_domain_id() -> int:
    """ROS's own default: ROS_DOMAIN_ID, else 0. Raises ValueError if it is not a number."""
    given = os.environ.get("ROS_DOMAIN_ID") or "0"
    if not given.isdecimal():
        raise ValueError(f"ROS_DOMAIN_ID is {given!r}, not a number; set it to one of 0 .. {HIGHEST_DOMAIN_ID}")
    return int(given)


def loopback_environment(domain_id: int) -> dict[str, str]:
    """Environment for nodes that communicate on this machine only, in a domain of their own.

    A ROS_AUTOMATIC_DISCOVERY_RANGE that the user has set stays as it is. For its other effects on a node see
    this_machine.py.
    """
    environment = as_the_user_has_it(os.environ) | {"ROS_DOMAIN_ID": str(domain_id)}
    environment.setdefault(RANGE, LOCALHOST)
    return environment


class NodeProcess:
    """One node in a process of its own, which always ends with this one."""

    def __init__(
        self,
        module: str,
        parameters: Mapping[str, Any],
        domain_id: int,
        log: Path,
        stdout: int | None = None,
        arguments: Sequence[str] = (),
        niceness: int = 0,
    ) -> None:
        """Starts `module`, a node of ros/start.py.

        The log gets stderr, and stdout too unless `stdout` is given. `arguments`: more of --ros-args, such as namespace
        and remapping. `niceness`: 0 .. 19, by how much the node's priority on a processor is lowered.
        """
        given = [f"{name}:={json.dumps(value)}" for name, value in parameters.items()]
        command = [sys.executable, "-m", "fracture_collision.ros.start", module, "--ros-args", *arguments]
        for assignment in given:
            command += ["-p", assignment]
        self.name = module
        self.log = log
        with log.open("ab") as stream:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=stream if stdout is None else stdout,
                stderr=stream,
                text=True,
                env=loopback_environment(domain_id),
                start_new_session=True,  # Ctrl-C reaches the parent, which stops its nodes in order
                preexec_fn=partial(_prepare, niceness),
            )

    @property
    def stdout(self) -> IO[str]:
        """The node's standard output, if it was started with stdout=subprocess.PIPE."""
        assert self._process.stdout is not None
        return self._process.stdout

    @property
    def pid(self) -> int:
        """The node's process id."""
        return self._process.pid

    def exit_status(self) -> int | None:
        """Exit status, None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def send_signal(self, order: signal.Signals) -> None:
        """Sends a signal and does not wait; no effect if the process has ended."""
        self._process.send_signal(order)

    def wait(self, timeout: float) -> int:
        """Waits for its end; returns its exit status. Raises subprocess.TimeoutExpired after `timeout` [s]."""
        return self._process.wait(timeout)

    def stop(
        self,
        patience: float = 10.0,
        orders: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL),
    ) -> int:
        """Sends `orders` in turn until it ends, waiting `patience` [s] after each; returns its exit status."""
        for order in orders:
            if self._process.poll() is None:
                self._process.send_signal(order)
                try:
                    self._process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue
        status = self._process.wait()
        remove_dead_segments()
        return status

    def last_words(self) -> str:
        """Why it has ended, for an error: its exit status and the end of its log."""
        status = self.exit_status()
        reason = f" (the disk is full; {REMEDY})" if status == STATUS else ""
        return f"{self.name} ended with status {status}{reason}; {self.log_end()}"

    def log_end(self) -> str:
        """The last lines of its log, for an error."""
        return "the end of its log:\n" + "\n".join(self.log_text().splitlines()[-15:])

    def log_text(self) -> str:
        """The contents of the log file so far."""
        return self.log.read_text(errors="replace")


def _prepare(niceness: int) -> None:
    """Runs in the child before it becomes a node: makes it end with its parent, and sets its niceness."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    if not niceness:
        return
    os.nice(niceness)
    # if the scheduler divides a processor among sessions before processes, the session's niceness counts
    for _ in range(_TRIES):
        try:
            _SESSION.write_text(str(niceness))
            return
        except BlockingIOError:  # Linux accepts one write in a tenth of a second, of all users together
            time.sleep(_AGAIN)
        except OSError:  # not supported
            return

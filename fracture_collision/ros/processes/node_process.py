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

from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN
from fracture_collision.ros.fastdds.shared_memory import remove_left_behind
from fracture_collision.ros.fastdds.this_machine import LOCALHOST, RANGE, as_the_user_has_it

# Domains above this have ports that Linux hands out to anybody (REP 2000's "safe on all platforms").
HIGHEST_DOMAIN_ID = 101
_SET_PARENT_DEATH_SIGNAL = 1  # prctl's PR_SET_PDEATHSIG
_SESSION = Path("/proc/self/autogroup")  # of Linux
_TRIES, _AGAIN = 10, 0.05  # [s]
# Domains that this process has got; more than it uses at a time, and few enough for others to find one.
_MOST_CLAIMS = 8
_claims: deque[socket.socket] = deque()


def free_domain_id() -> int:
    """A ROS domain id that nobody on this machine uses, as far as can be told: no port of its is taken on all
    interfaces, and nobody else has got it from here lately. Raises RuntimeError if all are taken.
    """
    candidates = list(range(1, HIGHEST_DOMAIN_ID + 1))
    random.shuffle(candidates)  # others who look for one at the same moment should not find the same one
    for domain_id in candidates:
        # nodes that keep to loopback take no port that could be seen, so whoever starts some holds a name
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
    """What ROS itself would take: ROS_DOMAIN_ID, else 0. Raises ValueError where that is no number."""
    return int(os.environ.get("ROS_DOMAIN_ID") or 0)


def chosen_domain_id() -> int:
    """ROS_DOMAIN_ID where the user has set one, so that nodes of his own can listen; else one that is free."""
    given = os.environ.get("ROS_DOMAIN_ID", "")
    return int(given) if given.isdigit() else free_domain_id()


def loopback_environment(domain_id: int) -> dict[str, str]:
    """The environment in which nodes talk to this machine only, in a domain of their own; unless the user's has another
    ROS_AUTOMATIC_DISCOVERY_RANGE. What else that variable means to a node: see ros/fastdds/this_machine.py.
    """
    environment = as_the_user_has_it(os.environ) | {"ROS_DOMAIN_ID": str(domain_id)}
    environment.setdefault(RANGE, LOCALHOST)
    return environment


class NodeProcess:
    """One node in a process of its own, which ends with this one whatever happens."""

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
        """`module`: below fracture_collision.ros. The log gets stderr, and stdout too unless it goes elsewhere.
        `arguments`: what else stands behind --ros-args, of namespace and remapping. `niceness`: 0 .. 19, how far others
        who want the same processor come first.
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
        """With stdout=subprocess.PIPE."""
        assert self._process.stdout is not None
        return self._process.stdout

    @property
    def pid(self) -> int:
        return self._process.pid

    def exit_status(self) -> int | None:
        """None while it runs; negative: the signal that ended it."""
        return self._process.poll()

    def send_signal(self, order: signal.Signals) -> None:
        self._process.send_signal(order)

    def wait(self, timeout: float) -> int:
        """Exit status. Raises subprocess.TimeoutExpired."""
        return self._process.wait(timeout)

    def stop(
        self,
        patience: float = 10.0,
        orders: Sequence[signal.Signals] = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL),
    ) -> int:
        """Asks it to end, then makes it, waiting `patience` [s] after each of `orders`; returns its exit status."""
        for order in orders:
            if self._process.poll() is None:
                self._process.send_signal(order)
                try:
                    self._process.wait(patience)
                except subprocess.TimeoutExpired:
                    continue
        status = self._process.wait()
        remove_left_behind()
        return status

    def log_text(self) -> str:
        return self.log.read_text(errors="replace")


def _prepare(niceness: int) -> None:
    """What a child does before it becomes a node: it shall end with its parent."""
    ctypes.CDLL(None).prctl(_SET_PARENT_DEATH_SIGNAL, signal.SIGTERM)
    if not niceness:
        return
    os.nice(niceness)
    # where sessions share a processor first and their processes then, the session's niceness counts
    for _ in range(_TRIES):
        try:
            _SESSION.write_text(str(niceness))
            return
        except BlockingIOError:  # Linux takes one word about it in a tenth of a second, of all users together
            time.sleep(_AGAIN)
        except OSError:  # there is no such thing
            return

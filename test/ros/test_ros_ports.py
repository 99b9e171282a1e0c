"""DDS ports: cleanup removes only files that no process uses, and a node without working ports exits."""

from __future__ import annotations

import fcntl
import mmap
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from campaigns.kills.stage import await_ready, stage
from fracture_collision.ros.fastdds import shared_memory
from fracture_collision.ros.fastdds.farewell import PORT_BASE, PORTS_A_DOMAIN
from fracture_collision.ros.fastdds.shared_memory import FOLDER, YOUNG, left_behind, orphaned_ports, remove_left_behind
from fracture_collision.ros.fastdds.successor_ports import orphaned_ports_held
from fracture_collision.ros.processes.node_process import free_domain_id

OLD = 2.0 * YOUNG
FREE, TAKEN = b"\1" + bytes(31), bytes(32)  # a POSIX semaphore of glibc, of value 1 and 0
pytestmark = pytest.mark.timeout(300)


def made(folder: Path, *names: str, age: float = OLD) -> list[str]:
    for name in names:
        (folder / name).write_bytes(bytes(64))
        os.utime(folder / name, (time.time() - age,) * 2)
    return list(names)


def mutex(folder: Path, port: int, content: bytes = FREE) -> str:
    name = f"sem.fastrtps_port{port}_mutex"
    (folder / name).write_bytes(content)
    return name


def files(folder: Path) -> set[str]:
    return {file.name for file in folder.iterdir()}


def test_unused_files_in_shared_memory_are_removed(tmp_path: Path) -> None:
    left = made(tmp_path, "fastrtps_00ff00ff00ff00ff", "fastrtps_00ff00ff00ff00ff_el", "fastrtps_port7411")
    left += made(tmp_path, "fastrtps_port7411_el", "fastrtps_port7413")  # the lock file of 7413 is gone already
    stays = made(tmp_path, "fastrtps_1111111111111111", "fastrtps_1111111111111111_el", "fastrtps_port7415")
    stays += made(tmp_path, "fastrtps_of_somebody_el", "fastrtps_", "other_el")
    stays += made(tmp_path, "fastrtps_2222222222222222", "fastrtps_2222222222222222_el", age=0.0)
    stays += [mutex(tmp_path, port) for port in (7411, 7413, 7415)]
    with (tmp_path / stays[1]).open("rb") as lock, (tmp_path / "fastrtps_port7415").open("rb") as port:
        fcntl.flock(lock, fcntl.LOCK_SH)
        with mmap.mmap(port.fileno(), 0, access=mmap.ACCESS_READ):
            assert {file.name for file in left_behind(tmp_path)} == set(left)
            assert remove_left_behind(tmp_path) == len(left)
    assert files(tmp_path) == set(stays)
    assert remove_left_behind(tmp_path / "nowhere") == 0


def test_a_port_that_is_being_opened_is_not_removed(tmp_path: Path) -> None:
    """Fast DDS holds the port's mutex while opening it; a port without a mutex may be opened at any time."""
    ports = made(tmp_path, "fastrtps_port7417", "fastrtps_port7417_el", "fastrtps_port7419", "fastrtps_port7419_el")
    ports.append(mutex(tmp_path, 7417, TAKEN))
    assert remove_left_behind(tmp_path) == 0
    assert files(tmp_path) == set(ports)


def test_a_port_opened_before_its_removal_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Opened between the check and the removal: removing it would leave its new owner unable to receive."""
    ports = made(tmp_path, "fastrtps_port7421", "fastrtps_port7421_el") + [mutex(tmp_path, 7421)]
    real = shared_memory._port_mutex
    with ExitStack() as owner:

        @contextmanager
        def after_another(folder: Path, name: str) -> Iterator[bool]:
            lock = owner.enter_context((folder / f"{name}_el").open("rb"))
            fcntl.flock(lock, fcntl.LOCK_EX)
            with real(folder, name) as is_ours:
                yield is_ours

        monkeypatch.setattr(shared_memory, "_port_mutex", after_another)
        assert remove_left_behind(tmp_path) == 0
    assert files(tmp_path) == set(ports)


def test_the_mutex_is_held_while_a_port_is_removed_and_released_afterwards(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made(tmp_path, "fastrtps_port7423", "fastrtps_port7423_el")
    name = mutex(tmp_path, 7423)
    values = []
    real = shared_memory._remove_unlocked

    def noted(folder: Path, of: str) -> int:
        values.append((folder / name).read_bytes()[0])
        return real(folder, of)

    monkeypatch.setattr(shared_memory, "_remove_unlocked", noted)
    assert remove_left_behind(tmp_path) == 2
    assert values == [0] and (tmp_path / name).read_bytes()[0] == 1


def test_finding_unused_ports_tries_no_lock(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Trying a lock holds it briefly; a participant that opens the port then would fail and receive nothing."""
    made(tmp_path, "fastrtps_port7425", "fastrtps_port7425_el")
    monkeypatch.setattr(shared_memory.fcntl, "flock", lambda *_: pytest.fail("a lock was tried"))
    assert len(left_behind(tmp_path)) == 2


def test_a_successor_skips_ports_that_living_processes_still_write_to(tmp_path: Path) -> None:
    domain_id = free_domain_id()
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    dead, just_dead, replaced, alive, unmapped, never_read, elsewhere = (
        first + 11, first + 13, first + 15, first + 17, first + 19, first + 21, first + PORTS_A_DOMAIN + 11
    )  # fmt: skip
    flow = PORT_BASE - 1  # the highest, out of reach of nodes running in parallel
    for port in (dead, just_dead, replaced, alive, unmapped, never_read, elsewhere, flow):
        made(tmp_path, f"fastrtps_port{port}", f"fastrtps_port{port}_el", age=0.0 if port == just_dead else OLD)
    (tmp_path / f"fastrtps_port{never_read}_el").unlink()
    with ExitStack() as stack:
        for port in (dead, just_dead, replaced, alive, never_read, elsewhere, flow):
            file = stack.enter_context((tmp_path / f"fastrtps_port{port}").open("rb"))
            stack.enter_context(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        for port in (replaced, alive):  # their current listeners hold the locks
            name = f"fastrtps_port{port}"
            if port == replaced:
                (tmp_path / name).unlink()
                made(tmp_path, name)
            fcntl.flock(stack.enter_context((tmp_path / f"{name}_el").open("rb")), fcntl.LOCK_EX)
        orphans = [dead, just_dead, replaced, elsewhere]
        assert orphaned_ports(tmp_path) == {*orphans, flow}
        with orphaned_ports_held(domain_id, tmp_path) as held:
            assert held == [*(each for port in orphans[:3] for each in (port - 1, port)), flow]
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other, pytest.raises(OSError):
                other.bind(("127.0.0.1", dead))
    assert orphaned_ports(tmp_path) == set()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", dead))


@contextmanager
def all_ports_locked(domain_id: int) -> Iterator[None]:
    """Locks all ports of the domain in shared memory, as another process would."""
    first = PORT_BASE + PORTS_A_DOMAIN * domain_id
    locks = [FOLDER / f"fastrtps_port{port}_el" for port in range(first, first + PORTS_A_DOMAIN)]
    with ExitStack() as stack:
        for lock in locks:
            fcntl.flock(stack.enter_context(lock.open("wb")), fcntl.LOCK_EX | fcntl.LOCK_NB)
            stack.callback(lock.unlink, missing_ok=True)
            stack.callback((FOLDER / f"sem.{lock.name.removesuffix('_el')}_mutex").unlink, missing_ok=True)
        yield


@pytest.mark.parametrize("module", ["recorder_node", "collision_node"])
def test_a_node_without_ports_reports_it_and_exits(module: str, tmp_path: Path) -> None:
    with stage(tmp_path) as nodes, all_ports_locked(nodes.domain_id):
        node = nodes.start(module, **({"folder": str(tmp_path / "bag")} if module == "recorder_node" else {}))
        assert node.wait(60.0) == 1
        assert "the node cannot receive messages: no port of ROS domain" in node.log_text()
        assert "ready, " not in node.log_text() and "Traceback" not in node.log_text()


def test_a_node_whose_port_is_removed_reports_it_and_exits(tmp_path: Path) -> None:
    with stage(tmp_path) as nodes:
        node = nodes.start("collision_node", threads=1)
        await_ready(node)
        first = PORT_BASE + PORTS_A_DOMAIN * nodes.domain_id
        ports = [FOLDER / f"fastrtps_port{port}" for port in range(first, first + PORTS_A_DOMAIN)]
        own = [port for port in ports if port.exists()]
        assert own
        for port in own:
            port.unlink()
        assert node.wait(60.0) == 1
        assert "the node no longer receives messages: port" in node.log_text()


STUCK = """
import sys, time
import fracture_collision.ros.processes.process as process
where = sys.argv.pop()
process.LONGEST_END = 1.0
import rclpy, ctypes
from rclpy.node import Node
class Stuck(Node):
    def __init__(self):
        super().__init__("stuck")
    def destroy_node(self):
        if where == "end":
            ctypes.PyDLL(None).sleep(1000)  # as DDS may: with the interpreter's lock held
        super().destroy_node()
def work(node):
    print("working", flush=True)
    while where == "work":
        ctypes.CDLL(None).sleep(1000)
    while rclpy.ok():
        time.sleep(0.01)
sys.exit(process.run_node(Stuck, work))
"""


@pytest.mark.parametrize("where", ["work", "end"])
@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_a_node_exits_in_time_even_if_dds_does_not_return(where: str, order: signal.Signals) -> None:
    environment = os.environ | {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    process = subprocess.Popen([sys.executable, "-c", STUCK, where], stdout=subprocess.PIPE, text=True, env=environment)
    try:
        assert process.stdout.readline() == "working\n"
        process.send_signal(order)
        assert process.wait(20.0) == 1
    finally:
        process.kill()
        process.wait()
        process.stdout.close()

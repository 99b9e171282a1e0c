"""Compilation in several processes: locks on kernels, and the process that compiles beside a first start."""

import fcntl
import os
import subprocess
import sys
import zlib
from pathlib import Path
from unittest.mock import Mock

import pytest

from fracture_collision.core.memory import compile_locks
from fracture_collision.world import first_start

PATIENCE = 60.0  # [s]
HOLDER = """
import sys
from pathlib import Path
from fracture_collision.core.memory import compile_locks
assert compile_locks.lock(Path(sys.argv[1]), "kernel")
print("locked", flush=True)
for line in sys.stdin:
    compile_locks.unlock(Path(sys.argv[1]), "kernel")
    print("unlocked", flush=True)
"""


@pytest.mark.parametrize("is_killed", [False, True])
def test_a_kernel_is_locked_until_it_is_compiled_or_its_process_has_ended(tmp_path: Path, is_killed: bool) -> None:
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "locked\n"
        with (tmp_path / compile_locks.NAME).open("r+b") as file:
            for name, is_free in (("another", True), ("kernel", False)):
                assert _is_free(file.fileno(), name) == is_free
            if is_killed:
                holder.kill()
                holder.wait()
            else:
                holder.stdin.write("\n")
                holder.stdin.flush()
                assert holder.stdout.readline() == "unlocked\n"
            assert _is_free(file.fileno(), "kernel")
        holder.kill()


def _is_free(file: int, kernel: str) -> bool:
    try:
        fcntl.lockf(file, fcntl.LOCK_EX | fcntl.LOCK_NB, 1, zlib.crc32(kernel.encode()) % compile_locks.BYTES)
    except OSError:
        return False
    return True


def test_a_folder_that_cannot_be_written_to_has_no_locks(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    assert not compile_locks.lock(tmp_path / "file" / "below", "kernel")
    compile_locks.unlock(tmp_path / "file" / "below", "kernel")


def test_nothing_is_started_beside_where_kernels_are_cached(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[list[str]] = []
    monkeypatch.setattr(first_start.subprocess, "Popen", lambda command, **_: started.append(command) or Mock())
    monkeypatch.setattr(first_start, "_helper", None)
    monkeypatch.setattr(first_start, "_has_two_processors", lambda: True)
    monkeypatch.delenv(first_start.ALONE, raising=False)
    monkeypatch.setattr(first_start, "cache_is_cold", lambda: False)
    first_start.compile_beside()
    assert not started
    monkeypatch.setattr(first_start, "cache_is_cold", lambda: True)
    monkeypatch.setenv(first_start.ALONE, "1")
    first_start.compile_beside()
    assert not started
    monkeypatch.delenv(first_start.ALONE)
    first_start.compile_beside()
    assert [command[1:] for command in started] == [["-m", "fracture_collision.world.first_start"]]


def test_the_process_beside_ends_with_its_parent(tmp_path: Path) -> None:
    """With an empty cache it would take a minute."""
    environment = os.environ | {first_start.ALONE: "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", first_start.__name__]
    with subprocess.Popen(command, stdin=subprocess.PIPE, env=environment, stderr=subprocess.PIPE) as beside:
        beside.stdin.close()
        assert beside.wait(PATIENCE) == 0
        assert beside.stderr.read() == b""
    assert not list(tmp_path.rglob("*search_sampled*.nbc"))

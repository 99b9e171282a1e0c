"""`fracture-collision` as typed, in a process of its own or in this one. For tests."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from click.testing import CliRunner

from fracture_collision.cli.commands import main

PATIENCE = 240.0  # [s] on a loaded machine


def command(*words: str | Path) -> list[str]:
    return [sys.executable, "-m", "fracture_collision.cli", *map(str, words)]


def run(*words: str | Path, timeout: float = PATIENCE) -> subprocess.CompletedProcess[str]:
    return subprocess.run(command(*words), capture_output=True, text=True, timeout=timeout)


class Called(NamedTuple):
    """What a command has left."""

    status: int
    output: str  # of both streams, in the order of writing
    text: str  # the same in one line


def call(*words: object) -> Called:
    """Runs a command in this process, which spares the start of another; it must explain its errors itself."""
    done = CliRunner().invoke(main, [*map(str, words)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.output
    return Called(done.exit_code, done.output, " ".join(done.output.split()))


class Begun:
    """A command that runs, and what it has said so far."""

    def __init__(self, process: subprocess.Popen[str], said: Path) -> None:
        self.pid = process.pid
        self._process, self._said = process, said

    @property
    def text(self) -> str:
        return self._said.read_text(errors="replace")  # it may end within a character

    def until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + PATIENCE
        while not condition():
            assert self._process.poll() is None and time.monotonic() < deadline, self.text
            time.sleep(0.05)

    def stop(self, order: signal.Signals) -> None:
        """As by Ctrl-C, or by `kill`: it must report that it was interrupted."""
        os.kill(self.pid, order)
        self.must_end()

    def must_end(self) -> None:
        assert self._process.wait(60.0) == 130
        assert "Traceback" not in self.text


@contextmanager
def begun(folder: Path, *words: str | Path) -> Iterator[Begun]:
    """Its bars are drawn as on a terminal, into a file of `folder`."""
    said = folder / "said.txt"
    with said.open("w") as stream:
        process = subprocess.Popen(
            command(*words), stdout=stream, stderr=stream, start_new_session=True, text=True,
            env=os.environ | {"COLUMNS": "120", "FORCE_COLOR": "1"},
        )  # fmt: skip
    try:
        yield Begun(process, said)
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()

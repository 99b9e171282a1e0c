"""What a run leaves and says: outputs of the last run that started stay complete, whatever happens to the next.

While kernels are compiled, something is said at least every few seconds; nothing where none is.
"""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numba
import pytest
from numba.core import event

from fracture_collision.process import compile_progress
from fracture_collision.process.compile_progress import report_compilation
from fracture_collision.process.outputs import NewOutputs

NAMES = ("bag", "report.json", "pictures")


def write_run(folder: Path, word: str, *names: str) -> None:
    for name in names:
        if name == "bag":
            (folder / name).mkdir()
            (folder / name / "messages").write_text(word)
        else:
            (folder / name).write_text(word)


def contents(folder: Path) -> dict[str, str]:
    return {str(f.relative_to(folder)): f.read_text() for f in sorted(folder.rglob("*")) if f.is_file()}


@pytest.fixture
def out(tmp_path: Path) -> Path:
    """A folder with the outputs of a run and an unrelated file."""
    with NewOutputs(tmp_path / "deep" / "out", NAMES) as new:
        write_run(new.folder, "first", *NAMES)
        new.started = True
    (tmp_path / "deep" / "out" / "notes").write_text("mine")
    return tmp_path / "deep" / "out"


FIRST = {"bag/messages": "first", "report.json": "first", "pictures": "first", "notes": "mine"}


def test_a_new_run_replaces_all_outputs_of_the_old_one(out: Path) -> None:
    assert contents(out) == FIRST
    with NewOutputs(out, NAMES) as new:
        write_run(new.folder, "second", "bag", "report.json")
        left = contents(out)
        assert {name: word for name, word in left.items() if not name.startswith(".new-")} == FIRST
        new.started = True
    assert contents(out) == {"bag/messages": "second", "report.json": "second", "notes": "mine"}


@pytest.mark.parametrize("fails", [False, True])
def test_a_run_that_never_started_changes_nothing(out: Path, fails: bool, tmp_path: Path) -> None:
    for where in (out, tmp_path / "not" / "there"):
        try:
            with NewOutputs(where, NAMES) as new:
                write_run(new.folder, "second", "bag")
                if fails:
                    raise KeyboardInterrupt
        except KeyboardInterrupt:
            assert fails
    assert contents(out) == FIRST and {each.name for each in out.iterdir()} == {*NAMES, "notes"}
    assert not (tmp_path / "not").exists()


def test_an_interrupted_run_keeps_its_outputs_and_no_older_ones(out: Path) -> None:
    with pytest.raises(RuntimeError), NewOutputs(out, NAMES) as new:
        write_run(new.folder, "second", "bag")
        new.started = True
        raise RuntimeError
    assert contents(out) == {"bag/messages": "second", "notes": "mine"}


def test_outputs_published_early_are_completed_in_place(out: Path) -> None:
    with NewOutputs(out, NAMES) as new:
        write_run(new.folder, "second", "report.json")
        with (new.folder / "report.json").open("a") as stream:
            new.publish()
            stream.write(" and more")
    assert contents(out) == {"report.json": "second and more", "notes": "mine"}


def test_the_next_run_removes_outputs_of_killed_runs_but_not_of_living_ones(out: Path) -> None:
    code = f"""
import os, signal
from pathlib import Path
from fracture_collision.process.outputs import NewOutputs
with NewOutputs(Path({str(out)!r}), {NAMES!r}) as new:
    (new.folder / "report.json").write_text("killed")
    os.kill(os.getpid(), signal.SIGKILL)
"""
    done = subprocess.run([sys.executable, "-c", code], env=os.environ, timeout=60.0)
    assert done.returncode == -signal.SIGKILL
    kept = contents(out)
    assert "killed" in kept.values() and {n: w for n, w in kept.items() if w != "killed"} == FIRST
    with NewOutputs(out, NAMES) as living, NewOutputs(out, NAMES) as new:
        write_run(living.folder, "living", "bag")
        write_run(new.folder, "second", "report.json")
        new.publish()
        assert (living.folder / "bag" / "messages").read_text() == "living"
        living.started = True
    assert contents(out) == {"bag/messages": "living", "notes": "mine"}


@pytest.fixture
def reporting(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    """A reporter of its own with intervals of milliseconds, alone: commands tested before may have left one."""
    others = list(compile_progress._reporters)
    for other in others:
        event.unregister("numba:compile", other)
    monkeypatch.setattr(compile_progress, "FIRST", 0.01)
    monkeypatch.setattr(compile_progress, "EVERY", 0.02)
    monkeypatch.setattr(compile_progress, "_reporters", [])
    report_compilation()
    report_compilation()
    (reporter,) = compile_progress._reporters
    yield caplog
    event.unregister("numba:compile", reporter)
    for other in others:
        event.register("numba:compile", other)


def lines(caplog: pytest.LogCaptureFixture) -> list[str]:
    return [record.getMessage() for record in caplog.records if record.name == "fracture_collision"]


def of_the_package(function):
    function.__module__ = "fracture_collision.somewhere"
    return function


def test_a_long_compilation_is_reported_until_its_end(reporting: pytest.LogCaptureFixture) -> None:
    @numba.njit
    @of_the_package
    def inner(x):
        return x + 1

    @numba.njit
    @of_the_package
    def outer(x):
        return inner(x) * inner(x + 1.0)

    assert outer(2) == 3 * 4.0
    deadline = time.monotonic() + 60.0
    while not any("compiled" in line for line in lines(reporting)):
        assert time.monotonic() < deadline, lines(reporting)
        time.sleep(0.01)
    said = lines(reporting)
    assert "compiling kernels, once per installation" in said[0]
    assert said[-1].startswith("compiled 3 kernels in")  # inner for each type
    assert all(record.levelno == logging.WARNING for record in reporting.records)


def test_the_users_own_functions_are_not_reported(reporting: pytest.LogCaptureFixture) -> None:
    @numba.njit
    def own(x):
        return x + 1

    own(1)
    assert compile_progress._reporters[0]._done == 0 and not lines(reporting)

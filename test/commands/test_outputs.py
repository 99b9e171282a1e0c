"""Outputs of runs: those of the last run that started stay complete, whatever happens to the next run."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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

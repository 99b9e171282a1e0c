"""`fracture-collision bench`: help, errors for invalid arguments, and Ctrl-C, which leaves no process behind."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path

import pytest
from stages.typed_command import begun, call

pytest.importorskip("distributed")


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fig99"], "fig99: no such study; choose from tables, fig5, fig12, resolution, fig15, fig16, fig17"),
        (["fig16", "fig98", "fig99"], "fig98, fig99: no such study"),
        (["--workers", "0"], "--workers"),
        (["--scheduler", "tcp://127.0.0.1:1", "--workers", "2"], "--workers: the scheduler has its own workers"),
        (["fig5", "--drops", "3"], "--drops applies to fig16, which is not run; add fig16 to NAMES"),
        (["fig16", "--drops", "0"], "--drops"),
    ],
)
def test_invalid_arguments_are_rejected_with_an_explanation(tmp_path: Path, words: list[str], said: str) -> None:
    done = call("bench", *words, "--out", tmp_path / "out")
    assert done.status in (1, 2) and said in done.text
    assert not (tmp_path / "out").exists()


def test_bench_reports_that_its_sources_are_not_installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # fracture_collision.cli.bench as an attribute is the command, not the module
    module = sys.modules["fracture_collision.cli.bench"]
    monkeypatch.setattr(module, "__file__", str(tmp_path / "fracture_collision" / "cli" / "bench.py"))
    done = call("bench", "fig5", "--out", tmp_path / "out")
    assert done.status == 1 and "it is not installed" in done.text


def processes_of(session: int) -> list[str]:
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            # after the command's name in parentheses: state, parent, group, session
            state, _, _, its = (process / "stat").read_text().rpartition(")")[2].split()[:4]
            if int(its) == session and state != "Z":
                found.append((process / "cmdline").read_text().replace("\0", " "))
        except OSError:
            continue
    return found


@pytest.mark.slow
@pytest.mark.parametrize("order", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_command_leaves_no_process(tmp_path: Path, order: signal.Signals) -> None:
    with begun(tmp_path, "bench", "fig16", "--full", "--workers", "2", "--out", tmp_path / "out") as process:
        process.until(lambda: "contacts, " in process.text)  # until the first trial is done
        assert len(processes_of(process.pid)) >= 3
        if order == signal.SIGINT:
            os.killpg(process.pid, order)  # to the whole group, as a terminal does
            process.must_end()
        else:
            process.stop(order)
        deadline = time.monotonic() + 60.0
        while left := processes_of(process.pid):
            assert time.monotonic() < deadline, left
            time.sleep(0.05)
    assert "stopped; finished: none" in process.text
    assert not list((tmp_path / "out").iterdir())

"""While kernels are compiled, something is said at least every few seconds; nothing where none is."""

from __future__ import annotations

import logging
import time

import numba
import pytest
from numba.core import event

from fracture_collision.process import compile_progress
from fracture_collision.process.compile_progress import report_compilation


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


def test_loaded_kernels_are_not_reported(reporting: pytest.LogCaptureFixture) -> None:
    @numba.njit
    @of_the_package
    def once(x):
        return x

    once(1)
    before = compile_progress._reporters[0]._done
    once(2)
    assert compile_progress._reporters[0]._depth == 0 and compile_progress._reporters[0]._done in (before, 0)

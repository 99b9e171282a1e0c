"""Shared by the studies of thrown bodies: how these fly, trials, the rows of tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from benchmarks.studies.study import Trial
from benchmarks.studies.table import Row

SPEEDS = (1.0, 5.0, 20.0, 50.0, 100.0, 200.0)  # [m/s]
STEPS = (0.001, 0.0025, 0.005, 0.01)  # [s]
MOST_SPIN, SPIN_OF_TARGET, SPEED_OF_TARGET = 200.0, 20.0, 1.0  # [rad/s], [rad/s], [m/s]

# Runs throws first .. end - 1 of (thrown, target, speed, first, end), which differ in their random numbers.
Run = Callable[[str, str, float, int, int], list[Any]]


class Size(NamedTuple):
    count: int  # per thrown body, target and speed
    thrown: tuple[str, ...]
    targets: tuple[str, ...]
    speeds: tuple[float, ...] = SPEEDS  # [m/s]


def trials_of(run: Run, together: int, size: Size) -> list[Trial]:
    """All of a size, in trials of `together` throws each."""
    return [
        trial
        for thrown in size.thrown
        for target in size.targets
        for speed in size.speeds
        for trial in _trials(run, together, size.count, thrown, target, speed)
    ]


def _trials(run: Run, together: int, count: int, thrown: str, target: str, speed: float) -> list[Trial]:
    return [
        Trial(
            run, (thrown, target, speed, first, min(first + together, count)),
            f"{thrown} at {target}, {speed:g} m/s, from number {first} on", False,
        )
        for first in range(0, count, together)
    ]  # fmt: skip


def tables_of(
    run: Run, together: int, size: Size, results: Mapping[Trial, Any], row: Callable[[list[Any]], Row]
) -> dict[str, list[Row]]:
    """Rows by thrown body and target, and table "speeds"; row: makes a row from a list of results."""

    def found(thrown: tuple[str, ...], targets: tuple[str, ...], speeds: tuple[float, ...]) -> list[Any]:
        return [
            it
            for trial in trials_of(run, together, Size(size.count, thrown, targets, speeds))
            for it in results[trial]
        ]

    by_kind = [
        {"thrown": thrown, "target": target} | row(found((thrown,), (target,), size.speeds))
        for thrown in size.thrown
        for target in size.targets
    ]
    by_speed = [{"speed": speed} | row(found(size.thrown, size.targets, (speed,))) for speed in size.speeds]
    return {"": by_kind, "speeds": by_speed}

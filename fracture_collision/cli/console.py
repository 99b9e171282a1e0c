"""Shared by the commands: options as records, a progress bar, tables, and an end by Ctrl-C.

A KeyboardInterrupt from a signal handler comes between any two bytecodes, also those that run on behalf of compiled
code: while numba hands LLVM a cached kernel it is swallowed, and the kernel's address is null; while numba boxes a
result it is mistaken for an interpreter error; and some modules swallow it during their import. So commands that call
kernels end through `Interruption`, which they create before they import any.
"""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import wraps
from types import FrameType
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from fracture_collision.process.early_signals import INTERRUPTED
from fracture_collision.run_report import TableRow, last_words, statistics_table, times_table, where_time_goes

SHOW_CURSOR = "\x1b[?25h"  # a progress bar hides it


class BadInput(click.ClickException):
    """An argument that cannot be used: no such scene, a damaged bag, a folder that exists; reported before any work."""

    exit_code = 2


def options_as(record: Any) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Decorates a command: its options that are fields of the NamedTuple `record` are passed as one, `options`.

    Stands below click's decorators.
    """

    def decorate(function: Callable[..., None]) -> Callable[..., None]:
        @wraps(function)
        def command(**given: Any) -> None:
            options = record(**{name: given.pop(name) for name in record._fields})
            function(**given, options=options)

        return command

    return decorate


class Interruption:
    """Ends a command on SIGINT or SIGTERM: within `held` at the next `check`, elsewhere or on a second signal at once.

    `parting`: printed when it ends at once. The handlers are removed when the command ends.
    """

    def __init__(self, console: Console, parting: str) -> None:
        self.parting = parting
        self._console = console
        self._holding = False
        self._asked = False
        _until_the_command_ends(self._on_signal)

    @contextmanager
    def held(self) -> Iterator[None]:
        """Delays the end to the next `check`: for work with partial results worth keeping.

        The work must call `check` often; the end of `held` calls it once more.
        """
        self._holding = True
        try:
            yield
        finally:
            self._holding = False
        self.check()

    def check(self) -> None:
        """Raises KeyboardInterrupt if a signal has arrived."""
        if self._asked:
            raise KeyboardInterrupt

    def _on_signal(self, _signal: int, _frame: FrameType | None) -> None:
        if self._holding and not self._asked:
            self._asked = True
            return
        # Uses neither an exception nor a stream, since the signal may have interrupted the stream's own code.
        words = f"{SHOW_CURSOR if self._console.is_terminal else ''}\n{self.parting}\n"
        os.write(self._console.file.fileno(), words.encode())
        os._exit(INTERRUPTED)


def interrupt_on_signals() -> None:
    """Makes SIGTERM and SIGINT raise KeyboardInterrupt until the command ends.

    SIGINT has to be set too, since a shell starts background processes with SIGINT ignored.
    """
    _until_the_command_ends(_as_interrupt)


def _as_interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _until_the_command_ends(handler: Callable[[int, FrameType | None], None]) -> None:
    before = {order: signal.signal(order, handler) for order in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for order, former in before.items():
            signal.signal(order, former)

    click.get_current_context().call_on_close(restore)


class ProgressBar:
    """A bar of simulation steps, with current figures of the run."""

    def __init__(self, console: Console) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} steps"),
            TextColumn("{task.fields[now]}"), TimeElapsedColumn(), console=console,
        )  # fmt: skip
        self._task = self._bar.add_task("starting", total=0, now="")

    def __enter__(self) -> ProgressBar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def show(self, step: int, steps: int, time: float, fragments: int, contacts: int, word: str = "") -> None:
        """`step` of `steps` are done, `time` [s] is simulated; while `steps` is 0, not known, it shows `word`."""
        now = f"{time:.2f} s, {fragments} fragments move, {contacts} contacts" if steps else ""
        self._bar.update(
            self._task, completed=step, total=steps, now=now, description="simulating" if steps else word
        )


@contextmanager
def counting_bar(console: Console, doing: str, things: str) -> Iterator[Callable[[int, int], None]]:
    """A bar that appears at the first call, which gets the number of things done and the total."""
    bar = Progress(
        TextColumn(doing), BarColumn(), MofNCompleteColumn(), TextColumn(things), TimeElapsedColumn(), console=console
    )
    task = bar.add_task("", total=None)

    def show(done: int, total: int) -> None:
        bar.start()
        bar.update(task, completed=done, total=total)

    try:
        yield show
    finally:
        bar.stop()


def figures_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    """Labels in the first column, numbers in the others."""
    table = Table(title=title)
    table.add_column("")
    for column in columns:
        table.add_column(column, justify="right")
    for row in rows:
        table.add_row(*row)
    return table


def beside_paper(title: str, rows: Iterable[TableRow]) -> Table:
    """Rows of `run_report`, with the paper's figures where there are any."""
    rows = list(rows)
    has_paper = any(row.paper_average is not None or row.paper_worst is not None for row in rows)
    columns = ("average", "worst", "paper's average", "paper's worst") if has_paper else ("average", "worst")
    cells = ([row.words, *map(_number, _figures(row)[: len(columns)])] for row in rows)
    return figures_table(title, columns, cells)


def print_report(console: Console, title: str, report: dict[str, Any]) -> None:
    """The tables of a run: statistics under `title`, and times."""
    console.print(beside_paper(title, statistics_table(report)))
    title = f"{len(report['step'])} steps in {report['seconds']:.1f} s; milliseconds per step"
    console.print(beside_paper(title, times_table(report)))
    console.print(where_time_goes(report), highlight=False, soft_wrap=True)
    console.print(last_words(report), highlight=False, soft_wrap=True)


def _figures(row: TableRow) -> tuple[float | None, ...]:
    return row.average, row.worst, row.paper_average, row.paper_worst


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if value >= 1000.0 or value == round(value) else f"{value:.2f}"

"""What the commands share: a progress bar, tables, and an end by Ctrl-C."""

from __future__ import annotations

import signal
from collections.abc import Iterable
from types import FrameType

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from fracture_collision.run_report import TableRow

INTERRUPTED = 130  # exit status, as a shell gives it after SIGINT


def interrupt_on_signals() -> None:
    """Until the command ends SIGTERM raises KeyboardInterrupt, as SIGINT does: a shell starts what it puts into the
    background with SIGINT ignored.
    """
    before = {order: signal.signal(order, _as_interrupt) for order in (signal.SIGINT, signal.SIGTERM)}

    def restore() -> None:
        for order, handler in before.items():
            signal.signal(order, handler)

    click.get_current_context().call_on_close(restore)


def _as_interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class ProgressBar:
    """A bar of simulation steps, with what is known of the run at the moment."""

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
        """`step` of `steps` are done, `time` [s] is simulated; while `steps` is 0, not known, `word` stands there."""
        now = f"{time:.2f} s, {fragments} fragments, {contacts} contacts" if steps else ""
        self._bar.update(
            self._task, completed=step, total=steps, now=now, description="simulating" if steps else word
        )


def figures_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[str]]) -> Table:
    """Words in the first column, numbers in the others."""
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
    says = any(row.paper_average is not None or row.paper_worst is not None for row in rows)
    columns = ("average", "worst", "paper's average", "paper's worst") if says else ("average", "worst")
    cells = ([row.words, *(_number(value) for value in row[1 : len(columns) + 1])] for row in rows)
    return figures_table(title, columns, cells)


def _number(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:,.0f}" if value >= 1000.0 or value == round(value) else f"{value:.2f}"

"""The parts of a study."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from benchmarks.studies.table import Row, Table


class Trial(NamedTuple):
    """One piece of work for one process. Equal trials of several studies are run once."""

    run: Callable[..., Any]  # at the top level of a module; except for times, a function of its arguments alone
    arguments: tuple[Any, ...]  # hashable
    words: str  # for the progress bar and errors
    is_timed: bool  # timed trials run one after the other, on one worker, while all others are idle


class Study(NamedTuple):
    """One figure of the paper. Tables, pictures and section have names: "" is the study's own, others are added.

    The tables of study fig12 are bench_fig12.csv for "" and bench_fig12_steps.csv for "steps", likewise its pictures.
    Columns selected by `table.is_time` hold times; all others are equal in every run, with any number of workers.
    """

    name: str
    title: str  # of its section
    quick: Any  # sizes, of a type defined by each study
    full: Any
    trials: Callable[[Any], list[Trial]]
    tables: Callable[[Any, Mapping[Trial, Any]], dict[str, list[Row]]]  # from the results of the trials of this size
    pictures: dict[str, Callable[[Mapping[str, Table]], Figure]]
    section: Callable[[Mapping[str, Table]], str]  # markdown below the title; pictures are placed below it


class StudyError(Exception):
    """A study that cannot continue; its message is for the user."""

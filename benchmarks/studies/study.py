"""What a study is made of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from benchmarks.studies.table import Row, Table


class Trial(NamedTuple):
    """One piece of work for one process. Equal trials of several studies are run once."""

    run: Callable[..., Any]  # at the top level of a module; but for times, a function of its arguments alone
    arguments: tuple[Any, ...]  # hashable
    words: str  # for the progress bar and for errors
    is_timed: bool  # timed trials run one after the other, on one worker, while all others are idle


class Study(NamedTuple):
    """One figure of the paper. Tables, pictures and section go by names: "" is the study's own, others are added.

    The tables of study fig12 are bench_fig12.csv for "" and bench_fig12_steps.csv for "steps", and so are its pictures.
    Columns that `table.is_time` names hold times; all others are equal in every run, with however many workers.
    """

    name: str
    title: str  # of its section
    quick: Any  # sizes, each study's own kind
    full: Any
    trials: Callable[[Any], list[Trial]]
    tables: Callable[[Any, Mapping[Trial, Any]], dict[str, list[Row]]]  # from what the trials of this size found
    pictures: dict[str, Callable[[Mapping[str, Table]], Figure]]
    section: Callable[[Mapping[str, Table]], str]  # markdown below the title; pictures are put below it


class StudyError(Exception):
    """A study that cannot go on; its words are for the user."""

"""Runs studies, one after the other: trials on a cluster, then CSV files, pictures and the page."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import fracture_collision.simulation.warm_up as simulator
import fracture_collision.world.warm_up as service
from benchmarks.studies.cluster import cluster, machine_of, run_trials
from benchmarks.studies.machine import load_average
from benchmarks.studies.page import STUDIES, read_tables, study_files, write_page
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import write_table


class Progress(NamedTuple):
    """Callbacks for the progress of a run of studies; silent by default."""

    begin: Callable[[str, int], None] = lambda study, trials: None
    done: Callable[[Trial], None] = lambda trial: None


def run_studies(
    names: Sequence[str],
    sizes: Sequence[Any],
    effort: str,
    out: Path,
    address: str | None = None,
    workers: int = 1,
    progress: Progress | None = None,
) -> Iterator[list[Path]]:
    """Runs each study with its size, and yields its files in the folder `out` as soon as they are written.

    `address` of a dask scheduler, or `workers` local processes. `effort` records in the CSV files how much was run.
    Raises StudyError. The page is written last, even if the caller stops early.
    """
    tell = Progress() if progress is None else progress
    # once here: otherwise several workers would compile the same kernels at once
    service.compile_kernels(progress=lambda words: None)
    simulator.compile_kernels(progress=lambda words: None)
    finished = False
    try:
        with cluster(address, workers) as crew:
            about = {"effort": effort, **machine_of(crew)}
            found: dict[Trial, Any] = {}
            for name, size in zip(names, sizes, strict=True):
                study = STUDIES[name]
                trials = list(dict.fromkeys(study.trials(size)))
                tell.begin(name, len(trials))
                for trial in trials:
                    if trial in found:
                        tell.done(trial)
                load = f"{load_average():.1f}"
                found |= run_trials(crew, [trial for trial in trials if trial not in found], tell.done)
                files = _write(study, size, found, about | {"load": load}, out)
                finished = True
                yield files
    finally:
        if finished:
            write_page(out)


def _write(study: Study, size: Any, found: dict[Trial, Any], about: dict[str, str], out: Path) -> list[Path]:
    left = []
    for name, rows in study.tables(size, found).items():
        left.append(study_files(out, study, name, "csv"))
        write_table(left[-1], about, rows)
    written = read_tables(out, study)
    for name, draw in study.pictures.items():
        left.append(study_files(out, study, name, "png"))
        draw(written).savefig(left[-1], metadata={"Software": None})
    return left

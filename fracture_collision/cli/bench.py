"""`fracture-collision bench`: the studies of benchmarks/, their CSV files, pictures and page."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from fracture_collision.cli.console import interrupt_on_signals
from fracture_collision.process.early_signals import INTERRUPTED

EXAMPLES = """\b
Examples:
  fracture-collision bench                            all studies, in some minutes, into docs/
  fracture-collision bench --full                     with enough trials for figures worth quoting: hours
  fracture-collision bench fig15 fig17 --out out/b    two of the paper's figures, into another folder
  fracture-collision bench fig16 --full --drops 1000 --scheduler tcp://10.0.0.7:8786

\b
Start workers for your own scheduler in a checkout of the same sources, one thread each:
  dask scheduler
  PYTHONPATH=. dask worker tcp://10.0.0.7:8786 --nworkers 16 --nthreads 1
"""


@click.command(epilog=EXAMPLES)
@click.argument("names", nargs=-1)
@click.option("--quick/--full", default=True, help="Number of trials.  [default: quick]")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the results.  [default: docs/]"
)
@click.option("--scheduler", metavar="ADDRESS", help="A dask scheduler.  [default: processes of this machine]")
@click.option(
    "--workers", type=click.IntRange(min=1), help="Processes of this machine, one thread each.  [default: one per core]"
)
@click.option("--drops", type=click.IntRange(min=1), help="Random drops of fig16 for each number of contacts.")
def bench(
    names: tuple[str, ...], quick: bool, out: Path | None, scheduler: str | None, workers: int | None, drops: int | None
) -> None:
    """Repeat the paper's figures and tables, and two studies of our own: those named, or all.

    The paper is Glondu et al. 2014. NAMES are tables, fig5, fig12, resolution (section 7.2), fig15, fig16, fig17,
    flights (contacts within a step, compared with another library's continuous collision detection) and throws
    (tunnelling of fast bodies in a simulation with lookahead). Each study writes bench_NAME.csv, which begins with the
    machine's name and versions, and bench_NAME.png; benchmarks.md is made of all CSV files in the folder. Works in a
    checkout of the sources only: benchmarks/ is not installed.

    Trials run in separate processes. Timed trials run one after another on one worker while all others are idle; all
    other trials run in parallel. Only times depend on the machine and on the number of workers.
    """
    console = Console()
    root = _checkout()
    try:
        from benchmarks.studies.bench import Progress as Told
        from benchmarks.studies.bench import run_studies
        from benchmarks.studies.page import PAGE, STUDIES
        from benchmarks.studies.study import StudyError
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("dask", "distributed"):
            raise
        pins = root / "requirements" / "pins.txt"
        words = f"{error.name} is not installed: run `make build`, or pip install -r {pins}"
        raise click.ClickException(words) from error
    unknown = [name for name in names if name not in STUDIES]
    if unknown:
        raise click.ClickException(f"{', '.join(unknown)}: no such study; choose from {', '.join(STUDIES)}")
    if scheduler is not None and workers is not None:
        raise click.ClickException("--workers: the scheduler has its own workers; pass --workers or --scheduler")
    names = tuple(dict.fromkeys(names)) or tuple(STUDIES)
    if drops is not None and "fig16" not in names:
        raise click.ClickException("--drops applies to fig16, which is not run; add fig16 to NAMES")
    sizes = [STUDIES[name].quick if quick else STUDIES[name].full for name in names]
    if drops is not None:
        sizes[names.index("fig16")] = sizes[names.index("fig16")]._replace(drops=drops)
    out = root / "docs" if out is None else out
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise click.ClickException(str(error)) from error
    done: list[str] = []
    bar = Progress(
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(),
        TextColumn("{task.fields[now]}"), console=console,
    )  # fmt: skip
    try:
        interrupt_on_signals()
        with bar:
            task = bar.add_task("starting", total=None, now="kernels, workers")
            told = Told(
                begin=lambda name, trials: bar.reset(task, total=trials, description=name, now=""),
                done=lambda trial: bar.update(task, advance=1, now=trial.words),
            )
            effort = "quick" if quick else "full"
            workers = workers or len(os.sched_getaffinity(0))
            for files in run_studies(names, sizes, effort, out, scheduler, workers, told):
                done.append(names[len(done)])
                for file in files:
                    bar.console.print(f"  {file}", highlight=False, soft_wrap=True)
    except StudyError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print(f"stopped; finished: {', '.join(done) or 'none'}", highlight=False, soft_wrap=True)
        sys.exit(INTERRUPTED)
    console.print(f"  {out / PAGE}", highlight=False, soft_wrap=True)


def _checkout() -> Path:
    """The root of the sources, added to the import path; ClickException if there are none."""
    root = Path(__file__).resolve().parents[2]
    if not (root / "benchmarks" / "studies" / "bench.py").is_file():
        raise click.ClickException(
            f"no benchmarks/ in {root}: it is not installed. Run this in a checkout of the sources, after"
            " `make build`."
        )
    if str(root) not in sys.path:
        sys.path.insert(0, str(root))
    return root

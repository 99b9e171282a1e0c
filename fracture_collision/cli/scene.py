"""`fracture-collision scene`: a scene in one process, and the paper's tables of it."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, ProgressBar, figures_table, options_as, print_report
from fracture_collision.process.early_signals import INTERRUPTED
from fracture_collision.process.outputs import NewOutputs

EXAMPLES = """\b
Examples:
  fracture-collision scene drop_bunnies
  fracture-collision scene bricks --seed 3 --curvature 0.25   other cracks, and curved
  fracture-collision scene plates --settings contacts_per_pair=6,method=glondu2014
  fracture-collision scene piggy_bank --count-colliding       how many points collide in all
  fracture-collision scene reference_sphere:coarse_inside     a variant defined in the file
  fracture-collision scene my.yaml --steps 200 --no-pictures  your own scene, its first steps
"""

RESULTS = ("report.json", "steps.csv", "times.png", "film_strip.png")


class RunOptions(NamedTuple):
    """What is varied of a scene and of the service."""

    seed: int | None  # None: the scene's own
    engine: str | None  # None: the scene's own
    curvature: float | None  # of all cracks; None: as in the scene
    settings: tuple[str, ...]  # NAME=VALUE[,...]
    threads: int
    steps: int | None  # at most; None: the scene's duration


@click.command(epilog=EXAMPLES)
@click.argument("name")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), help="Folder for the results.  [default: out/NAME]"
)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the fracture patterns.  [default: the scene's own]")
@click.option("--engine", help="What solves contacts and moves bodies: own, or mujoco.  [default: the scene's]")
@click.option("--curvature", type=click.FloatRange(min=0.0), help="Of all cracks: 0: flat; 0.25: as in porcelain.")
@click.option(
    "--settings", multiple=True, metavar="NAME=VALUE[,...]",
    help="Settings of the collision service, as in config/collision.yaml; may be given several times.  [default of "
    "lookahead: the scene's time step]",
)  # fmt: skip
@click.option(
    "--threads", type=click.IntRange(min=0), default=1, show_default=True,
    help="Threads of the service; 0: one per core. The paper's times are of one core.",
)  # fmt: skip
@click.option("--steps", type=click.IntRange(min=1), help="Number of steps.  [default: the scene's duration]")
@click.option("--count-colliding", is_flag=True, help="Count all colliding points, by an untimed query per step.")
@click.option("--pictures/--no-pictures", default=True, help="Draw times.png and film_strip.png.  [default: pictures]")
@options_as(RunOptions)
def scene(name: str, out: Path | None, count_colliding: bool, pictures: bool, options: RunOptions) -> None:
    """Run the scene NAME without ROS and report the times of each step.

    NAME is a name that `scenes` lists, NAME:VARIANT, or a scene file. Simulator and service run in this process, in
    turn. Prints sizes, statistics and times like Tables 1 to 3 of Glondu et al. 2014, beside the paper's figures where
    its text has them, and writes to the folder OUT:

    \b
      report.json      all figures
      steps.csv        figures of each step, one row per step
      times.png        times of each step
      film_strip.png   the run in pictures
    """  # noqa: D301 - \b is click's mark of a paragraph that it must not wrap
    console = Console()
    interruption = Interruption(console, "stopped")
    # Imported late: --help should not wait for numba and matplotlib.
    from fracture_collision.extras import MissingExtra
    from fracture_collision.scene_run import SceneRun
    from fracture_collision.simulation.engines import with_engine
    from fracture_collision.simulation.scene.scene import SceneError, load_scene
    from fracture_collision.simulation.scene.scene_changes import with_curvature
    from fracture_collision.world.settings import for_step

    try:
        what = with_engine(load_scene(name), options.engine)
        chosen = for_step(what.time_step, parse_settings(options.settings) | {"threads": options.threads})
        if options.curvature is not None:
            what = with_curvature(what, options.curvature)
        if options.steps is not None:
            what = what._replace(duration=min(options.steps, what.step_count) * what.time_step)
        out = Path("out", what.name.replace(":", "_")) if out is None else out
        with NewOutputs(out, RESULTS):  # fails before the run if it cannot be written
            pass
    except (SceneError, ValueError, MissingExtra) as error:
        raise BadInput(str(error)) from error
    except OSError as error:
        raise click.ClickException(str(error)) from error
    interruption.parting = f"stopped after 0 of {what.step_count} steps"
    try:
        with ProgressBar(console) as bar:
            bar.show(0, 0, 0.0, 0, 0, "loading kernels; after a change of the sources this takes minutes")
            run = SceneRun(what, chosen, options.seed, count_colliding)
            with run, interruption.held():
                for row in run:
                    bar.show(row.step + 1, what.step_count, row.time, row.fragments, row.contacts)
                    interruption.check()
    except KeyboardInterrupt:
        words = f"stopped after {len(run.rows)} of {what.step_count} steps"
        _leave(run, out, False, console)
        words += f"; {out / 'report.json'} and {out / 'steps.csv'} have these steps"
        console.print(words, highlight=False, soft_wrap=True)
        sys.exit(INTERRUPTED)
    interruption.parting = f"stopped; {out} is unchanged"
    try:
        with interruption.held():
            left = _leave(run, out, pictures, console, interruption.check)
    except KeyboardInterrupt:
        console.print("stopped; some results are missing")
        sys.exit(INTERRUPTED)
    for file in left:
        console.print(f"  {file}", highlight=False)


def parse_settings(assignments: tuple[str, ...]) -> dict[str, Any]:
    """The service's settings given as NAME=VALUE, separated by commas; ValueError names what is wrong."""
    from fracture_collision.near_names import did_you_mean
    from fracture_collision.world.settings import OF_SERVICE, Settings

    given: dict[str, Any] = {}
    for assignment in ",".join(assignments).split(",") if assignments else ():
        name, equals, value = (part.strip() for part in assignment.partition("="))
        if not equals:
            raise ValueError(f"--settings {assignment}: pass NAME=VALUE, such as contacts_per_pair=6")
        if name not in OF_SERVICE:
            hint = did_you_mean(name, OF_SERVICE)
            raise ValueError(f"--settings: no setting {name!r}{hint or ';'} `fracture-collision settings` lists all")
        kind = type(getattr(Settings(), name))
        try:
            given[name] = kind(value)
        except ValueError as error:
            raise ValueError(f"--settings {name}: {value!r} is not of type {kind.__name__}") from error
    return given


def _leave(
    run: Any, out: Path, pictures: bool, console: Console, check: Callable[[], None] = lambda: None
) -> list[Path]:
    """Prints the tables, replaces an earlier run's files; returns their paths.

    If `check` raises, the files are replaced without the remaining pictures.
    """
    names = RESULTS if pictures else RESULTS[:2]
    with NewOutputs(out, RESULTS) as new:
        report = run.report()
        files = [new.folder / name for name in names]
        files[0].write_text(json.dumps(report, indent=1))
        run.write_steps(files[1])
        new.started = True
        _tell(report, console)
        if pictures:
            from fracture_collision.viewer.film.film import draw_film_strip
            from fracture_collision.viewer.film.times_plot import plot_times

            with console.status("drawing pictures"):
                check()
                plot_times(report, files[2])
                check()
                draw_film_strip(run.film, files[3])
    return [out / name for name in names]


def _tell(report: dict[str, Any], console: Console) -> None:
    sizes = [[str(value) for value in size.values()] for size in report["sizes"]]
    columns = ("bodies", "triangles", "tetrahedra", "points", "of these inside")
    console.print(figures_table(f"{report['scene']}: sizes", columns, sizes))
    print_report(console, "statistics", report)

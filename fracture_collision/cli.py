"""`fracture-collision`, the command line."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import click
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from fracture_collision.share import share_directory

EXAMPLES = """\b
Examples:
  fracture-collision smash                        four plates on a shelf, into out/smash
  fracture-collision smash --seed 3 --out out/3   the same with other cracks
  fracture-collision smash --scene my.yaml        a scene of your own
  fracture-collision scenes                       which scenes there are
  fracture-collision digest out/smash/bag         equal for equal runs

The nodes alone: collision_node and simulator_node, with --ros-args -p NAME:=VALUE.
"""


@click.group(epilog=EXAMPLES, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
def main() -> None:
    """Collision detection for fracturing rigid bodies.

    Bodies are tetrahedral meshes that break; the service answers every simulation step with contact constraints and
    says how deep a penetration it could have missed. This command runs it end to end; as a library it is
    `fracture_collision.world`, as a ROS 2 node `collision_node`.
    """


@main.command()
@click.option("--scene", default="plates", show_default=True, help="A name that `scenes` lists, or a scene file.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("out/smash"), show_default=True,
    help="Folder for the results; those of an earlier run are replaced.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), help="Of the fracture patterns.  [default: the scene's own]")
def smash(scene: str, out: Path, seed: int | None) -> None:
    """Run a scene over ROS 2 and record it.

    Starts collision_node, simulator_node and a recorder as processes that talk over DDS on this machine alone, and
    leaves in the folder OUT:

    \b
      bag/             all topics, rosbag2 layout with MCAP: for Foxglove, rosbags, `ros2 bag`
      film_strip.png   the run in pictures
      times.png        what each step took
      report.json      the same as numbers
      logs/            what the nodes said
    """
    # Imported late: --help should not wait for ROS, numba and matplotlib.
    from fracture_collision.ros.smash_run import RunFailed, run_scene
    from fracture_collision.viewer.film_strip import render_film_strip
    from fracture_collision.viewer.times_plot import plot_times

    # SIGINT too: a shell starts what it puts into the background with SIGINT ignored
    for order in (signal.SIGINT, signal.SIGTERM):
        signal.signal(order, _as_interrupt)
    console = Console()
    try:
        with _progress_bar(console) as show:
            report = run_scene(scene, seed, out, show)
        (out / "report.json").write_text(json.dumps(report, indent=1))
        console.print(_table(report))
        with console.status("drawing pictures"):
            plot_times(report, out / "times.png")
            render_film_strip(out / "bag", out / "film_strip.png")
    except RunFailed as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print("stopped; all nodes have ended")
        sys.exit(130)
    for name in ("film_strip.png", "times.png", "report.json", "bag"):
        console.print(f"  {out / name}", highlight=False)


@main.command()
def scenes() -> None:
    """List the scenes that come with the package."""
    for file in sorted((share_directory() / "config" / "scenes").glob("*.yaml")):
        first = file.read_text().splitlines()[0].lstrip("# ")
        click.echo(f"{file.stem:12} {first}")


@main.command()
@click.argument("bag", type=click.Path(exists=True, file_okay=False, path_type=Path))
def digest(bag: Path) -> None:
    """Print a SHA-256 of each topic of a BAG folder: equal if and only if all messages are, byte for byte."""
    from fracture_collision.bag.reader import BagError, message_counts, topic_digest

    try:
        for topic, count in message_counts(bag).items():
            click.echo(f"{topic_digest(bag, topic)}  {count:6}  {topic}")
    except BagError as error:
        raise click.ClickException(str(error)) from error


def _as_interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


class _progress_bar:
    """A bar of simulation steps; called with each ros.smash_run.Progress."""

    def __init__(self, console: Console) -> None:
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.completed:.0f}/{task.total:.0f} steps"),
            TextColumn("{task.fields[now]}"), TimeElapsedColumn(), console=console,
        )  # fmt: skip
        self._task = self._bar.add_task("starting", total=0, now="")

    def __enter__(self) -> _progress_bar:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def __call__(self, at: Any) -> None:
        now = f"{at.time:.2f} s, {at.fragments} fragments, {at.contacts} contacts" if at.steps else ""
        self._bar.update(
            self._task, completed=at.step, total=at.steps, now=now, description="simulating" if at.steps else at.word
        )


def _table(report: dict[str, Any]) -> Table:
    table = Table(title=f"{report['scene']}: {len(report['step'])} steps in {report['seconds']:.1f} s")
    table.add_column("")
    for name in ("median", "worst"):
        table.add_column(name, justify="right")
    table.add_row("fragments at the end", f"{report['living_fragments']}", "")
    table.add_row("triangles of their surfaces", f"{report['triangles']}", "")
    summary = report["summary"]
    table.add_row("contacts a step", *(f"{summary['contacts'][name]:.0f}" for name in ("median", "worst")))
    for name, words in (
        ("collision_ms", "collision"),
        ("solver_ms", "contact solver"),
        ("update_ms", "update at a fracture"),
        ("round_trip_ms", "ROS round trip beyond those"),
        ("acknowledge_ms", "wait for the recorder"),
    ):
        values = summary[name]
        table.add_row(f"{words}, ms", *(f"{values[at]:.2f}" if values else "-" for at in ("median", "worst")))
    table.add_row("fastest at the end, mm/s", "", f"{1e3 * report['max_speed'][-1]:.3f}")
    table.add_row("deepest at the end, mm", "", f"{max(-1e3 * report['deepest_gap'][-1], 0.0):.3f}")
    return table


if __name__ == "__main__":
    main()

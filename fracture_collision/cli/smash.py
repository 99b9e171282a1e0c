"""`fracture-collision smash`: a scene over ROS 2."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, ProgressBar, print_report
from fracture_collision.process.early_signals import INTERRUPTED

if TYPE_CHECKING:
    from fracture_collision.geometry.generators import TetGeometry

OWN_SCENE, OWN_MESH = "scene.yaml", "mesh.npz"
RESULTS = ("bag", "film_strip.png", "times.png", "report.json", "logs", OWN_SCENE, OWN_MESH)


@click.command()
@click.option("--scene", default="plates", show_default=True, help="A name that `scenes` lists, or a scene file.")
@click.option(
    "--mesh", type=click.Path(path_type=Path),
    help="Your own body instead, dropped onto a floor and hit by a ball: a closed surface (.obj .stl .ply .off .glb),"
    " or tetrahedra (.npz; .msh, .vtu and others with meshio).",
)  # fmt: skip
@click.option(
    "--size", type=click.FloatRange(0.01, 10.0), default=0.3, show_default=True,
    help="With --mesh: its longest side, in metres.",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("out/smash"), show_default=True,
    help="Folder for the results; those of an earlier run are replaced once this one has answered a step.",
)  # fmt: skip
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the fracture patterns.  [default: the scene's own]")
@click.option("--engine", help="What solves contacts and moves bodies: own, or mujoco.  [default: the scene's]")
def smash(scene: str, mesh: Path | None, size: float, out: Path, seed: int | None, engine: str | None) -> None:
    """Run a scene over ROS 2 and record it.

    Starts collision_node, simulator_node and a recorder as processes that communicate over DDS on this machine only,
    and writes to the folder OUT:

    \b
      bag/             all topics, rosbag2 layout with MCAP: for Foxglove, rosbags, `ros2 bag`
      film_strip.png   the run in pictures
      times.png        times of each step
      report.json      the same as numbers
      logs/            log of each node
      scene.yaml       with --mesh: the scene made of it, and mesh.npz, its tetrahedra
    """  # noqa: D301 - \b is click's mark of a paragraph that it must not wrap
    console = Console()
    interruption = Interruption(console, "stopped")
    # Imported late: --help should not wait for ROS, numba and matplotlib.
    from fracture_collision.extras import MissingExtra
    from fracture_collision.process.outputs import NewOutputs
    from fracture_collision.ros.runs.run_domain import DomainTaken
    from fracture_collision.ros.runs.smash_run import Progress, RunFailed, run_scene
    from fracture_collision.simulation.engines import with_engine
    from fracture_collision.simulation.scene.scene import SceneError, load_scene
    from fracture_collision.viewer.film.film import render_film_strip
    from fracture_collision.viewer.film.times_plot import plot_times

    filled = None
    if mesh is not None:
        with console.status(f"filling {mesh} with tetrahedra"):
            filled = _filled(mesh, size)
    new = NewOutputs(out, RESULTS)
    try:
        if filled is None:
            with_engine(load_scene(scene), engine)
    except (SceneError, MissingExtra) as error:
        raise BadInput(str(error)) from error
    try:
        with interruption.held(), new:
            interruption.parting = "stopped; some results are missing"
            if filled is not None or _is_same_file(scene, out / OWN_SCENE):
                scene = str(_own_scene(filled, out, new.folder))
            with ProgressBar(console) as bar:

                def progress(at: Progress) -> None:
                    new.started |= at.step > 0
                    interruption.check()
                    bar.show(*at)

                report = run_scene(scene, seed, new.folder, progress, engine)
            report["scene"] = scene.replace(str(new.folder), str(out))
            (new.folder / "report.json").write_text(json.dumps(report, indent=1))
            print_report(console, f"{report['scene']}: statistics", report)
            interruption.check()
            with console.status("drawing pictures"):
                plot_times(report, new.folder / "times.png")
                render_film_strip(new.folder / "bag", new.folder / "film_strip.png")
    except (RunFailed, DomainTaken, OSError) as error:
        raise click.ClickException(str(error).replace(str(new.folder), str(out))) from error
    except KeyboardInterrupt:
        as_before = "" if new.published else f", and {out} is unchanged"
        console.print(f"stopped; all nodes have ended{as_before}", highlight=False, soft_wrap=True)
        sys.exit(INTERRUPTED)
    for name in ("film_strip.png", "times.png", "report.json", "bag"):
        console.print(f"  {out / name}", highlight=False)


def _filled(file: Path, size: float) -> TetGeometry:
    """The tetrahedra of a file, or those that fill its surface."""
    from fracture_collision.meshing import read_mesh

    try:
        return read_mesh(file, longest_side=size)
    except ValueError as error:
        raise BadInput(str(error)) from error
    except ModuleNotFoundError as error:
        raise click.ClickException(str(error)) from error


def _own_scene(filled: TetGeometry | None, out: Path, folder: Path) -> Path:
    """Writes mesh and scene to `folder`; None: copies those of an earlier run from `out`."""
    from fracture_collision.simulation.scene.scene_changes import write_own_scene

    scene = folder / OWN_SCENE
    if filled is None:
        for name in (OWN_SCENE, OWN_MESH):
            if (out / name).exists():
                shutil.copyfile(out / name, folder / name)
        return scene
    write_own_scene(scene, OWN_MESH, filled)
    return scene


def _is_same_file(scene: str, file: Path) -> bool:
    """`scene` may be a name, and the file not there."""
    return Path(scene).exists() and file.exists() and Path(scene).samefile(file)



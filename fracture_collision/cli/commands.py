"""All commands of `fracture-collision`."""

from __future__ import annotations

from typing import Any

import click

from fracture_collision import __version__
from fracture_collision.cli.bags import digest, mend, record
from fracture_collision.cli.bench import bench
from fracture_collision.cli.check_solver import check_solver
from fracture_collision.cli.play import play, teleop
from fracture_collision.cli.recorded import export, film, view
from fracture_collision.cli.replay import replay
from fracture_collision.cli.scene import scene
from fracture_collision.cli.smash import smash
from fracture_collision.extras import MissingExtra
from fracture_collision.process.full_disk import full_disk_words
from fracture_collision.ros.missing import REMEDY, is_ros_missing

EXAMPLES = """\b
Examples:
  fracture-collision smash                        four plates on a shelf, over ROS 2, into out/smash
  fracture-collision smash --seed 3 --out out/3   the same with other cracks
  fracture-collision smash --mesh bunny.obj       your own closed surface, dropped onto a floor
  fracture-collision scene bricks                 a scene without ROS: times, tables, a film strip
  fracture-collision scene --help                 ... and its options
  fracture-collision bench                        the paper's figures and tables, in some minutes
  fracture-collision check-solver mujoco          test a contact solver against closed forms
  fracture-collision scenes                       names of all scenes
  fracture-collision settings                     settings of the service, for --settings NAME=VALUE
  fracture-collision digest out/smash/bag         checksums, equal for equal runs
  fracture-collision replay out/smash/bag         repeat all queries and compare the answers
  fracture-collision replay --help                ... over DDS, backwards, on 8 threads
  fracture-collision record bricks --out out/b    a bag without DDS
  fracture-collision mend out/smash/bag           repair a bag whose recorder was killed
  fracture-collision play                         smash it yourself, in the browser
  fracture-collision teleop                       the hammer of a live scene by keys, from another terminal
  fracture-collision view out/smash/bag           a recorded run in the browser
  fracture-collision film out/smash/bag           ... as an animated picture
  fracture-collision export out/smash/bag         ... as a 3D animation (.glb) that needs no server

The nodes alone: collision_node and simulator_node, with --ros-args -p NAME:=VALUE.
"""


class Commands(click.Group):
    """All commands; those that need ROS say so where it is not installed, and all say if a disk is full."""

    def invoke(self, ctx: click.Context) -> Any:
        """As click does."""
        try:
            return super().invoke(ctx)
        except MissingExtra as error:
            raise click.ClickException(f"this command needs an extra: {error}") from error
        except ModuleNotFoundError as error:
            if not is_ros_missing(error):
                raise
            raise click.ClickException(f"this command needs {REMEDY}") from error
        except OSError as error:
            if not (words := full_disk_words(error)):
                raise
            raise click.ClickException(words) from error


@click.group(
    cls=Commands,
    epilog=EXAMPLES,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="fracture-collision")
def main() -> None:
    """Collision detection for fracturing rigid bodies.

    Bodies are tetrahedral meshes that break. The service answers every simulation step with contact constraints and a
    bound on the depth of penetrations that it may have missed. This command runs it end to end; the library is
    `fracture_collision.world`, the ROS 2 node `collision_node`.
    """


main.add_command(smash)
main.add_command(scene)
main.add_command(bench)
main.add_command(check_solver)
for command in (play, teleop, view, film, export, replay, record, mend, digest):
    main.add_command(command)


@main.command()
def settings() -> None:
    """List the settings of the collision service, with defaults and meaning.

    They are the parameters of collision_node, the fields of `fracture_collision.world.Settings`, and what the option
    --settings NAME=VALUE of other commands takes.
    """
    from fracture_collision.share import share_directory

    click.echo((share_directory() / "config" / "collision.yaml").read_text(encoding="utf-8"))


@main.command()
def scenes() -> None:
    """List the scenes that come with the package."""
    from fracture_collision.simulation.scene.scene import scene_files

    for file in scene_files():
        click.echo(f"{file.path.stem:17} {file.title}")
        for variant in file.variants:
            click.echo(f"{'':17} {file.path.stem}:{variant}")

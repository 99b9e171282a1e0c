"""`fracture-collision`, the command line."""

from __future__ import annotations

from pathlib import Path

import click

from fracture_collision.cli.bench import bench
from fracture_collision.cli.scene import scene
from fracture_collision.cli.smash import smash

EXAMPLES = """\b
Examples:
  fracture-collision smash                        four plates on a shelf, over ROS 2, into out/smash
  fracture-collision smash --seed 3 --out out/3   the same with other cracks
  fracture-collision scene bricks                 a scene without ROS: times, tables, a film strip
  fracture-collision scene --help                 ... and what can be varied
  fracture-collision bench                        the paper's figures and tables again, in some minutes
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


main.add_command(smash)
main.add_command(scene)
main.add_command(bench)


@main.command()
def scenes() -> None:
    """List the scenes that come with the package."""
    from fracture_collision.simulation.scene import scene_files

    for file in scene_files():
        click.echo(f"{file.path.stem:17} {file.title}")
        for variant in file.variants:
            click.echo(f"{'':17} {file.path.stem}:{variant}")


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

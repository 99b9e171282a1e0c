"""The commands for bags, except `replay`: `record`, `mend`, `digest`."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, counting_bar, interrupt_on_signals
from fracture_collision.process.early_signals import INTERRUPTED

RECORD_EXAMPLES = """\b
Examples:
  fracture-collision record plates --out out/plates_bag
  fracture-collision record bricks --out out/b --seed 3 --steps 400 --every 10
"""


@click.command(epilog=RECORD_EXAMPLES)
@click.argument("name")
@click.option("--out", type=click.Path(path_type=Path), required=True, help="Folder of the bag; must not exist yet.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the fracture patterns.  [default: the scene's own]")
@click.option("--engine", help="What solves contacts and moves bodies: own, or mujoco.  [default: the scene's]")
@click.option("--curvature", type=click.FloatRange(min=0.0), help="Of all cracks: 0: flat; 0.25: as in porcelain.")
@click.option(
    "--settings", multiple=True, metavar="NAME=VALUE[,...]",
    help="Settings of the collision service.  [default of lookahead: the scene's time step]",
)  # fmt: skip
@click.option("--steps", type=click.IntRange(min=1), help="Number of steps.  [default: the scene's duration]")
@click.option("--every", type=click.IntRange(min=1), default=1, show_default=True, help="Record every N-th step.")
def record(
    name: str, out: Path, seed: int | None, engine: str | None, curvature: float | None, settings: tuple[str, ...],
    steps: int | None, every: int,
) -> None:  # fmt: skip
    """Run the scene NAME without DDS and record it.

    The bag has bodies, fracture events, states and contacts, byte for byte as the nodes publish them and recorder_node
    records them. It has no registries, meshes and diagnostics. Recording a scene takes some seconds.
    """
    console = Console()
    interruption = Interruption(console, "stopped")
    from fracture_collision.cli.scene import parse_settings
    from fracture_collision.extras import MissingExtra
    from fracture_collision.ros.runs.scene_recording import Selection, record_scene
    from fracture_collision.simulation.engines import with_engine
    from fracture_collision.simulation.scene.scene import SceneError, load_scene
    from fracture_collision.simulation.scene.scene_changes import with_curvature
    from fracture_collision.world.settings import for_step

    try:
        scene = with_engine(load_scene(name), engine)
        chosen = for_step(scene.time_step, parse_settings(settings))
        if curvature is not None:
            scene = with_curvature(scene, curvature)
        if out.exists():
            raise BadInput(f"{out} exists already; pass the name of a new folder")
    except (SceneError, ValueError, MissingExtra) as error:
        raise BadInput(str(error)) from error
    try:
        total = scene.step_count if steps is None else min(steps, scene.step_count)
        with counting_bar(console, "recording", "steps") as progress, interruption.held():
            for done in record_scene(scene, chosen, seed, out, Selection(end=total, every=every)):
                progress(done, total)
                interruption.check()
    except OSError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print(f"stopped; {out} has the steps recorded so far", highlight=False, soft_wrap=True)
        sys.exit(INTERRUPTED)
    console.print(f"  {out}", highlight=False)


@click.command()
@click.argument("bag", type=click.Path(exists=True, file_okay=False, path_type=Path))
def mend(bag: Path) -> None:
    """Repair a BAG folder whose recorder was killed: add the missing index and metadata.

    Rewrites its .mcap files and metadata.yaml; each replaces the old file when it is complete. All readable messages
    stay as they are; unreadable data is reported and dropped. A complete bag is rewritten, too.
    """
    from fracture_collision.bag.mcap_file import BagError
    from fracture_collision.bag.writer import mend_bag

    try:
        interrupt_on_signals()
        mended = mend_bag(bag)
    except BagError as error:
        raise BadInput(str(error)) from error
    except OSError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        click.echo(f"stopped; each file of {bag} is either unchanged or repaired")
        sys.exit(INTERRUPTED)
    for words in mended.damaged:
        click.echo(f"dropped: {words}")
    lost = f"; dropped {mended.lost_bytes} unreadable bytes" if mended.lost_bytes else ""
    click.echo(f"{bag}: {mended.messages} messages{lost}")


@click.command()
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
def digest(bag: Path) -> None:
    """Print a SHA-256 of each topic of a BAG.

    Two digests are equal if and only if all messages are, byte for byte but for their random run ids.
    """
    from fracture_collision.bag.mcap_file import BagError
    from fracture_collision.bag.reader import message_counts, missing_words, topic_digest

    try:
        for words in missing_words(bag):
            click.echo(f"note: {words}", err=True)
        for topic, count in message_counts(bag).items():
            click.echo(f"{topic_digest(bag, topic)}  {count:6}  {topic}")
    except BagError as error:
        raise BadInput(str(error)) from error

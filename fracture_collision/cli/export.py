"""`fracture-collision export`: a recorded run as one file that plays without a server."""

from __future__ import annotations

import sys
from pathlib import Path

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, counting_bar
from fracture_collision.process.early_signals import INTERRUPTED

EXAMPLES = """\b
Examples:
  fracture-collision export out/smash/bag                     writes out/smash/bag.glb
  fracture-collision export bags/plates --out plates.glb

\b
Exit status: 2: not a bag, or no run in it.
"""


@click.command(epilog=EXAMPLES)
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="A .glb file.  [default: BAG.glb]")
@click.option("--fps", type=click.FloatRange(1.0, 1000.0), default=60.0, show_default=True, help="Poses per second.")
@click.option("--namespace", help="Namespace of the topics, for a bag with several services.")
def export(bag: Path, out: Path | None, fps: float, namespace: str | None) -> None:
    """Write the last run of BAG, a rosbag2 folder or one .mcap file, as an animation in one file.

    The file is binary glTF 2.0: viewers of 3D files, Blender and browsers play it. It has no contacts.
    """
    console = Console()
    interruption = Interruption(console, "stopped; no file was written")
    # Imported late: --help should not wait for numba.
    from fracture_collision.bag.errors import BagError
    from fracture_collision.run_meshes import read_run_with_meshes
    from fracture_collision.viewer.film.animated_gltf import animated_glb

    out = out or bag.resolve().with_suffix(".glb")
    if out.suffix.lower() != ".glb":
        raise click.UsageError(f"--out {out}: pass a name that ends with .glb")
    try:
        with counting_bar(console, "making meshes", "fractures") as progress:
            run = read_run_with_meshes(bag, namespace, progress)
        content = animated_glb(run, fps)
        with interruption.held():
            part = out.with_name(f".{out.name}.part")
            part.write_bytes(content)
            part.replace(out)
    except BagError as error:
        raise BadInput(str(error)) from error
    except OSError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    console.print(f"  {out}: {len(content) / 1e6:.1f} MB", highlight=False, soft_wrap=True)

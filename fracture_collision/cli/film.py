"""`fracture-collision film`: a recorded run as an animated picture or an MP4."""

from __future__ import annotations

import re
import sys
from pathlib import Path
from typing import Any, NamedTuple

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, counting_bar, options_as
from fracture_collision.process.early_signals import INTERRUPTED

EXAMPLES = """\b
Examples:
  fracture-collision film out/smash/bag                       writes out/smash/bag.webp
  fracture-collision film out/smash/bag --out smash.mp4       uses the installed ffmpeg
  fracture-collision film out/smash/bag --begin 0.3 --end 0.8 --speed 0.1 --out crash.gif
"""


class PictureSize(click.ParamType):
    """WxH as (W, H)."""

    name = "WxH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """(width, height) [pixels]; a usage error unless both are at least 16."""
        if not isinstance(value, str):
            return value
        found = re.fullmatch(r"(\d{1,4})x(\d{1,4})", value)
        width, height = map(int, found.groups()) if found else (0, 0)
        if min(width, height) < 16:
            self.fail(f"{value!r}: pass WxH, such as 640x360, of at least 16 pixels each", param, ctx)
        return width, height


class FilmOptions(NamedTuple):
    """Which part of the run is filmed, and how."""

    fps: float  # frames a second of film
    size: tuple[int, int]  # width and height [pixels]
    begin: float  # [s] simulated
    end: float | None  # [s] simulated; None: the end of the run
    speed: float  # [s] simulated in a second of film
    samples: int  # rays for each pixel


@click.command(epilog=EXAMPLES)
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--out", type=click.Path(dir_okay=False, path_type=Path),
    help="A .webp, .gif or .mp4.  [default: BAG.webp]",
)  # fmt: skip
@click.option("--fps", type=click.FloatRange(1.0, 100.0), default=25.0, show_default=True, help="Frames per second.")
@click.option("--size", type=PictureSize(), default="640x360", show_default=True, help="Width and height in pixels.")
@click.option("--begin", type=click.FloatRange(min=0.0), default=0.0, help="Simulated time [s].  [default: first]")
@click.option("--end", type=click.FloatRange(min=0.0), help="Simulated time [s].  [default: last]")
@click.option(
    "--speed", type=click.FloatRange(0.001, 100.0), default=1.0, show_default=True,
    help="Simulated seconds per second of film.",
)  # fmt: skip
@click.option("--samples", type=click.IntRange(1, 64), default=4, show_default=True, help="Rays per pixel.")
@click.option("--namespace", help="Namespace of the topics, for a bag with several services.")
@options_as(FilmOptions)
def film(bag: Path, out: Path | None, namespace: str | None, options: FilmOptions) -> None:
    """Make a film of the last run of BAG: a rosbag2 folder, or one .mcap file.

    Times count from the first recorded states. The film appears under its name when it is complete.
    """
    console = Console()
    interruption = Interruption(console, "stopped; no film was written")
    # Imported late: --help should not wait for numba.
    from fracture_collision.bag.errors import BagError
    from fracture_collision.run_meshes import read_run_with_meshes
    from fracture_collision.viewer.film.film import Cut, FilmError, make_film, require_format

    out = out or bag.resolve().with_suffix(".webp")
    end = float("inf") if options.end is None else options.end
    cut = Cut(options.begin, end, options.speed, options.fps, *options.size, options.samples)
    try:
        require_format(out)
        with counting_bar(console, "making meshes", "fractures") as progress:
            run = read_run_with_meshes(bag, namespace, progress)
        with counting_bar(console, "drawing", "frames") as progress, interruption.held():

            def drawn(done: int, total: int) -> None:
                interruption.check()
                progress(done, total)

            count = make_film(run, out, cut, drawn)
    except (BagError, FilmError) as error:
        raise BadInput(str(error)) from error
    except (OSError, ModuleNotFoundError) as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print("stopped; no film was written")
        sys.exit(INTERRUPTED)
    console.print(f"  {out}: {count} frames, {out.stat().st_size / 1e6:.1f} MB", highlight=False, soft_wrap=True)

"""The commands that show a recorded run: `view` in the browser, `film` as a picture, `export` as a 3D animation."""

from __future__ import annotations

import re
import sys
import webbrowser
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, counting_bar, options_as
from fracture_collision.process.early_signals import INTERRUPTED

if TYPE_CHECKING:
    from fracture_collision.viewer.film.recorded_run import RecordedRun

VIEW_EXAMPLES = """\b
Examples:
  fracture-collision view out/smash/bag
  fracture-collision view bags/bricks --speed 0.1      at a tenth of the speed
  fracture-collision view bags/plates --port 8080 --no-open

\b
Exit status: 0: ended by Ctrl-C; 130: likewise, before the page was served; 2: not a bag, or no run in it.
"""
FILM_EXAMPLES = """\b
Examples:
  fracture-collision film out/smash/bag                       writes out/smash/bag.webp
  fracture-collision film out/smash/bag --out smash.mp4       uses the installed ffmpeg
  fracture-collision film out/smash/bag --begin 0.3 --end 0.8 --speed 0.1 --out crash.gif
"""
EXPORT_EXAMPLES = """\b
Examples:
  fracture-collision export out/smash/bag                     writes out/smash/bag.glb
  fracture-collision export bags/plates --out plates.glb

\b
Exit status: 2: not a bag, or no run in it.
"""


def recorded_run(command: Callable[..., None]) -> Callable[..., None]:
    """Decorates a command of a recorded run: it gets the argument `bag` and the option `namespace`."""
    bag = click.argument("bag", type=click.Path(exists=True, path_type=Path))
    return bag(click.option("--namespace", help="Namespace of the topics, for a bag with several services.")(command))


@contextmanager
def reading(bag: Path, namespace: str | None, console: Console) -> Iterator[RecordedRun]:
    """The last run of the bag, with meshes. Errors of the bag and of files are those of the command."""
    # Imported late: --help should not wait for numba.
    from fracture_collision.bag.mcap_file import BagError
    from fracture_collision.run_meshes import read_run_with_meshes

    try:
        with counting_bar(console, "making meshes", "fractures") as progress:
            run = read_run_with_meshes(bag, namespace, progress)
        yield run
    except BagError as error:
        raise BadInput(str(error)) from error
    except OSError as error:
        raise click.ClickException(str(error)) from error


@click.command(epilog=VIEW_EXAMPLES)
@recorded_run
@click.option(
    "--speed", type=click.FloatRange(0.02, 2.0), default=1.0, show_default=True, help="Simulated seconds per second."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page.  [default: any free one]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Of the page; 0.0.0.0: open to the network.")
@click.option("--open/--no-open", "opens", default=True, help="Open a browser.  [default: open]")
def view(bag: Path, speed: float, port: int, host: str, opens: bool, namespace: str | None) -> None:
    """Play the last run of BAG in a page in the browser, until Ctrl-C.

    BAG is a rosbag2 folder or one .mcap file. The page has a time bar, and shows contacts, pairs and bounds where the
    bag has the service's answers. Meshes of fragments that were not recorded are computed.
    """
    console = Console()
    interruption = Interruption(console, "stopped")
    with reading(bag, namespace, console) as run:
        from fracture_collision.viewer.page.bag_player import BagPlayer

        try:
            player = BagPlayer(run, host, port, speed, bag.resolve().name)
        except OSError as error:
            raise click.ClickException(f"the page cannot be served at {host}, port {port}: {error}") from error
    with player:
        try:
            with interruption.held():
                console.print(f"{player.page.address}   (Ctrl-C ends it)", highlight=False, soft_wrap=True)
                if opens:
                    webbrowser.open(player.page.address)
                player.play_until(interruption.check)
        except KeyboardInterrupt:
            console.print("ended")


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


@click.command(epilog=FILM_EXAMPLES)
@recorded_run
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
@options_as(FilmOptions)
def film(bag: Path, out: Path | None, namespace: str | None, options: FilmOptions) -> None:
    """Make a film of the last run of BAG: a rosbag2 folder, or one .mcap file.

    Times count from the first recorded states. The film appears under its name when it is complete.
    """
    console = Console()
    interruption = Interruption(console, "stopped; no film was written")
    from fracture_collision.viewer.film.film import Cut, FilmError, make_film, require_format  # late: of an extra

    out = out or bag.resolve().with_suffix(".webp")
    end = float("inf") if options.end is None else options.end
    cut = Cut(options.begin, end, options.speed, options.fps, *options.size, options.samples)
    try:
        require_format(out)
        with reading(bag, namespace, console) as run, counting_bar(console, "drawing", "frames") as progress:

            def drawn(done: int, total: int) -> None:
                interruption.check()
                progress(done, total)

            with interruption.held():
                count = make_film(run, out, cut, drawn)
    except FilmError as error:
        raise BadInput(str(error)) from error
    except ModuleNotFoundError as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print("stopped; no film was written")
        sys.exit(INTERRUPTED)
    console.print(f"  {out}: {count} frames, {out.stat().st_size / 1e6:.1f} MB", highlight=False, soft_wrap=True)


@click.command(epilog=EXPORT_EXAMPLES)
@recorded_run
@click.option("--out", type=click.Path(dir_okay=False, path_type=Path), help="A .glb file.  [default: BAG.glb]")
@click.option("--fps", type=click.FloatRange(1.0, 1000.0), default=60.0, show_default=True, help="Poses per second.")
def export(bag: Path, out: Path | None, fps: float, namespace: str | None) -> None:
    """Write the last run of BAG, a rosbag2 folder or one .mcap file, as an animation in one file.

    The file is binary glTF 2.0: viewers of 3D files, Blender and browsers play it. It has no contacts.
    """
    console = Console()
    interruption = Interruption(console, "stopped; no file was written")
    out = out or bag.resolve().with_suffix(".glb")
    if out.suffix.lower() != ".glb":
        raise click.UsageError(f"--out {out}: pass a name that ends with .glb")
    try:
        with reading(bag, namespace, console) as run:
            from fracture_collision.viewer.film.animated_gltf import animated_glb

            content = animated_glb(run, fps)
            with interruption.held():
                part = out.with_name(f".{out.name}.part")
                part.write_bytes(content)
                part.replace(out)
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    console.print(f"  {out}: {len(content) / 1e6:.1f} MB", highlight=False, soft_wrap=True)

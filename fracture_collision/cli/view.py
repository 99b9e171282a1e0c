"""`fracture-collision view`: a recorded run in the browser."""

from __future__ import annotations

import webbrowser
from pathlib import Path

import click
from rich.console import Console

from fracture_collision.cli.console import BadInput, Interruption, counting_bar

EXAMPLES = """\b
Examples:
  fracture-collision view out/smash/bag
  fracture-collision view bags/bricks --speed 0.1      at a tenth of the speed
  fracture-collision view bags/plates --port 8080 --no-open

\b
Exit status: 0: ended by Ctrl-C; 130: likewise, before the page was served; 2: not a bag, or no run in it.
"""


@click.command(epilog=EXAMPLES)
@click.argument("bag", type=click.Path(exists=True, path_type=Path))
@click.option(
    "--speed", type=click.FloatRange(0.02, 2.0), default=1.0, show_default=True, help="Simulated seconds per second."
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page.  [default: any free one]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Of the page; 0.0.0.0: open to the network.")
@click.option("--open/--no-open", "opens", default=True, help="Open a browser.  [default: open]")
@click.option("--namespace", help="Namespace of the topics, for a bag with several services.")
def view(bag: Path, speed: float, port: int, host: str, opens: bool, namespace: str | None) -> None:
    """Play the last run of BAG in a page in the browser, until Ctrl-C.

    BAG is a rosbag2 folder or one .mcap file. The page has a time bar, and shows contacts, pairs and bounds where the
    bag has the service's answers. Meshes of fragments that were not recorded are computed.
    """
    console = Console()
    interruption = Interruption(console, "stopped")
    # Imported late: --help should not wait for numba and viser.
    from fracture_collision.bag.errors import BagError
    from fracture_collision.run_meshes import read_run_with_meshes
    from fracture_collision.viewer.page.bag_player import BagPlayer

    try:
        with counting_bar(console, "making meshes", "fractures") as progress:
            run = read_run_with_meshes(bag, namespace, progress)
        player = BagPlayer(run, host, port, speed, bag.resolve().name)
    except BagError as error:
        raise BadInput(str(error)) from error
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

"""`fracture-collision play`: a live scene in the browser."""

from __future__ import annotations

import time
import webbrowser
from pathlib import Path

import click
from rich.console import Console
from rich.panel import Panel

from fracture_collision.cli.console import interrupt_on_signals

LOOK = 0.2  # [s]

TO_DO = """\b
On the page:
  click              a ball flies there from where you look (speed and size by slider)
  drag a fragment    it follows the mouse on a spring
  arrow keys         drive the hammer; so do `fracture-collision teleop` and any teleop tool that speaks cmd_vel
  sliders            contacts a pair, epsilon, field and budget of the service: see times and error move
  record             writes a bag for `fracture-collision view`, `film` and `replay`
"""


@click.command(epilog=TO_DO)
@click.option("--scene", default="plates", show_default=True, help="A name that `scenes` lists, or a scene file.")
@click.option("--seed", type=click.IntRange(min=0), help="Of the fracture patterns.  [default: the scene's own]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Address to serve; 0.0.0.0: whoever gets here.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Of the page.  [default: any that is free]")
@click.option("--open/--no-open", "opens", default=True, show_default=True, help="Open it in your browser.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("out/play"), show_default=True,
    help="Folder for recordings and what the nodes say.",
)  # fmt: skip
def play(scene: str, seed: int | None, host: str, port: int, opens: bool, out: Path) -> None:
    """Smash a scene yourself, in the browser.

    Starts collision_node, live_simulator_node and the page as processes that talk over DDS on this machine alone, and
    runs until Ctrl-C. `ros2 topic list` and nodes of your own see the same topics, in the domain that is named.
    """
    console = Console()
    # Imported late: --help should not wait for ROS.
    from fracture_collision.ros.runs.play_run import PlayFailed, played

    try:
        interrupt_on_signals()
        with console.status("starting the nodes"), played(scene, -1 if seed is None else seed, out, host, port) as run:
            console.print(
                Panel(
                    f"[bold]{run.address}[/bold]\n\nROS_DOMAIN_ID={run.domain_id}; Ctrl-C ends it all",
                    title=f"{scene}, to smash", expand=False,
                )  # fmt: skip
            )
            if opens:
                webbrowser.open(run.address)
            while True:
                run.check()
                time.sleep(LOOK)
    except (PlayFailed, OSError) as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print("ended; all nodes are gone")

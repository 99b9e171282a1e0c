"""`fracture-collision play`, a live scene in the browser, and `teleop`, its hammer by the keys of a terminal."""

from __future__ import annotations

import sys
import time
import webbrowser
from contextlib import suppress
from pathlib import Path

import click
from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.text import Text

from fracture_collision.cli.console import BadInput, interrupt_on_signals

LOOK = 0.2  # [s]

TO_DO = """\b
On the page:
  click              throw a ball there (speed and size by slider)
  drag a fragment    pull it by a spring
  arrow keys         drive the hammer; `fracture-collision teleop` and other publishers of cmd_vel do as well
  settings           contacts_per_pair, penetration_tolerance and method of the service
  rewind 10 s        go back and try again; the scene waits there, paused
  upload a mesh      your own body, to smash
  help               explains every control
  record             write a bag for `fracture-collision view`, `film` and `replay`
"""


@click.command(epilog=TO_DO)
@click.option("--scene", default="plates", show_default=True, help="A name that `scenes` lists, or a scene file.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the fracture patterns.  [default: the scene's own]")
@click.option("--host", default="127.0.0.1", show_default=True, help="Of the page; 0.0.0.0: open to the network.")
@click.option("--port", type=click.IntRange(0, 65535), default=0, help="Port of the page.  [default: any free one]")
@click.option("--open/--no-open", "opens", default=True, show_default=True, help="Open a browser.")
@click.option(
    "--out", type=click.Path(file_okay=False, path_type=Path), default=Path("out/play"), show_default=True,
    help="Folder for recordings, uploads and logs.",
)  # fmt: skip
@click.option("--engine", help="What solves contacts and moves bodies: own, or mujoco.  [default: the scene's]")
def play(
    scene: str, seed: int | None, host: str, port: int, opens: bool, out: Path, engine: str | None
) -> None:  # fmt: skip
    """Smash a scene yourself, in the browser.

    Starts collision_node, live_simulator_node and the page as processes that communicate over DDS on this machine only,
    and runs until Ctrl-C. Other nodes, such as `ros2 topic list`, see the topics in the domain that it prints:
    ROS_DOMAIN_ID if set, else 0, or a free one if another run has that.
    """
    console = Console()
    # Imported late: --help should not wait for ROS.
    from fracture_collision.extras import MissingExtra
    from fracture_collision.ros.runs.play_run import PlayFailed, played
    from fracture_collision.ros.runs.run_domain import DomainTaken
    from fracture_collision.simulation.config.scene_fields import SceneError
    from fracture_collision.world.first_start import cache_is_cold

    cold = cache_is_cold()
    try:
        interrupt_on_signals()
        with console.status("starting the nodes"), played(
            scene, -1 if seed is None else seed, out, host, port, engine or ""
        ) as run:  # fmt: skip
            console.print(
                Panel(
                    f"[bold]{run.address}[/bold]\n\nROS_DOMAIN_ID={run.domain_id}; Ctrl-C ends all nodes",
                    title=f"{scene}, to smash", expand=False,
                )  # fmt: skip
            )
            if cold:
                console.print("The first start compiles kernels: the scene moves in some minutes.")
            if opens:
                webbrowser.open(run.address)
            while True:
                run.check()
                time.sleep(LOOK)
    except (SceneError, MissingExtra) as error:
        raise BadInput(str(error)) from error
    except (PlayFailed, DomainTaken, OSError) as error:
        raise click.ClickException(str(error)) from error
    except KeyboardInterrupt:
        console.print("stopped; all nodes have ended")


KEYS = """\b
Keys:
  arrows, or w a s d      away, left, towards you, right
  page up, page down      up, down (r and f too)
  + and -                 faster, slower
  space                   stop
  q, Ctrl-C               quit
"""
WORDS = {
    (1, 0, 0): "right", (-1, 0, 0): "left", (0, 1, 0): "away", (0, -1, 0): "towards you", (0, 0, 1): "up",
    (0, 0, -1): "down", (0, 0, 0): "at rest",
}  # fmt: skip


@click.command(epilog=KEYS)
@click.option(
    "--speed", type=click.FloatRange(0.05, 4.0), default=1.0, show_default=True, help="Initial speed in m/s."
)
@click.option("--namespace", default="", help="Namespace of the live scene's topics.")
def teleop(speed: float, namespace: str) -> None:
    """Drive the hammer of a live scene (`fracture-collision play`) by keys.

    Publishes geometry_msgs/Twist on cmd_vel: linear, in m/s, along the world's axes. Other teleop tools work as well.
    ROS_DOMAIN_ID must be that of the scene, which `play` prints.
    """
    if not sys.stdin.isatty():
        raise click.UsageError("standard input is not a terminal; run teleop in one")
    from fracture_collision.ros.nodes.teleop import Told, drive
    from fracture_collision.ros.processes.node_process import default_domain_id

    console = Console()
    try:
        domain_id = default_domain_id()
    except ValueError as error:
        raise BadInput(str(error)) from error
    click.echo(KEYS.replace("\b\n", ""))
    with suppress(KeyboardInterrupt), Live(console=console, refresh_per_second=10) as line:

        def told(now: Told) -> None:
            none = f"no subscriber in domain {domain_id} yet"
            subscribers = f"subscribers: {now.listeners}" if now.listeners else none
            line.update(Text(f"{WORDS[now.direction]:12} {now.speed:.2f} m/s   {subscribers}"))

        interrupt_on_signals()
        drive(domain_id, namespace, speed, told)

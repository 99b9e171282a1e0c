"""`fracture-collision teleop`: the keys of a terminal drive the hammer of a live scene."""

from __future__ import annotations

import sys
from contextlib import suppress

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

from fracture_collision.cli.console import interrupt_on_signals

KEYS = """\b
Keys:
  arrows, or w a s d      away, left, towards you, right
  page up, page down      up, down (r and f too)
  + and -                 faster, slower
  space                   stand still
  q, Ctrl-C               end
"""
WORDS = {
    (1, 0, 0): "right", (-1, 0, 0): "left", (0, 1, 0): "away", (0, -1, 0): "towards you", (0, 0, 1): "up",
    (0, 0, -1): "down", (0, 0, 0): "stands",
}  # fmt: skip


@click.command(epilog=KEYS)
@click.option(
    "--speed", type=click.FloatRange(0.05, 4.0), default=1.0, show_default=True, help="[m/s] at the beginning."
)
@click.option("--namespace", default="", help="Of the live scene's topics.")
def teleop(speed: float, namespace: str) -> None:
    """Drive the hammer of a live scene (`fracture-collision play`) by keys.

    Publishes geometry_msgs/Twist on cmd_vel: linear, in m/s, along the world's axes; any other teleop tool does as
    well. ROS_DOMAIN_ID must be that of the scene; `play` says which one that is.
    """
    if not sys.stdin.isatty():
        raise click.UsageError("keys come from a terminal, and this is none")
    from fracture_collision.ros.nodes.teleop import Told, drive
    from fracture_collision.ros.processes.node_process import default_domain_id

    console = Console()
    domain_id = default_domain_id()
    click.echo(KEYS.replace("\b\n", ""))
    with suppress(KeyboardInterrupt), Live(console=console, refresh_per_second=10) as line:

        def told(now: Told) -> None:
            heard = f"{now.listeners} listening" if now.listeners else f"nobody listens in domain {domain_id} yet"
            line.update(Text(f"{WORDS[now.direction]:12} {now.speed:.2f} m/s   {heard}"))

        interrupt_on_signals()
        drive(domain_id, namespace, speed, told)

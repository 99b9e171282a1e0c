"""`fracture-collision teleop`: the keys of a terminal drive the hammer of a live scene."""

from __future__ import annotations

import sys
from contextlib import suppress

import click
from rich.console import Console
from rich.live import Live
from rich.text import Text

from fracture_collision.cli.console import BadInput, interrupt_on_signals

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

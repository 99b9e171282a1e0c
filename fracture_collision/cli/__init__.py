"""`fracture-collision`, the command line: see `commands`.

Its modules take a while to import, and an interpreter that is interrupted meanwhile prints a traceback of whatever it
was at. So SIGINT and SIGTERM end the process at once, until a command has something to end in order and takes them over
(`console`).
"""

from __future__ import annotations

from collections.abc import Sequence

from fracture_collision.early_signals import INTERRUPTED, signals_end_at_once


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command; None: of the process's arguments. Ends by SystemExit."""
    signals_end_at_once(INTERRUPTED)
    from fracture_collision.cli.commands import main as command

    command(arguments)

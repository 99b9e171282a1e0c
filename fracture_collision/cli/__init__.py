"""`fracture-collision`, the command line: see `commands`.

Its modules take a while to import, and an interpreter that is interrupted meanwhile prints a traceback. So SIGINT and
SIGTERM end the process at once, until a command that must end in order installs its own handlers (`console`).
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

from fracture_collision.extras import MissingExtra, need
from fracture_collision.process.early_signals import INTERRUPTED, signals_end_at_once


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs one command; None: the process's arguments. Ends with SystemExit."""
    signals_end_at_once(INTERRUPTED)
    try:
        need("cli", "the command line")
    except MissingExtra as missing:
        sys.exit(f"Error: {missing}")
    from fracture_collision.cli.commands import main as command

    command(arguments)

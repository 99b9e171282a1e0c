"""config/collision.yaml has the settings of world/settings.py and the other parameters of the collision node.

`python -m lint.collision_config` says whether it has, `--write` writes it.
"""

from __future__ import annotations

import sys
import textwrap
from pathlib import Path

FILE = Path(__file__).parents[1] / "config" / "collision.yaml"
HEAD = """\
# All settings of the collision service, with their defaults.
#   ros2 run fracture_collision collision_node --ros-args --params-file collision.yaml
#
# All of them except timing_file may change while the service runs (`ros2 param set`); the next answer uses the new
# value. /diagnostics shows the settings in force and since which step.
#
# R is half the longest side of a body's box; of a pair, the smaller one counts. Lengths are given as a share of R, so
# that the same values fit a shard of a cup and a block of a bridge.

/**/collision_node:
  ros__parameters:
"""
WIDTH = 118


def expected() -> str:
    """The text of the file."""
    from fracture_collision.ros.service.collision_node import CollisionNode

    entries = []
    for declaration in CollisionNode.PARAMETERS:
        value = declaration.default
        text = str(value).lower() if isinstance(value, bool) else '""' if value == "" else str(value)
        comment = textwrap.fill(
            declaration.description, WIDTH, initial_indent="    # ", subsequent_indent="    # ", break_on_hyphens=False
        )
        entries.append(f"{comment}\n    {declaration.name}: {text}\n")
    return HEAD + "\n".join(entries)


def main() -> None:
    """Check or write the file."""
    if "--write" in sys.argv:
        FILE.write_text(expected(), encoding="utf-8")
    elif FILE.read_text(encoding="utf-8") != expected():
        sys.exit(f"{FILE.name} differs from the settings: python -m lint.collision_config --write")


if __name__ == "__main__":
    main()

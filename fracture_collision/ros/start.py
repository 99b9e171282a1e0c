"""The nodes as commands: `collision_node`, or `python -m fracture_collision.ros.start collision_node`.

A node takes a second to import; a signal meanwhile ends it with status 0, as usual (processes/process.py).
"""

from __future__ import annotations

import sys
from importlib import import_module

from fracture_collision.extras import MissingExtra
from fracture_collision.process.early_signals import signals_end_at_once
from fracture_collision.ros.missing import REMEDY, is_ros_missing

# node -> its folder
NODES = {
    "collision_node": "service",
    "simulator_node": "nodes",
    "live_simulator_node": "nodes",
    "page_node": "nodes",
    "recorder_node": "nodes",
}


def module_of(node: str) -> str:
    """Import name of the module of one of NODES."""
    return f"fracture_collision.ros.{NODES[node]}.{node}"


def start(node: str) -> int:
    """Runs one of NODES with the process's arguments; returns its exit status."""
    signals_end_at_once(0)
    try:
        module = import_module(module_of(node))
    except MissingExtra as error:
        print(f"{node}: {error}", file=sys.stderr)
        return 1
    except ModuleNotFoundError as error:
        if not is_ros_missing(error):
            raise
        print(f"{node} needs {REMEDY}", file=sys.stderr)
        return 1
    return module.main()


def collision_node() -> int:
    """Runs the collision service; returns its exit status."""
    return start("collision_node")


def simulator_node() -> int:
    """Runs the simulator; returns its exit status."""
    return start("simulator_node")


def live_simulator_node() -> int:
    """Runs the live simulator; returns its exit status."""
    return start("live_simulator_node")


def page_node() -> int:
    """Runs the page; returns its exit status."""
    return start("page_node")


def recorder_node() -> int:
    """Runs the recorder; returns its exit status."""
    return start("recorder_node")


if __name__ == "__main__":
    if sys.argv[1:2] == [] or sys.argv[1] not in NODES:
        sys.exit(f"pass the name of a node: one of {', '.join(NODES)}")
    sys.argv[:2] = sys.argv[1:2]
    sys.exit(start(sys.argv[0]))

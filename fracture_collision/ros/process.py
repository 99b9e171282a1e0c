"""How every node's process starts and ends."""

from __future__ import annotations

import sys
from collections.abc import Callable

import rclpy
from rclpy.exceptions import InvalidParameterTypeException, InvalidParameterValueException
from rclpy.executors import ExternalShutdownException
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node


class Fatal(RuntimeError):
    """The node cannot go on; its text is all that the user needs to see."""


def run_node(make_node: Callable[[], Node], work: Callable[[Node], None]) -> int:
    """Runs `work` on the node that `make_node` makes; returns the process's exit status.

    SIGINT and SIGTERM end it cleanly, with status 0: that is how nodes are told to go.
    """
    rclpy.init()
    node = None
    try:
        node = make_node()
        work(node)
        return 0
    except (KeyboardInterrupt, ExternalShutdownException):
        return 0
    except rclpy_implementation.RCLError:
        if rclpy.ok():
            raise
        return 0  # told to end between two calls of rclpy, and the second could not be made any more
    except (Fatal, InvalidParameterTypeException, InvalidParameterValueException) as error:
        print(f"{node.get_name() if node else 'node'}: {error}", file=sys.stderr)
        return 1
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()

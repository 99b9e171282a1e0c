"""rclpy for a program that is no node itself, but talks to nodes that it started (node_process.py)."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import rclpy
from rclpy.context import Context

from fracture_collision.ros.node_process import loopback_environment


def own_context(domain_id: int) -> Context:
    """One that talks to whom a NodeProcess of the same domain talks to. End it by try_shutdown()."""
    context = Context()
    with _environment(loopback_environment(domain_id)):
        rclpy.init(context=context, domain_id=domain_id)
    return context


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """rclpy reads from the environment whom it talks to."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value

"""rclpy for a program that is not a node, but communicates with nodes that it started (node_process.py)."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager

import rclpy
from rclpy.context import Context

from fracture_collision.ros.processes.node_process import loopback_environment
from fracture_collision.ros.processes.this_machine import PROFILES, keep_to_this_machine


def own_context(domain_id: int) -> Context:
    """A context that reaches the same nodes as a NodeProcess of the same domain. End it with try_shutdown()."""
    context = Context()
    environment = loopback_environment(domain_id)
    keep_to_this_machine(environment)
    with _environment(environment):
        rclpy.init(context=context, domain_id=domain_id)
    if PROFILES[0] in environment:  # Fast DDS reads it when the first participant is made, with the first node
        os.environ[PROFILES[0]] = environment[PROFILES[0]]
    return context


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Sets variables for a while: rclpy reads the discovery range from the environment."""
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

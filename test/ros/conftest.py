"""A service that the tests of a module share, each with a run of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count

import pytest
from stages.ros_client import ServiceClient
from stages.ros_stage import LARGEST_MESSAGE, StageWithClients

from fracture_collision.ros.processes.node_process import NodeProcess

RUNS = count(41, 10)


@pytest.fixture
def run_id() -> int:
    """Of a run that no other test has begun, nor the nine after it: a new run is a new scene."""
    return next(RUNS)


@pytest.fixture(scope="module")
def service(shared_stage: StageWithClients) -> NodeProcess:
    return shared_stage.start("collision_node", threads=1, max_message_bytes=LARGEST_MESSAGE)


@pytest.fixture
def new_client(service: NodeProcess, shared_stage: StageWithClients) -> Iterator[Callable[[], ServiceClient]]:
    """Makes clients of `service`; what they published goes with the test."""
    made: list[ServiceClient] = []

    def begin() -> ServiceClient:
        made.append(ServiceClient(shared_stage.domain_id, own_runs=True))
        made[-1].await_service()
        return made[-1]

    yield begin
    for each in made:
        each.close()


@pytest.fixture
def client(new_client: Callable[[], ServiceClient]) -> ServiceClient:
    return new_client()

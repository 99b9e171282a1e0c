"""Fixtures shared by test files."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from stages.ros_stage import StageWithClients


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[StageWithClients]:
    """A separate domain, whose nodes and clients stop with the test."""
    from stages.ros_stage import StageWithClients  # tests without nodes do not need rclpy

    made = StageWithClients(tmp_path)
    yield made
    made.close()


@pytest.fixture(scope="module")
def shared_stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[StageWithClients]:
    """A stage for all tests of a module."""
    from stages.ros_stage import StageWithClients

    made = StageWithClients(tmp_path_factory.mktemp("shared"))
    yield made
    made.close()


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A running Chromium; without one the test is skipped."""
    from stages.browser import chromium

    with chromium() as running:
        yield running

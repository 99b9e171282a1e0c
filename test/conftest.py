"""What more than one test file needs."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from stages.ros_stage import StageWithClients


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[StageWithClients]:
    """A domain of its own, whose nodes and clients end with the test."""
    from stages.ros_stage import StageWithClients  # who tests no nodes needs no rclpy

    made = StageWithClients(tmp_path)
    yield made
    made.close()

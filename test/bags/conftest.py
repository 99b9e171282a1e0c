"""Fixtures shared by the tests of bags."""

from __future__ import annotations

from pathlib import Path

import pytest
from worlds.recorded_pane import record_pane


@pytest.fixture(scope="session")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag with the default settings, which no test changes."""
    return record_pane(tmp_path_factory.mktemp("recorded") / "pane")

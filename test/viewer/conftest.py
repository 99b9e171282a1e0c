"""Fixtures shared by the tests of the viewer."""

from __future__ import annotations

from pathlib import Path

import pytest
from stages.bag_of_records import write_bag
from worlds.small_run import small_run


@pytest.fixture(scope="session")
def small_bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of 60 states, 0.02 s apart, in a namespace; no test changes it."""
    folder = tmp_path_factory.mktemp("run") / "small"
    write_bag(folder, small_run(), namespace="/demo")
    return folder

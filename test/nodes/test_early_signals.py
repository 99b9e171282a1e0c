"""A signal during the imports of a command or a node ends it at once, without a traceback."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BAG = ROOT / "bags" / "pane"
# sitecustomize.py of every child interpreter: sends itself a signal just before importing a given module.
AT_AN_IMPORT = """
import os, sys
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if name == os.environ["SIGNAL_AT"]:
            os.kill(os.getpid(), int(os.environ["SIGNAL"]))
sys.meta_path.insert(0, Finder)
"""
COMMANDS = [
    (("scenes",), "click"),
    (("scenes",), "scipy"),
    (("smash",), "rclpy"),
    (("smash",), "matplotlib"),
    (("scene", "pane"), "numba"),
    (("bench",), "benchmarks.studies.bench"),
    (("play", "--no-open"), "fracture_collision.ros.runs.play_run"),
    (("view", BAG, "--no-open"), "viser"),
    (("film", BAG), "numba"),
    (("replay", BAG), "numba"),
    (("record", "pane", "--out", "bag"), "numba"),
    (("mend", BAG), "mcap"),
    (("digest", BAG), "mcap"),
]


def run_interrupted(
    folder: Path, at: str, order: signal.Signals, *words: str | Path
) -> subprocess.CompletedProcess[str]:
    """Runs `python -m words` in `folder` and sends it signal `order` just before it imports `at`."""
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text(AT_AN_IMPORT)
    path = os.pathsep.join((str(folder / "site"), str(ROOT)))
    return subprocess.run(
        [sys.executable, "-m", *map(str, words)], cwd=folder, capture_output=True, text=True, timeout=120.0,
        env=os.environ | {"PYTHONPATH": path, "SIGNAL_AT": at, "SIGNAL": str(int(order))},
    )  # fmt: skip


@pytest.mark.parametrize(("words", "at"), COMMANDS)
def test_a_command_ends_without_a_traceback(words: tuple[str | Path, ...], at: str, tmp_path: Path) -> None:
    order = signal.SIGTERM if at == "rclpy" else signal.SIGINT
    done = run_interrupted(tmp_path, at, order, "fracture_collision.cli", *words)
    assert done.returncode == 130 and "Traceback" not in done.stderr + done.stdout, done.stderr
    assert [each.name for each in tmp_path.iterdir()] == ["site"], "nothing was begun"


def test_a_node_interrupted_during_imports_ends_without_a_traceback(tmp_path: Path) -> None:
    done = run_interrupted(tmp_path, "rclpy", signal.SIGINT, "fracture_collision.ros.start", "page_node")
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr


def test_an_unknown_node_is_rejected() -> None:
    done = subprocess.run(
        [sys.executable, "-m", "fracture_collision.ros.start", "node"], capture_output=True, text=True, timeout=60.0
    )
    assert done.returncode == 1 and "collision_node" in done.stderr

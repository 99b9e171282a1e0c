"""The launch files by ROS's own launch, where it and an installed fracture_collision are found: not with the wheels."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from fracture_collision.ros.processes.node_process import free_domain_id

pytest.importorskip("launch.actions", reason="ROS's launch is not a wheel")
pytest.importorskip("launch_ros.actions", reason="ROS's launch_ros is not a wheel")

FILES = Path(__file__).resolve().parents[2] / "launch"
# what `ros2 launch` does with a file's path
LAUNCH = """
import sys
from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
file, *given = sys.argv[1:]
source = PythonLaunchDescriptionSource(file)
described = IncludeLaunchDescription(source, launch_arguments=[each.split(":=", 1) for each in given])
service = LaunchService()
service.include_launch_description(LaunchDescription([described]))
sys.exit(service.run())
"""
STARTED = re.compile(r"\[(\w+)-\d+\]: process started with pid \[(\d+)\]")


class Launched:
    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process
        self.nodes: dict[str, int] = {}  # process ids
        self.said = ""

    def read_until(self, words: str) -> None:
        """Up to the line with these words."""
        for line in self._process.stdout:
            self._take(line)
            if words in line:
                return
        raise AssertionError(f"ended without {words!r}:\n{self.said}")

    def end(self) -> int:
        """Exit status; every node has ended by then."""
        for line in self._process.stdout:
            self._take(line)
        status = self._process.wait(60.0)
        alive = [name for name, pid in self.nodes.items() if Path(f"/proc/{pid}").exists()]
        assert not alive, alive
        return status

    def interrupt(self) -> None:
        """Ctrl-C: to launch and to all nodes."""
        os.killpg(self._process.pid, signal.SIGINT)

    def finished_cleanly(self) -> set[str]:
        return set(re.findall(r"\[(\w+)-\d+\]: process has finished cleanly", self.said))

    def _take(self, line: str) -> None:
        self.said += line
        if found := STARTED.search(line):
            self.nodes[found[1]] = int(found[2])


@contextmanager
def launched(file: str, folder: Path, *arguments: str) -> Iterator[Launched]:
    environment = os.environ | {"ROS_DOMAIN_ID": str(free_domain_id()), "ROS_LOG_DIR": str(folder)}
    environment.pop("ROS_AUTOMATIC_DISCOVERY_RANGE", None)
    process = subprocess.Popen(
        [sys.executable, "-c", LAUNCH, str(FILES / file), *arguments], stdout=subprocess.PIPE, text=True,
        stderr=subprocess.STDOUT, env=environment, cwd=folder, start_new_session=True,
    )  # fmt: skip
    run = Launched(process)
    try:
        yield run
    finally:
        if process.poll() is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_a_scene_runs_to_its_end(tmp_path: Path) -> None:
    with launched("fracture_collision.launch.py", tmp_path, "scene:=pane", "seed:=7", "namespace:=cell") as run:
        run.read_until("[cell.collision_node]: run ")
        assert run.end() == 0
        assert run.finished_cleanly() == {"collision_node", "simulator_node"}
        assert "is unknown and has no effect" not in run.said


@pytest.mark.parametrize("victim", ["collision_node", "simulator_node"])
def test_all_end_when_a_node_dies(victim: str, tmp_path: Path) -> None:
    with launched("fracture_collision.launch.py", tmp_path, "scene:=bricks") as run:
        run.read_until("collision_node]: run ")
        os.kill(run.nodes[victim], signal.SIGKILL)
        run.end()
        assert run.finished_cleanly() == set(run.nodes) - {victim}


def test_an_invalid_parameter_file_ends_all(tmp_path: Path) -> None:
    file = tmp_path / "service.yaml"
    file.write_text("/**:\n  ros__parameters:\n    method: guessed\n")
    with launched("fracture_collision.launch.py", tmp_path, "scene:=pane", f"parameters:={file}") as run:
        run.end()
        assert "collision_node: method: 'guessed' is not one of exact, glondu2014" in run.said
        assert run.finished_cleanly() == {"simulator_node"}


def test_ctrl_c_ends_a_played_scene(tmp_path: Path) -> None:
    with launched("play.launch.py", tmp_path, "scene:=vase", f"folder:={tmp_path / 'play'}") as run:
        run.read_until("[collision_node]: run ")
        run.interrupt()
        assert run.end() == 0 and '{"address": "http://127.0.0.1:' in run.said
        assert run.finished_cleanly() == {"collision_node", "live_simulator_node", "page_node"}


def test_arguments_are_checked(tmp_path: Path) -> None:
    with launched("play.launch.py", tmp_path, "discovery_range:=EVERYWHERE") as run:
        assert run.end() == 1 and "EVERYWHERE" in run.said and not run.nodes

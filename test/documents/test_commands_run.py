"""Commands in README and docs/, run as a reader would: from a folder of one's own, with bags that commands made there.

The others are listed with the reason; a new command must be added to one list or the other.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
import test_commands
import trimesh
from stages.typed_command import call

from fracture_collision.ros.processes.node_process import free_domain_id

ROOT = test_commands.ROOT
BIN = Path(sys.executable).parent
ALL = [(document, command.removeprefix(".venv/bin/")) for document, command in test_commands.ALL]
MAKES = {"out/smash/bag": "fracture-collision smash", "BAG": "fracture-collision record SCENE --out BAG"}
RUN = (
    "fracture-collision --help",
    "fracture-collision scenes",
    "fracture-collision settings",
    "collision_node --help",
    "fracture-collision record SCENE --out BAG",
    "fracture-collision replay BAG",
    "fracture-collision digest BAG",
    "fracture-collision export BAG",
    "fracture-collision mend BAG",
    "fracture-collision replay bags/bricks",
    "fracture-collision replay bags/NAME",
    "fracture-collision scene FILE",
    "fracture-collision check-solver --case drift",
    "python examples/break_a_mesh.py part.stl",
    "python -m lint.portable_arithmetic",
    "python -m fracture_collision.ros.runs.security_files security [--namespace /cell] [--domain 0] [--encrypt]",
)
WITH_A_PAGE = "fracture-collision play --scene FILE"
STUDIES = ("tables", "fig5", "fig12", "resolution", "fig15", "fig16", "fig17")
SLOW = (
    "fracture-collision smash",
    "fracture-collision replay out/smash/bag",
    "python -m benchmarks.scene_seeds pane --seeds 1",
    "fracture-collision film out/smash/bag",
    "fracture-collision scene drop_bunnies",
    "fracture-collision scene pane --engine mujoco",
    'fracture-collision check-solver --case drift --node "python examples/simulator_node.py --ros-args'
    ' -p scene:={scene} -p subscribers:=2"',
    "python benchmarks/numerics.py",
    "python benchmarks/certificate.py",
    "python benchmarks/field_errors.py",
    "python benchmarks/flood_cost.py",
    "python -m campaigns.kills --times 1 --others 1 --mixed 300",
    *(f"fracture-collision bench {study}" for study in STUDIES),
)
NOT_RUN = {
    r"make .*": "sets up a .venv first; CI and people run these",
    r"fracture-collision view out/smash/bag": "serves until it is ended: test_view_cli",
    r"ros2 .*": "needs an installed ROS, which these tests do not have",
    r"python3 -m (venv|colcon) .*": "test_packaging installs the package into an environment of its own",
    r"python -m pytest .*": "is this test runner",
    r"python examples/deepest_contact\.py": "waits for a running service: test_examples",
    r"python bags/make\.py .*": "makes golden bags anew: test_replay compares their content",
    r"python -m fracture_collision\.simulation\.scene\.scene_reference docs/scenes\.md": "test_scene_reference",
    r"recorder_node --ros-args .*": "records until it is ended: test_replay_nodes",
    r"simulator_node  --bodies.*": "is an arrow of a figure",
    r"fracture-collision check-solver --case core --node .*": "is a simulator that a reader has yet to write",
    r"fracture-collision (export|bench|mend|check-solver)": "is a name in running text",
    r"python -m benchmarks\.(speed_error|frames|scaling|tunnelling|page).*": "compares times",
    r"python -m campaigns\.(kills|bad_input|soak)(\.fuzz)?( --times 12 --others 1| --seconds 420)?": "is a campaign",
    r"python -m campaigns\.late_floor": "is a campaign",
    r"python -m benchmarks\.elementary( --engines ours,rapier,mujoco)?": "its scenes are those of test_elementary",
    r"python -m benchmarks\.random_pairs": "its kinds of pairs are those of test_random_pairs",
    r"python -m benchmarks\.scene_seeds( --csv docs/scene_seeds\.csv| --engine mujoco)?": "minutes: one scene is run",
    r"python -m benchmarks\.contact_count --csv docs/contact_count\.csv": "takes minutes",
    r"python -m benchmarks\.engines --csv docs/engines\.csv": "takes minutes: test_mujoco_dynamics runs a scene",
    r"python -m benchmarks\.random_drops": "takes half an hour: test_random_pairs runs some",
}  # fmt: skip


def is_listed(command: str) -> bool:
    return command in (*RUN, WITH_A_PAGE, *SLOW) or any(re.fullmatch(each, command) for each in NOT_RUN)


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a reader who follows the documents."""
    folder = tmp_path_factory.mktemp("reader")
    for name in ("config", "examples", "lint", "fracture_collision", "pyproject.toml"):
        (folder / name).symlink_to(ROOT / name)
    for name in ("bags", "benchmarks", "campaigns", "test"):  # some write beside themselves
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "docs").mkdir()
    trimesh.creation.box((0.1, 0.08, 0.06)).export(folder / "part.stl")
    return folder


def arguments(command: str) -> list[str]:
    words = shlex.split(re.sub(r"\[.*?\]", "", command))
    given = {"BAG": "bag", "SCENE": "pane", "FILE": "config/scenes/pane.yaml"}
    words = [given.get(word, word.replace("NAME", "pane")) for word in words]
    return [str(BIN / words[0]), *words[1:], *(["--out", "docs"] if words[1] == "bench" else [])]


@pytest.fixture
def environment() -> dict[str, str]:
    return {**os.environ, "BROWSER": "true", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_DOMAIN_ID": str(free_domain_id())}  # fmt: skip


@pytest.mark.parametrize("command", RUN)
def test_a_command_of_a_document_does_what_it_says(
    command: str, reader: Path, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    program, *words = arguments(command)
    if not program.endswith("fracture-collision") or words == ["--help"]:
        run(command, reader, environment, 300.0)
        return
    prepare(command, reader, environment)
    monkeypatch.chdir(reader)
    done = call(*words)
    assert done.status == 0 and done.text, done.output


@pytest.mark.slow
@pytest.mark.parametrize("command", SLOW)
def test_a_slow_command_of_a_document_does_what_it_says(
    command: str, reader: Path, environment: dict[str, str]
) -> None:
    run(command, reader, environment, 3600.0)


def run(command: str, reader: Path, environment: dict[str, str], patience: float) -> None:
    prepare(command, reader, environment)
    done = subprocess.run(
        arguments(command), cwd=reader, env=environment, capture_output=True, text=True, timeout=patience
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.strip() and "Traceback" not in done.stderr


def prepare(command: str, reader: Path, environment: dict[str, str]) -> None:
    """Makes the bag that `command` reads, if no command has made it yet."""
    for bag, maker in MAKES.items():
        folder = reader / bag.lower()
        if bag in command.split() and command != maker and not folder.exists():
            run(maker, reader, environment, 300.0)


def test_a_command_with_a_page_ends_when_it_is_interrupted(reader: Path, environment: dict[str, str]) -> None:
    with subprocess.Popen(
        arguments(WITH_A_PAGE), cwd=reader, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        text=True,
    ) as process:  # fmt: skip
        said = ""
        try:
            for line in process.stdout:
                said += line
                if "http://" in line:
                    process.send_signal(signal.SIGINT)
                    break
            said += process.communicate(timeout=60.0)[0]
        finally:
            process.kill()
    assert process.returncode == 0 and "Traceback" not in said, said


def test_each_command_is_run_or_has_a_reason() -> None:
    assert not [f"{document.name}: {command}" for document, command in ALL if not is_listed(command)]


def test_no_list_names_a_command_that_is_gone() -> None:
    there = {command for _, command in ALL}
    assert not [each for each in (*RUN, WITH_A_PAGE, *SLOW) if each not in there]
    assert not [each for each in NOT_RUN if not any(re.fullmatch(each, command) for command in there)]

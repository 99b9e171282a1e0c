"""The package as users get it: installed by pip and by colcon, from a clean copy of the sources."""

from __future__ import annotations

import email
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Iterable, Iterator
from importlib import metadata
from pathlib import Path
from xml.etree import ElementTree

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from fracture_collision import __version__
from fracture_collision.ros.start import NODES

ROOT = Path(__file__).resolve().parents[2]
DISTRIBUTIONS = ("fracture-collision", "fracture-collision-msgs")
OTHER_EXTRAS = ("cli", "viewer", "meshing")  # all that people get from pip without ROS
EXECUTABLES = (*NODES, "fracture-collision")
UNOPTIMIZED = {"CFLAGS": "-O0", "CXXFLAGS": "-O0", "CMAKE_BUILD_TYPE": ""}  # compiled in half the time
NOT_SOURCES = (".git", ".venv", "build", "dist", "install", "log", "out", "*.egg-info", "__pycache__", ".*_cache")

# Runs in the installed package's environment, away from the sources: uses a message, prints where it was loaded from.
USE_MESSAGES = """
import array, pathlib, fracture_collision
from fracture_collision.msg import ContactConstraintArray
from rclpy.serialization import deserialize_message, serialize_message
sent = ContactConstraintArray(step=7, gaps=array.array("d", [-0.25, 0.5]))
received = deserialize_message(serialize_message(sent), ContactConstraintArray)
assert received == sent and received.gaps[0] == -0.25, received
import fracture_collision.records
print(pathlib.Path(fracture_collision.records.__file__).resolve())
"""

# tf2_msgs is not among the ROS wheels: pip builds its message.
USE_TRANSFORMS = """
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message, serialize_message
from tf2_msgs.msg import TFMessage
sent = TFMessage(transforms=[TransformStamped(child_frame_id="link")])
assert deserialize_message(serialize_message(sent), TFMessage) == sent
"""


def clean_environment(**changes: str) -> dict[str, str]:
    """The caller's environment without the variables of its own Python environment."""
    own = ("LD_LIBRARY_PATH", "_ROS_WHEELS_BOOTSTRAP_COMPLETE", "PYTHONPATH", "VIRTUAL_ENV", "AMENT_PREFIX_PATH")
    kept = {name: value for name, value in os.environ.items() if name not in own}
    return kept | UNOPTIMIZED | changes


def run(*command: str | Path, cwd: Path, environment: dict[str, str]) -> str:
    done = subprocess.run(
        [str(part) for part in command], cwd=cwd, env=environment, capture_output=True, text=True, timeout=800
    )
    assert done.returncode == 0, f"{command}\n{done.stdout[-4000:]}\n{done.stderr[-4000:]}"
    return done.stdout


@pytest.fixture(scope="module")
def workplace() -> Iterator[Path]:
    """A folder on the same file system as the .venv, so that the .venv can be copied with hard links."""
    folder = ROOT / "build" / f"test-packaging-{os.getpid()}"
    folder.mkdir(parents=True)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture(scope="module")
def sources(workplace: Path) -> Path:
    copy = workplace / "src" / "fracture_collision"
    shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(*NOT_SOURCES))
    return copy


@pytest.fixture(scope="module")
def environment_copy(workplace: Path) -> Path:
    """A separate environment with the .venv's packages but without this project."""
    copy = workplace / "venv"
    shutil.copytree(sys.prefix, copy, symlinks=True, copy_function=os.link)
    run(copy / "bin" / "python", "-m", "pip", "uninstall", "--yes", *DISTRIBUTIONS,
        cwd=workplace, environment=clean_environment())  # fmt: skip
    return copy


@pytest.fixture(scope="module")
def wheels(workplace: Path, sources: Path) -> Path:
    """The folder with what `make wheel` makes."""
    stamp = sources / "build" / "stamps" / "environment"
    stamp.parent.mkdir(parents=True)
    stamp.touch()
    run("make", "wheel", f"BIN={Path(sys.prefix, 'bin')}", cwd=sources, environment=clean_environment())
    return sources / "dist"


def test_pip_installs_the_package(workplace: Path, wheels: Path, environment_copy: Path) -> None:
    environment = clean_environment()
    python = environment_copy / "bin" / "python"
    run(python, "-m", "pip", "install", "--no-deps", "--no-index", *wheels.iterdir(),
        cwd=workplace, environment=environment)  # fmt: skip
    imported_from = run(python, "-c", USE_MESSAGES + USE_TRANSFORMS, cwd=workplace, environment=environment).strip()
    assert environment_copy.resolve() in Path(imported_from).parents
    for name in EXECUTABLES:
        assert os.access(environment_copy / "bin" / name, os.X_OK)
    share = environment_copy / "share" / "fracture_collision"
    assert_shared_files(share)
    help_text = run(environment_copy / "bin" / "fracture-collision", "--help", cwd=workplace, environment=environment)
    assert "smash" in help_text

    run(python, "-m", "pip", "uninstall", "--yes", *DISTRIBUTIONS, cwd=workplace, environment=environment)
    ours = (*environment_copy.rglob("*fracture_collision*"), *environment_copy.rglob("*tf2_msgs*"))
    left = [path for path in ours if path.is_file()]
    assert not left, left


def requirements_for(extra: str, lines: Iterable[str]) -> list[Requirement]:
    needed = map(Requirement, lines)
    return [each for each in needed if each.marker is None or each.marker.evaluate({"extra": extra})]


def all_requirements_of(wheel: Path, *extras: str) -> set[str]:
    """Names of the distributions that pip would install with it and these extras."""
    with zipfile.ZipFile(wheel) as files:
        (name,) = (each for each in files.namelist() if each.endswith(".dist-info/METADATA"))
        lines = email.message_from_bytes(files.read(name)).get_all("Requires-Dist")
    waiting = [needed for extra in ("", *extras) for needed in requirements_for(extra, lines)]
    found: set[str] = set()
    while waiting:
        needed = waiting.pop()
        if canonicalize_name(needed.name) in found:
            continue
        found.add(canonicalize_name(needed.name))
        for extra in ("", *needed.extras):
            waiting += requirements_for(extra, metadata.requires(needed.name) or ())
    return found


@pytest.fixture(scope="module")
def without_ros(workplace: Path, wheels: Path) -> Path:
    """A new environment with the wheel and what all extras but `ros` require, which is linked from the .venv."""
    place = workplace / "without_ros"
    run(sys.executable, "-m", "venv", "--without-pip", place, cwd=workplace, environment=clean_environment())
    (wheel,) = wheels.glob("fracture_collision-*.whl")
    (packages,) = place.glob("lib/python*/site-packages")
    for name in all_requirements_of(wheel, *OTHER_EXTRAS):
        for file in metadata.distribution(name).files:
            target = packages / file
            if ".." not in file.parts and not target.exists() and file.locate().exists():
                target.parent.mkdir(parents=True, exist_ok=True)
                os.link(file.locate(), target)
    # without an index it fails if a requirement is missing or has another version
    run(sys.executable, "-m", "pip", "--python", place, "install", "--no-index", f"{wheel}[{','.join(OTHER_EXTRAS)}]",
        cwd=workplace, environment=clean_environment())  # fmt: skip
    for kernel in (ROOT / "fracture_collision").rglob("*.nb[ic]"):  # the same sources: spares minutes of compilation
        target = packages / kernel.relative_to(ROOT)
        target.parent.mkdir(exist_ok=True)
        os.link(kernel, target)
    return place


def test_the_library_is_small_and_for_every_platform(wheels: Path) -> None:
    assert {file.name.split("-")[0] for file in wheels.iterdir()} == {"fracture_collision", "fracture_collision_msgs"}
    wheel = wheels / f"fracture_collision-{__version__}-py3-none-any.whl"
    assert ElementTree.parse(ROOT / "package.xml").find("version").text == __version__
    assert all_requirements_of(wheel) == {"numpy", "numba", "llvmlite"}
    others = all_requirements_of(wheel, *OTHER_EXTRAS)
    assert not [name for name in others if name.startswith("ros-") or name.endswith("-msgs")]
    with zipfile.ZipFile(wheel) as own:
        assert "fracture_collision/py.typed" in own.namelist()
        assert sum(each.file_size for each in own.infolist()) < 5e6


def test_the_library_works_without_ros(without_ros: Path) -> None:
    environment = clean_environment()
    command = without_ros / "bin" / "fracture-collision"
    assert run(command, "--version", cwd=without_ros, environment=environment).split()[-1] == __version__
    said = run(command, "scene", "pane", "--steps", "20", "--out", without_ros / "out",
               cwd=without_ros, environment=environment)  # fmt: skip
    assert "collision detection" in said and (without_ros / "out" / "film_strip.png").is_file()
    bag = ROOT / "bags" / "plate_in_bowl"
    said = run(command, "replay", bag, "--steps", "60:80", cwd=without_ros, environment=environment)
    assert "answers equal the recorded ones, byte for byte" in " ".join(said.split())


@pytest.mark.slow
def test_an_installed_wheel_answers_the_same_when_it_compiles_its_own_kernels(
    without_ros: Path, tmp_path: Path
) -> None:
    """With an empty cache, as after `pip install`: some minutes."""
    environment = clean_environment(NUMBA_CACHE_DIR=str(tmp_path))
    bag = ROOT / "bags" / "pane"
    said = run(without_ros / "bin" / "fracture-collision", "replay", bag, cwd=without_ros, environment=environment)
    assert "answers equal the recorded ones, byte for byte" in " ".join(said.split())
    assert any(tmp_path.rglob("narrow_phase.*.nbc"))


@pytest.mark.parametrize("words", ["fracture-collision smash", "fracture-collision play", "collision_node"])
def test_what_needs_ros_says_so(without_ros: Path, words: str) -> None:
    done = subprocess.run(
        ["sh", "-c", f"bin/{words}"], cwd=without_ros, env=clean_environment(), capture_output=True, text=True,
        timeout=100,
    )  # fmt: skip
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert "pip install '.[ros]'" in " ".join(done.stderr.split())


@pytest.mark.slow
def test_colcon_builds_the_package(workplace: Path, sources: Path, environment_copy: Path) -> None:
    prefix = environment_copy
    environment = clean_environment(
        AMENT_PREFIX_PATH=str(prefix), CMAKE_PREFIX_PATH=str(prefix), PATH=f"{prefix}/bin:{os.environ['PATH']}"
    )
    python = prefix / "bin" / "python"
    run(python, "-m", "colcon", "build", "--base-paths", sources, "--cmake-args", "-DBUILD_TESTING=OFF",
        f"-DPython3_EXECUTABLE={python}", cwd=workplace, environment=environment)  # fmt: skip
    installed = workplace / "install" / "fracture_collision"

    def in_workspace(command: str) -> str:
        """As a ROS user would: source the workspace, then run a command in it."""
        sourced = f". {workplace}/install/setup.sh && {command}"
        return run("sh", "-c", sourced, cwd=workplace / "src", environment=environment)

    script = workplace / "use_messages.py"
    script.write_text(USE_MESSAGES)
    imported_from = in_workspace(f"python {script}").strip()
    assert installed.resolve() in Path(imported_from).parents
    for name in EXECUTABLES:
        for folder in (installed / "bin", installed / "lib" / "fracture_collision"):
            assert os.access(folder / name, os.X_OK)
    assert_shared_files(installed / "share" / "fracture_collision")
    assert "smash" in in_workspace(f"{installed}/lib/fracture_collision/fracture-collision --help")


def assert_shared_files(share: Path) -> None:
    for folder in ("config", "launch", "msg"):
        suffixes = (".yaml", ".npz", ".py", ".msg", ".rviz")
        files = (path for path in (ROOT / folder).rglob("*") if path.suffix in suffixes)
        expected = {path.relative_to(ROOT) for path in files}
        assert expected
        missing = [path for path in expected if not (share / path).is_file()]
        assert not missing, missing
    assert (share / "package.xml").is_file()

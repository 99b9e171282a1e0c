"""Builds the distribution fracture-collision-msgs: CMake generates and compiles the messages into a staging prefix.

The Python part goes into the package, as fracture_collision/msg, the rest (shared libraries, interface files) into the
environment, laid out as an ament prefix. Works in a checkout of the whole repository only: CMakeLists.txt and msg/ lie
above this folder.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

from setuptools import Command, Distribution, setup
from setuptools.command.build import build

# isort: split
from distutils.command.install_data import install_data  # provided by setuptools, which has no own name for it

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "fracture_collision"
TF2_MSGS = ROOT / "vendor" / "tf2_msgs"  # not among the ROS wheels


def requirements(file: Path) -> list[str]:
    """The requirements in a file with one requirement per line."""
    lines = (line.split("#")[0].strip() for line in file.read_text().splitlines())
    return [line for line in lines if line]


def version() -> str:
    """The version of the Python package, which is also this one's."""
    source = (ROOT / PACKAGE / "__init__.py").read_text()
    (found,) = re.findall(r'^__version__ = "(.+)"$', source, re.MULTILINE)
    return found


def ament_prefixes() -> list[str]:
    """Every prefix that holds ROS packages: an installed ROS, this environment, pip's isolated build environment."""
    from_environment = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
    above_site_packages = [str(Path(entry).parents[2]) for entry in sys.path if entry.endswith("-packages")]
    candidates = dict.fromkeys([*from_environment, *above_site_packages, sys.prefix])
    return [prefix for prefix in candidates if prefix and Path(prefix, "share", "ament_index").is_dir()]


def is_provided(source: Path) -> bool:
    """Whether a prefix has the package of a source folder, other than from here; our copy names this package."""
    installed = (Path(prefix, "share", source.name, "package.xml") for prefix in ament_prefixes())
    return any(file.is_file() and PACKAGE not in file.read_text() for file in installed)


class BuildMessages(Command):
    """Runs CMake; afterwards `stage` holds the installed messages."""

    description = "generate and compile the ROS messages"

    def initialize_options(self) -> None:
        self.build_lib = None

    def finalize_options(self) -> None:
        self.set_undefined_options("build", ("build_lib", "build_lib"))
        work = ROOT / "build" / f"messages-{sysconfig.get_platform()}-{sys.implementation.cache_tag}"
        self.cmake_folder = work / "cmake"
        self.stage = work / "stage"

    def run(self) -> None:
        shutil.rmtree(self.stage, ignore_errors=True)
        self._install(ROOT, self.cmake_folder)
        if not is_provided(TF2_MSGS):
            self._install(TF2_MSGS, self.cmake_folder.with_name(TF2_MSGS.name))
        self._keep_one_package_init()
        shutil.copytree(self._staged_package(), Path(self.build_lib, PACKAGE), dirs_exist_ok=True)
        shutil.rmtree(self._staged_package())

    def _install(self, source: Path, folder: Path) -> None:
        """Builds a CMake project in `folder` and installs it into `stage`."""
        # A CMake cache from another environment (pip's isolated ones are new each time) would contain wrong paths.
        (folder / "CMakeCache.txt").unlink(missing_ok=True)
        prefixes = ";".join(ament_prefixes())
        environment = os.environ | {"AMENT_PREFIX_PATH": prefixes.replace(";", os.pathsep)}
        configure = [
            "cmake", "-S", str(source), "-B", str(folder),
            f"-DCMAKE_INSTALL_PREFIX={self.stage}",
            f"-DCMAKE_PREFIX_PATH={prefixes}",
            f"-DPython3_EXECUTABLE={sys.executable}",
            f"-DCMAKE_BUILD_TYPE={os.environ.get('CMAKE_BUILD_TYPE', 'Release')}",
            "-DBUILD_TESTING=OFF",
            "-DINSTALL_PYTHON_PACKAGE=OFF",
        ]  # fmt: skip
        subprocess.run(configure, check=True, env=environment)
        jobs = str(os.cpu_count() or 1)
        subprocess.run(["cmake", "--build", str(folder), "-j", jobs], check=True, env=environment)
        subprocess.run(["cmake", "--install", str(folder)], check=True, env=environment)

    def _staged_package(self) -> Path:
        (folder,) = self.stage.glob(f"**/*-packages/{PACKAGE}")
        return folder

    def _keep_one_package_init(self) -> None:
        """Removes the generated, empty __init__.py and metadata, which would shadow the package's own; and caches."""
        package = self._staged_package()
        (package / "__init__.py").unlink()
        for generated in [*package.parent.rglob("__pycache__"), *package.parent.glob("*.egg-info")]:
            shutil.rmtree(generated)


class InstallData(install_data):
    """Installs what BuildMessages staged, at the same place below the environment."""

    def run(self) -> None:
        stage = self.get_finalized_command("build_messages").stage
        files = sorted(file for file in stage.rglob("*") if file.is_file())
        self.data_files = [(str(file.parent.relative_to(stage)), [str(file)]) for file in files]
        super().run()


class Build(build):
    sub_commands = [("build_messages", None), *build.sub_commands]


class MessageDistribution(Distribution):
    def has_ext_modules(self) -> bool:
        return True  # compiled type support: the wheel is specific to one platform and one Python

    def has_data_files(self) -> bool:
        return True


setup(
    version=version(),
    distclass=MessageDistribution,
    data_files=[],
    cmdclass={"build": Build, "build_messages": BuildMessages, "install_data": InstallData},
    setup_requires=requirements(ROOT / "requirements" / "build.in"),
    install_requires=requirements(ROOT / "requirements" / "ros.in"),
)

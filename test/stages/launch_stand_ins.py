"""Stand-ins for the names that the launch file imports from launch and launch_ros.

They take the documented arguments (docs.ros.org, Jazzy). Executing them gives an environment and command lines. For
tests without ROS's launch, which is not available as a wheel.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

import yaml

from fracture_collision.share import share_directory


class Context:
    """The arguments and environment that substitutions are resolved in."""

    def __init__(self, arguments: Mapping[str, str], environment: Mapping[str, str]) -> None:
        self.given = dict(arguments)
        self.configurations: dict[str, str] = {}
        self.environment = dict(environment)


class LaunchConfiguration(NamedTuple):
    variable_name: str

    def perform(self, context: Context) -> str:
        return context.configurations[self.variable_name]


class EnvironmentVariable:
    def __init__(self, name: str, *, default_value: Any = None) -> None:
        self._name, self._default_value = name, default_value

    def perform(self, context: Context) -> str:
        return context.environment.get(self._name) or resolved(self._default_value, context)


class PathJoinSubstitution(NamedTuple):
    substitutions: list

    def perform(self, context: Context) -> str:
        return os.path.join(*(resolved(each, context) for each in self.substitutions))


class FindPackageShare(NamedTuple):
    package: str

    def perform(self, _context: Context) -> str:
        assert self.package == "fracture_collision"
        return str(share_directory())


class ParameterValue:
    def __init__(self, value: Any, *, value_type: type) -> None:
        self._value, self._value_type = value, value_type

    def perform(self, context: Context) -> Any:
        return self._value_type(resolved(self._value, context))


class DeclareLaunchArgument:
    def __init__(
        self, name: str, *, default_value: Any = None, description: str | None = None, choices: list | None = None
    ) -> None:
        assert description and (choices is None or choices)
        self.name, self._default_value, self._choices = name, default_value, choices

    def execute(self, context: Context) -> None:
        value = context.given.get(self.name)
        value = resolved(self._default_value, context) if value is None else value
        if self._choices is not None and value not in self._choices:
            raise RuntimeError(f"{self.name}: {value} is none of {self._choices}")
        context.configurations[self.name] = value


class SetEnvironmentVariable(NamedTuple):
    name: str
    value: Any

    def execute(self, context: Context) -> None:
        context.environment[self.name] = resolved(self.value, context)


class Shutdown:
    def __init__(self, *, reason: str = "reason not given") -> None:
        self.reason = reason


class Node:
    """launch_ros.actions.Node: dictionaries of parameters become files for all nodes of the process."""

    def __init__(
        self, *, executable: str, package: str, namespace: Any = None, parameters: Sequence = (), output: str = "log",
        on_exit: Shutdown | None = None,
    ) -> None:  # fmt: skip
        assert package == "fracture_collision" and output in ("screen", "log", "both")
        self.executable, self.on_exit = executable, on_exit
        self._namespace, self._parameters = namespace, parameters
        self.command: list[str] = []
        self.environment: dict[str, str] = {}

    def execute(self, context: Context, find: Callable[[str], Path], folder: Path) -> None:
        namespace = "/" + resolved(self._namespace, context).lstrip("/")
        self.command = [str(find(self.executable)), "--ros-args", "-r", f"__ns:={namespace}"]
        for k, given in enumerate(self._parameters):
            if isinstance(given, dict):
                file = folder / f"launch_params_{self.executable}_{k}.yaml"
                values = {name: resolved(value, context) for name, value in given.items()}
                file.write_text(yaml.safe_dump({"/**": {"ros__parameters": values}}))
            else:
                file = Path(resolved(given, context))
            self.command += ["--params-file", str(file)]
        self.environment = dict(context.environment)


class LaunchDescription(NamedTuple):
    entities: list

    def execute(self, context: Context, find: Callable[[str], Path], folder: Path) -> list[Node]:
        """The description's nodes, ready to start."""
        nodes = []
        for entity in self.entities:
            if isinstance(entity, Node):
                entity.execute(context, find, folder)
                nodes.append(entity)
            else:
                entity.execute(context)
        return nodes


def resolved(value: Any, context: Context) -> Any:
    return value.perform(context) if hasattr(value, "perform") else value


def modules() -> Iterator[tuple[str, ModuleType]]:
    """The stand-in modules with the names under which the launch file imports them."""
    names = {
        "launch": (LaunchDescription,),
        "launch.actions": (DeclareLaunchArgument, SetEnvironmentVariable, Shutdown),
        "launch.substitutions": (EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution),
        "launch_ros": (),
        "launch_ros.actions": (Node,),
        "launch_ros.parameter_descriptions": (ParameterValue,),
        "launch_ros.substitutions": (FindPackageShare,),
    }
    for name, classes in names.items():
        module = ModuleType(name)
        for each in classes:
            setattr(module, each.__name__, each)
        yield name, module


def load(file: Path, install: Callable[[dict, str, ModuleType], None]) -> LaunchDescription:
    """The launch file's description. `install`: puts a module into sys.modules for as long as it is needed."""
    for name, module in modules():
        install(sys.modules, name, module)
    scope: dict[str, Any] = {"__name__": "launch_file"}
    exec(compile(file.read_text(), str(file), "exec"), scope)
    return scope["generate_launch_description"]()

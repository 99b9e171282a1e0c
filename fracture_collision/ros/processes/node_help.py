"""--help and --version of the nodes, from what they declare; no node is created."""

from __future__ import annotations

import inspect
import sys
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from fracture_collision.ros.processes.parameters import Declaration
from fracture_collision.ros.wire.interfaces import Interface
from fracture_collision.ros.wire.message_definitions import type_name
from fracture_collision.ros.wire.qos import Topic
from fracture_collision.share import share_directory

WIDTH = 100
# as `ros2 param describe` names them
TYPES = {bool: "boolean", int: "integer", float: "double", str: "string"}
ROS_OPTIONS = ("-p", "--param", "-r", "--remap", "--params-file", "--log-level", "-e", "--enclave")
OF_EVERY_NODE = """\
Also, as of every node: /rosout, /parameter_events, and services such as ~/set_parameters. Parameters that are not
fixed may change at run time: `ros2 param set`, or rqt."""


def answer_to(make_node: Any, arguments: Sequence[str]) -> str | None:
    """Help or version, if the arguments request either. Ignores --ros-args and what follows.

    `make_node`: a class of nodes with PARAMETERS, INTERFACE and EXAMPLES.
    """
    own = _own(arguments)
    if "--help" in own or "-h" in own:
        return help_of(make_node)
    if "--version" in own:
        return f"{name_of(make_node)} {version()}"
    return None


def fault_of_arguments(arguments: Sequence[str]) -> str:
    """Describes arguments that rclpy ignores: all before --ros-args, above all `-p NAME:=VALUE` without it."""
    own = _own(arguments)
    if not own:
        return ""
    advice = "put --ros-args before it" if own[0] in ROS_OPTIONS else "--help lists what there is"
    return f"unknown argument {own[0]}; {advice}"


def _own(arguments: Sequence[str]) -> Sequence[str]:
    return arguments[: arguments.index("--ros-args")] if "--ros-args" in arguments else arguments


def version() -> str:
    """The version of this package."""
    return ElementTree.parse(share_directory() / "package.xml").findtext("version", "")


def name_of(make_node: Callable[..., Any]) -> str:
    """The executable of a class of nodes, and the default name of such a node."""
    name = make_node.__module__.rpartition(".")[2]
    return Path(sys.argv[0]).stem if name == "__main__" else name


def help_of(make_node: Any) -> str:
    """What a class of nodes does, its parameters, topics and services, and examples."""
    name = name_of(make_node)
    interface: Interface = make_node.INTERFACE
    services = [_entry(f"{each.name}  {_service_type(each.service_class)}", each.description)
                for each in interface.serves]  # fmt: skip
    examples = "\n".join(f"  {name} {arguments}" for arguments in make_node.EXAMPLES)
    parts = (
        f"usage: {name} [--help] [--version] [--ros-args -p NAME:=VALUE ... --params-file FILE -r FROM:=TO ...]",
        (inspect.getdoc(sys.modules[make_node.__module__]) or "").partition("\n\n")[0],
        inspect.getdoc(make_node) or "",
        _section("Parameters", map(_parameter, make_node.PARAMETERS)),
        _section("Subscribes to", map(_topic, interface.subscribes)),
        _section("Publishes", map(_topic, interface.publishes)),
        _section("Services", services),
        OF_EVERY_NODE,
        f"Examples:\n{examples}",
    )
    return "\n\n".join(filter(None, parts))


def _section(title: str, entries: Iterable[str]) -> str:
    lines = "\n".join(entries)
    return f"{title}:\n{lines}" if lines else ""


def _entry(head: str, description: str) -> str:
    return f"  {head}\n" + textwrap.fill(description, WIDTH, initial_indent=" " * 6, subsequent_indent=" " * 6)


def _parameter(declaration: Declaration) -> str:
    name, default, description, limits, fixed = declaration
    of_type = TYPES[type(default)]
    shown = str(default).lower() if isinstance(default, bool) else repr(default)
    head = f"{name}  {of_type}, default {shown}"
    if limits is not None:
        number = int if of_type == "integer" else float
        head += f", {number(limits.low)} to {number(limits.high)}"
    return _entry(head + (", fixed" if fixed else ""), description)


def _topic(topic: Topic) -> str:
    return _entry(f"{topic.name}  {type_name(topic.message_class)}", topic.description)


def _service_type(service_class: Any) -> str:
    return f"{service_class.__module__.split('.')[0]}/srv/{service_class.__name__}"

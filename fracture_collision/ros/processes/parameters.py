"""Parameters of nodes, and the service's settings as such."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fracture_collision.near_names import did_you_mean
from fracture_collision.world import Settings
from fracture_collision.world.settings import OF_SERVICE, RANGES, Range, check_settings, meaning


class Declaration(NamedTuple):
    """A parameter of a node, for its descriptor and for --help."""

    name: str
    default: Any
    description: str
    limits: Range | None = None
    fixed: bool = True  # read-only after the start


SETTINGS = tuple(
    Declaration(name, getattr(Settings(), name), meaning(name), RANGES.get(name), fixed=False) for name in OF_SERVICE
)


def declare(node: Node, declaration: Declaration) -> Any:
    """Declares a parameter; returns its value."""
    name, default, description, limits, fixed = declaration
    descriptor = ParameterDescriptor(description=description, read_only=fixed)
    if limits is not None and isinstance(default, int):
        descriptor.integer_range = [IntegerRange(from_value=int(limits.low), to_value=int(limits.high))]
    elif limits is not None:
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=float(limits.low), to_value=float(limits.high))
        ]
    return node.declare_parameter(name, default, descriptor).value


def declare_all(node: Node, declarations: Iterable[Declaration]) -> dict[str, Any]:
    """Declares parameters; returns their values by name."""
    return {declaration.name: declare(node, declaration) for declaration in declarations}


def unknown_parameters(node: Node) -> list[str]:
    """Describes parameters of a file or the command line that `node` has not declared, and that rclpy ignores."""
    with node.handle:
        given = node.handle.get_parameters(Parameter)
    declared = list(node.get_parameters_by_prefix(""))
    described = []
    for name in sorted(given.keys() - set(declared)):
        described.append(f"parameter {name} is unknown and has no effect{did_you_mean(name, declared)}")
    return described


def warn_of_unknown(node: Node) -> None:
    """Logs the parameters that have no effect.

    No rejection: a file for all nodes (`/**`) may well have parameters of others.
    """
    for description in unknown_parameters(node):
        node.get_logger().error(description)


class SettingsParameters:
    """Every setting of the service as a parameter.

    All may change at run time, but only between two answers, so that each answer stays a function of messages and
    settings.
    """

    def __init__(self, node: Node, on_change: Callable[[Settings, Settings], None]) -> None:
        """`on_change` gets the former and the new settings.

        Raises rclpy's InvalidParameterValueException or ValueError for a value out of range.
        """
        self.current = Settings(**declare_all(node, SETTINGS))
        check_settings(self.current)
        self._on_change = on_change
        node.add_on_set_parameters_callback(self._judge)
        node.add_post_set_parameters_callback(self._take)

    def _changed(self, parameters: list[Parameter]) -> Settings:
        return self.current._replace(**{p.name: p.value for p in parameters if p.name in OF_SERVICE})

    def _judge(self, parameters: list[Parameter]) -> SetParametersResult:
        try:
            check_settings(self._changed(parameters))
        except ValueError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _take(self, parameters: list[Parameter]) -> None:
        former, self.current = self.current, self._changed(parameters)
        if self.current != former:
            self._on_change(former, self.current)

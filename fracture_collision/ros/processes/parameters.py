"""Parameters of nodes, and the service's settings as such: defaults and ranges from world/settings.py, meaning here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from fracture_collision.near_names import did_you_mean
from fracture_collision.world import Settings
from fracture_collision.world.settings import RANGES, Range, check_settings

# for `ros2 param describe`
DESCRIPTIONS: dict[str, str] = {
    "contacts_per_pair": "contacts of a pair before only those deeper than the tolerance are listed",
    "selection": "choice among many contacts: 'sufficient', spread out, or 'complete' (Glondu 2014, 5.2)",
    "deep_contacts_per_pair": "contacts of a pair if more than contacts_per_pair are deep",
    "penetration_tolerance": "penetrations up to this share of R may stay unlisted",
    "detection_tolerance": "contacts are listed up to a gap of this share of R",
    "lookahead": "[s] penetrations to come within this time are listed too; one time step",
    "field": "depth inside a fragment: 'exact' (local flood) or 'averaged' (Glondu 2014, eq. 1-2)",
    "surfaces": "where contacts are searched: 'sampled', 'edges' (crossing ones, too) or 'searched' (all over)",
    "tree": "trees of new fragments: 'restructured' (Glondu 2014, 6.2), 'plain' (its [27]) or 'rebuilt'",
    "normals": "surface of a contact's normal: 'facing' the sample, or 'nearest' (Glondu 2014, 4.4)",
    "traversal": "order of visits: 'alternating' between parents (Glondu 2014, 5.3) or 'queue' (its [27])",
    "neighbour_lists": "reuse samples and contacts of earlier steps; the answer does not depend on it",
    "threads": "threads of the narrow phase; 0: one per core. The answer does not depend on it",
    "visit_budget": "sphere tree nodes that a step may visit; 0: no limit",
    "max_pairs": "states with more overlapping pairs of boxes are rejected",
    "max_visits": "tree nodes of all pairs whose boxes mostly coincide; others get 25 times as many",
    "max_further_visits": "tree nodes of pairs with contacts_per_pair contacts, for deeper ones",
    "max_contacts_per_pair": "contacts listed of a pair, the deepest; at least contacts_per_pair",
    "max_contacts": "contacts in one answer; pairs with the most contacts lose their shallowest",
    "max_bodies": "further bodies are rejected",
    "max_nodes": "bodies with further mesh nodes, of all bodies together, are rejected",
    "max_fragments": "events with further fragments in one run are rejected",
    "max_message_bytes": "longer messages are rejected",
}


class Declaration(NamedTuple):
    """A parameter of a node, for its descriptor and for --help."""

    name: str
    default: Any
    description: str
    limits: Range | None = None
    fixed: bool = True  # read-only after the start


SETTINGS = tuple(
    Declaration(name, default, DESCRIPTIONS[name], RANGES.get(name), fixed=False)
    for name, default in Settings()._asdict().items()
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
        return self.current._replace(**{p.name: p.value for p in parameters if p.name in Settings._fields})

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

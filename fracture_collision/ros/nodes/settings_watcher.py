"""The settings of the service that publishes on a topic, read from its parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future

from fracture_collision.ros.nodes.repeated_request import RepeatedRequest
from fracture_collision.world.settings import OF_SERVICE

_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # rmw's name for a node of which it has discovered publishers only


class ServiceSettings:
    """Passes `on_settings` the settings of the node that publishes on `topic`, when it appears and when they change."""

    def __init__(self, node: Node, topic: str, on_settings: Callable[[dict[str, Any]], None]) -> None:
        self._node = node
        self._topic = topic
        self._on_settings = on_settings
        self._known: bytes | None = None  # the publisher whose settings are known
        self._values: dict[str, Any] = {}  # of the publisher asked
        self._client: Any = None
        self._request = RepeatedRequest(lambda: self._client.service_is_ready())
        self._asking: tuple[bytes, str] | None = None  # the publisher that gets the requests, and its node
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)

    @property
    def has_answer(self) -> bool:
        """Whether a publisher of the topic has responded.

        It has discovered the readers that this node made before the request: DDS announces readers in order, and the
        response's was the last.
        """
        return self._known is not None

    def look(self) -> None:
        """Sends a request to a publisher that has not responded yet. Must be called regularly."""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        if not publishers or publishers[0].node_name.startswith(_UNKNOWN):
            return
        gid = bytes(publishers[0].endpoint_gid)
        name = f"{publishers[0].node_namespace.rstrip('/')}/{publishers[0].node_name}"
        if gid == self._known:
            return
        if self._asking is None or self._asking[0] != gid:
            self._drop_client()
            self._asking = gid, name
            self._values = {}
            self._client = self._node.create_client(GetParameters, f"{name}/get_parameters")
            self._ask()
        self._request.look()

    def _ask(self) -> None:
        wanted = GetParameters.Request(names=list(OF_SERVICE))
        self._request.begin(lambda: self._client.call_async(wanted), self._on_answer)

    def _on_event(self, event: ParameterEvent) -> None:
        if self._asking is None or event.node != self._asking[1]:
            return
        changed = {
            parameter.name: parameter_value_to_python(parameter.value)
            for parameter in event.changed_parameters
            if parameter.name in OF_SERVICE
        }
        if changed and self._known == self._asking[0] and self._values:
            self._values |= changed
            self._on_settings(dict(self._values))
        elif changed:
            self._ask()  # a response on its way may predate the change

    def _on_answer(self, done: Future) -> None:
        if self._asking is None:
            return
        self._known = self._asking[0]  # a restarted service is another publisher
        if done.exception() is not None:
            self._node.get_logger().warning(f"cannot read the service's settings: {done.exception()}")
            return
        values = [parameter_value_to_python(value) for value in done.result().values]
        if len(values) == len(OF_SERVICE) and None not in values:
            self._values = dict(zip(OF_SERVICE, values, strict=True))
            self._on_settings(dict(self._values))

    def _drop_client(self) -> None:
        self._request.drop()
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._client = None

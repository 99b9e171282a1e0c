"""The settings of the service that publishes on a topic, read from its parameters.

A response may be lost: rmw_fastrtps drops it if it has not discovered the client's reader 100 ms after the request,
although it knew the client's writer. So a request without a response is repeated.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from rcl_interfaces.msg import ParameterEvent
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node
from rclpy.parameter import parameter_value_to_python
from rclpy.qos import qos_profile_parameter_events
from rclpy.task import Future

from fracture_collision.ros.fastdds.extras import is_nameless
from fracture_collision.world import Settings

ASK_AGAIN = 5.0  # [s]


class ServiceSettings:
    """Passes `on_settings` the settings of the node that publishes on `topic`, when it appears and when they change."""

    def __init__(self, node: Node, topic: str, on_settings: Callable[[dict[str, Any]], None]) -> None:
        self._node = node
        self._topic = topic
        self._on_settings = on_settings
        self._known: bytes | None = None  # the publisher whose settings are known
        self._client: Any = None
        self._request: Future | None = None  # without a response yet
        self._request_due = 0.0  # time.monotonic() of the next request
        self._asking: tuple[bytes, str] | None = None  # the publisher that gets the requests, and its node
        node.create_subscription(ParameterEvent, "/parameter_events", self._on_event, qos_profile_parameter_events)

    def look(self) -> None:
        """Sends a request to a publisher that has not responded yet. Must be called regularly."""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        if not publishers or is_nameless(publishers[0]):
            return
        gid = bytes(publishers[0].endpoint_gid)
        name = f"{publishers[0].node_namespace.rstrip('/')}/{publishers[0].node_name}"
        if gid == self._known:
            return
        if self._asking is None or self._asking[0] != gid:
            self._drop_client()
            self._asking, self._request_due = (gid, name), 0.0
            self._client = self._node.create_client(GetParameters, f"{name}/get_parameters")
        if self._client.service_is_ready() and time.monotonic() >= self._request_due:
            self._request_due = time.monotonic() + ASK_AGAIN
            self._drop_request()
            self._request = self._client.call_async(GetParameters.Request(names=list(Settings._fields)))
            self._request.add_done_callback(self._on_answer)

    def _on_event(self, event: ParameterEvent) -> None:
        if self._asking is None or event.node != self._asking[1]:
            return
        if any(parameter.name in Settings._fields for parameter in event.changed_parameters):
            # a response on its way may predate the change
            self._drop_request()
            self._known, self._request_due = None, 0.0

    def _on_answer(self, future: Future) -> None:
        if future is not self._request or self._asking is None:
            return  # to a dropped request
        self._known, self._request = self._asking[0], None  # a restarted service is another publisher
        if future.exception() is not None:
            self._node.get_logger().warning(f"cannot read the service's settings: {future.exception()}")
            return
        values = [parameter_value_to_python(value) for value in future.result().values]
        if len(values) == len(Settings._fields) and None not in values:
            self._on_settings(dict(zip(Settings._fields, values, strict=True)))

    def _drop_request(self) -> None:
        if self._request is not None:
            self._client.remove_pending_request(self._request)
            self._request = None

    def _drop_client(self) -> None:
        self._drop_request()
        if self._client is not None:
            self._node.destroy_client(self._client)
            self._client = None

"""Nodes and clients of one domain, on this machine only, all stopped by `close`. For tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from campaigns.kills.stage import Stage
from fracture_collision.ros.processes.node_process import NodeProcess
from stages.ros_client import ServiceClient

LARGEST_MESSAGE = 100_000  # [bytes] that the shared service of test/ros takes


class StageWithClients(Stage):
    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self._clients: list[ServiceClient] = []

    def client(self, *ros_arguments: str) -> ServiceClient:
        self._clients.append(ServiceClient(self.domain_id, ros_arguments))
        return self._clients[-1]

    def served(self, *arguments: str, **parameters: Any) -> tuple[NodeProcess, ServiceClient]:
        """A service that is ready, and a client of it."""
        service = self.start("collision_node", *arguments, threads=1, **parameters)
        client = self.client(*arguments)
        client.await_service()
        return service, client

    def close(self) -> None:
        for client in self._clients:
            client.close()
        super().close()

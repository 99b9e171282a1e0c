"""Nodes and clients of one domain, on this machine alone, all ended at the end. For tests."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from ros_client import ServiceClient

from fracture_collision.ros.node_process import free_domain_id, loopback_environment


class Stage:
    def __init__(self, folder: Path) -> None:
        self.domain_id = free_domain_id()
        self._folder = folder
        self._started: list[tuple[subprocess.Popen, Path]] = []
        self._clients: list[ServiceClient] = []

    def start(self, module: str, *ros_arguments: str, **parameters: Any) -> subprocess.Popen:
        """A node of fracture_collision.ros as its users start it."""
        given = [part for name, value in parameters.items() for part in ("-p", f"{name}:={json.dumps(value)}")]
        log = self._folder / f"{module}_{len(self._started)}.log"
        command = [sys.executable, "-m", f"fracture_collision.ros.{module}", "--ros-args", *ros_arguments, *given]
        with log.open("wb") as stream:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=stream, stderr=stream,
                env=loopback_environment(self.domain_id),
            )  # fmt: skip
        self._started.append((process, log))
        return process

    def client(self, *ros_arguments: str) -> ServiceClient:
        self._clients.append(ServiceClient(self.domain_id, ros_arguments))
        return self._clients[-1]

    def log(self, process: subprocess.Popen) -> str:
        return next(log for started, log in self._started if started is process).read_text(errors="replace")

    def close(self) -> None:
        for client in self._clients:
            client.close()
        for process, _ in self._started:
            process.terminate()
        for process, _ in self._started:
            try:
                process.wait(20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

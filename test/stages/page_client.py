"""A client that uses viser's protocol as its browser client does, and may send what no browser would. For tests."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any
from uuid import uuid4

import msgspec
import viser
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from benchmarks.page.lookers import messages_of

PATIENCE = 60.0  # [s]
CAMERA = {
    "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, 0.0, 0.0), "fov": 1.0, "near": 0.1,
    "far": 10.0, "image_height": 10, "image_width": 10, "look_at": (0.0, 1.0, 0.0), "up_direction": (0.0, 0.0, 1.0),
}  # fmt: skip


class PageClient:
    def __init__(self, connection: ClientConnection) -> None:
        self._connection = connection
        self._knobs: dict[str, str] = {}  # by label
        self.notices: list[str] = []
        self.acknowledged: list[int] = []  # bytes of uploads
        self.removed: list[str] = []  # notices
        self._send(CAMERA)  # viser ignores a client until it sends its camera
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def set(self, label: str, value: Any, property: str = "value") -> None:
        """Sets a control as a user would; another `property` as nobody would."""
        wait_until(lambda: label in self._knobs)
        self._send({"type": "GuiUpdateMessage", "uuid": self._knobs[label], "updates": {property: value}})

    def upload(self, label: str, name: str, parts: list[bytes], size: int | None = None) -> None:
        """Sends a file as a browser would; `size`: that it declares, by default its own."""
        wait_until(lambda: label in self._knobs)
        button, transfer = self._knobs[label], str(uuid4())
        self._send(
            {"type": "FileTransferStartUpload", "source_component_uuid": button, "transfer_uuid": transfer,
             "filename": name, "mime_type": "", "part_count": len(parts),
             "size_bytes": sum(map(len, parts)) if size is None else size}
        )  # fmt: skip
        for index, part in enumerate(parts):
            self._send(
                {"type": "FileTransferPart", "source_component_uuid": button, "transfer_uuid": transfer,
                 "part_index": index, "content": part}
            )  # fmt: skip

    def _send(self, message: dict[str, Any]) -> None:
        self._connection.send(msgspec.msgpack.encode(message))

    def _take(self) -> None:
        try:
            for frame in self._connection:
                for message in messages_of(frame):
                    label = (message.get("props") or {}).get("label")
                    if label is not None and "uuid" in message:
                        self._knobs[label] = message["uuid"]
                    if message["type"] == "NotificationShowMessage":
                        self.notices.append(message["props"]["body"])
                    elif message["type"] == "FileTransferPartAck":
                        self.acknowledged.append(message["transferred_bytes"])
                    elif message["type"] == "RemoveNotificationMessage":
                        self.removed.append(message["uuid"])
        except ConnectionClosed:
            pass


@contextmanager
def page_client(address: str, **options: Any) -> Iterator[PageClient]:
    """`options`: of websockets' client, such as `origin`. Raises InvalidStatus if the page rejects the connection."""
    with connect(
        address.replace("http", "ws", 1), subprotocols=[f"viser-v{viser.__version__}"], compression=None,
        max_size=None, **options,
    ) as connection:  # fmt: skip
        yield PageClient(connection)


def wait_until(there: Callable[[], object]) -> None:
    end = time.monotonic() + PATIENCE
    while not there():
        assert time.monotonic() < end
        time.sleep(0.01)

"""Streaming of values that change many times a second to the browsers: poses, contacts.

viser compares every value set on a handle with the last one, and keeps it for pages that connect later. For poses of
hundreds of fragments that is too expensive: 15 ms for 200 poses, where the messages alone take 1.6 ms; and a page that
connects after an hour would have to skip millions of log entries. So these messages go into each page's own queue,
which viser does not keep and in which a newer value replaces an older one of the same thing: a slow page skips frames
and does not lag behind. `send_all` sends the last values to a page that connects later.

All files of this folder use internals of viser 1.1 (here the queue and some message types).
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from typing import Any

import numpy as np
import viser
from viser import _messages as messages

from fracture_collision.viewer.page.server.page_document import TITLE

# [m], and for quaternion components: smaller changes are not sent. Rounding moves resting bodies by less than this.
STILL = 1e-6
NOTICE = 8.0  # [s] that a notification stays


class LiveValues:
    """Newest values of scene nodes, by name. Any thread may call; calls do not wait for the network."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._lock = threading.Lock()
        self._poses: dict[str, np.ndarray] = {}  # (7,): position, then w x y z
        self._properties: dict[str, dict[str, Any]] = {}
        self.messages_sent = 0  # to each page

    def pose(self, names: Sequence[str], poses: np.ndarray) -> None:
        """Place the nodes of these names; poses (n, 7): positions [m] and unit quaternions w x y z, in the world."""
        queued: list[Any] = []
        with self._lock:
            known = self._poses
            before = np.array([known.get(name, _NOWHERE) for name in names]).reshape(-1, 7)
            difference = np.abs(poses - before) > STILL
            for i in np.flatnonzero(difference.any(axis=1)).tolist():
                name, pose = names[i], poses[i]
                known[name] = pose
                if difference[i, :3].any():
                    queued.append(messages.SetPositionMessage(name, tuple(pose[:3].tolist())))
                if difference[i, 3:].any():
                    queued.append(messages.SetOrientationMessage(name, tuple(pose[3:].tolist())))
        self._send(queued)

    def properties(self, name: str, **values: Any) -> None:
        """Properties of one node, together in one message."""
        with self._lock:
            self._properties[name] = values
        self._send([messages.SceneNodeUpdateMessage(name, values)])

    def forget(self, name: str) -> None:
        """Drop the values of a node that was removed or replaced."""
        with self._lock:
            self._poses.pop(name, None)
            self._properties.pop(name, None)

    def send_all(self, client: viser.ClientHandle) -> None:
        """Send the last value of everything to a page that has just connected."""
        with self._lock:
            queued: list[Any] = []
            for name, pose in self._poses.items():
                queued.append(messages.SetPositionMessage(name, tuple(pose[:3].tolist())))
                queued.append(messages.SetOrientationMessage(name, tuple(pose[3:].tolist())))
            queued += [messages.SceneNodeUpdateMessage(name, values) for name, values in self._properties.items()]
        _queue(client, queued)

    def _send(self, queued: list[Any]) -> None:
        if queued:
            self.messages_sent += len(queued)
            for client in self._server.get_clients().values():
                _queue(client, queued)


def show_notice(client: viser.ClientHandle, words: str) -> None:
    """Show a notification for some seconds in one browser."""
    client.add_notification(TITLE, words, auto_close_seconds=NOTICE)


def run_script(client: viser.ClientHandle, source: str) -> None:
    """Run JavaScript in one page; pages that connect later do not run it."""
    _queue(client, [messages.RunJavascriptMessage(source)])


_NOWHERE = np.full(7, np.inf)


def _queue(client: viser.ClientHandle, queued: list[Any]) -> None:
    with client.atomic():
        for message in queued:
            client._websock_connection.queue_message(message)
    client.flush()  # else they would wait in the buffer until those of the next frame replace them

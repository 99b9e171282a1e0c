"""Files that browsers send to the page, collected within limits.

viser collects any number of parts of any length, and tells all browsers how much has arrived; those that sent nothing
then show the progress of a file without a name. So its handlers are replaced by those below (written for viser 1.1): a
file is rejected by its declared length before any of it is kept, what arrives is no longer than declared, and only the
browser that sends the file hears of it. The file's name is text for messages, never a path.
"""

from __future__ import annotations

import posixpath
from collections.abc import Callable
from typing import Any, NamedTuple

import viser
from viser import _messages as messages

from fracture_collision.viewer.page.page_events import Upload
from fracture_collision.viewer.page.server.page_stream import show_notice

MOST_BYTES = 20_000_000  # of a file
MOST_TRANSFERS = 4  # at a time, of all browsers together
MOST_CHARACTERS, SHOWN_CHARACTERS = 255, 60  # of a name


class _Transfer(NamedTuple):
    uuid: str
    name: str
    size: int  # [bytes] as declared
    content: bytearray  # so far


class Uploads:
    """The button that sends a file. Its methods, except `_tell`, run in the thread of viser's event loop."""

    def __init__(
        self, server: viser.ViserServer, label: str, suffixes: tuple[str, ...], uploaded: Callable[[Upload], None]
    ) -> None:
        """`uploaded` gets each complete file whose name ends in one of `suffixes`."""
        self._server, self._suffixes, self._uploaded = server, suffixes, uploaded
        self._transfers: dict[int, _Transfer] = {}  # by client: one each
        gui: Any = server.gui
        for message_class, handler in (
            (messages.FileTransferStartUpload, self._begin), (messages.FileTransferPart, self._take),
        ):  # fmt: skip
            gui._websock_interface.unregister_handler(message_class)
            gui._websock_interface.register_handler(message_class, handler)
        self._button = gui.add_upload_button(
            label, icon=viser.Icon.UPLOAD, mime_type=",".join(suffixes), hint=f"{', '.join(suffixes)}, up to {_size()}."
        )
        server.on_client_disconnect(self._forget)

    def _forget(self, client: viser.ClientHandle) -> None:
        self._transfers.pop(client.client_id, None)

    def _begin(self, client_id: int, message: Any) -> None:
        client = self._server.get_clients().get(client_id)
        if client is None or message.source_component_uuid != self._button._impl.uuid:
            return
        self._transfers.pop(client_id, None)
        name, size = str(message.filename), int(message.size_bytes)
        if reason := self._refusal(name, size):
            self._end(client, message.transfer_uuid, size)
            show_notice(client, f"{shown(name)}: {reason}")
        else:
            self._transfers[client_id] = _Transfer(message.transfer_uuid, name, size, bytearray())

    def _refusal(self, name: str, size: int) -> str:
        """The reason to reject a file; "": accepted."""
        if name != posixpath.basename(name.replace("\\", "/")) or not name.isprintable():
            return "a file's name has no folders and no control characters"
        if len(name) > MOST_CHARACTERS:
            return f"the name has more than {MOST_CHARACTERS} characters"
        if not name.lower().endswith(self._suffixes):
            return f"the name ends in none of {', '.join(self._suffixes)}"
        if size <= 0:
            return "the file is empty"
        if size > MOST_BYTES:
            return f"{size / 1e6:.1f} MB, more than {_size()}"
        if len(self._transfers) >= MOST_TRANSFERS:
            return "others are sending files; try again"
        return ""

    def _take(self, client_id: int, message: Any) -> None:
        """Parts arrive in order: it is one connection."""
        client, transfer = self._server.get_clients().get(client_id), self._transfers.get(client_id)
        if client is None or transfer is None or message.transfer_uuid != transfer.uuid:
            return
        if len(transfer.content) + len(message.content) > transfer.size:
            del self._transfers[client_id]
            self._end(client, transfer.uuid, transfer.size)
            show_notice(client, f"{shown(transfer.name)}: longer than declared")
            return
        transfer.content.extend(message.content)
        if len(transfer.content) < transfer.size:
            self._acknowledge(client, transfer.uuid, len(transfer.content), transfer.size)
            return
        del self._transfers[client_id]
        self._end(client, transfer.uuid, transfer.size)
        self._uploaded(Upload(transfer.name, bytes(transfer.content), lambda words: self._tell(client, words)))

    def _tell(self, client: viser.ClientHandle, words: str) -> None:
        """Any thread may call, also when the browser has gone."""
        if client.client_id in self._server.get_clients():
            show_notice(client, words)

    def _end(self, client: viser.ClientHandle, uuid: str, size: int) -> None:
        """Make the browser's button ready again, and remove its notice of progress: another one has the outcome."""
        self._acknowledge(client, uuid, size, size)
        client._websock_connection.queue_message(messages.RemoveNotificationMessage(f"upload-{uuid}"))

    def _acknowledge(self, client: viser.ClientHandle, uuid: str, arrived: int, size: int) -> None:
        client._websock_connection.queue_message(
            messages.FileTransferPartAck(self._button._impl.uuid, uuid, arrived, size)
        )


def shown(name: str) -> str:
    """A file's name as text of a message."""
    printable = "".join(character if character.isprintable() else "?" for character in name)
    return printable if len(printable) <= SHOWN_CHARACTERS else f"{printable[:SHOWN_CHARACTERS]}..."


def _size() -> str:
    return f"{MOST_BYTES / 1e6:.0f} MB"

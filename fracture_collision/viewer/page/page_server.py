"""The viser server behind a page: on an address that is free, behind the gate, with the page's own document."""

from __future__ import annotations

import contextlib
import io
import socket

import viser

from fracture_collision.viewer.page.page_document import Document
from fracture_collision.viewer.page.page_gate import Gate, GateError, guarded

LOCALHOST = "127.0.0.1"


class LocalServer(viser.ViserServer):
    """Serves only this machine, or the interface of its host: sharing through a public relay is disabled."""

    def request_share_url(self, verbose: bool = True) -> str | None:
        """Always None: there is no public address."""
        return None


def started_server(host: str, port: int, document: Document, label: str) -> LocalServer:
    """A server that answers with `document`; `port` 0: any free one; `label`: the heading of the panel.

    Raises OSError if the address cannot be served; GateError, after stopping the server, if requests would go
    unchecked.
    """
    _check_free(host, port)
    server = None
    with _viser_is_quiet():
        try:
            with guarded(Gate(host), document.edited):
                server = LocalServer(host=host, port=port, label=label, verbose=False)
        except GateError:
            if server is not None:
                server.stop()
            raise
    return server


def stop_server(server: LocalServer) -> None:
    """End the page for all browsers."""
    with _viser_is_quiet():
        server.stop()


def _check_free(host: str, port: int) -> None:
    """Raise OSError if the address cannot be bound.

    viser would wait for ever on a host that is not this machine's, and use the next port if this one is taken.
    """
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as trial:
        trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        trial.bind((host, port))


@contextlib.contextmanager
def _viser_is_quiet():
    """Suppress the table of addresses and the farewell that viser prints at any verbosity."""
    with contextlib.redirect_stdout(io.StringIO()):
        yield

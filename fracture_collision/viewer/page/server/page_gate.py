"""The server of the page, with its request check: it answers only browsers that opened it by its own address.

A browser lets any web page open a websocket to any address and leaves the check of the Origin to the server; viser does
none. And a web page whose name resolves to this machine (DNS rebinding) has an Origin of its own that matches its Host.
So both headers of every request are checked:

- Host must be an address of the page, with its port. Names that a foreign name server may resolve are rejected.
- Origin, if present, must be that same address. Browsers send one with every websocket. Other programs need not; they
  run on this machine, or on one that --host admits, and could send any.
- A request has no query: `?websocket=ADDRESS` would let another server control the page under this one's origin.
- The page may not be framed by another one, which could redirect its clicks to this page.

viser has no hook for requests. So while a server is created, the function by which viser's module starts listening is
replaced by one that runs the check first (written for viser 1.1); if viser does not call it, no page is served.

Values of controls are checked before viser keeps them and passes them on to all browsers (`keep_values_in_range`). A
browser keeps to a control's range and options; another client need not. viser stores any value, and any other property
of the control. A number outside its range may end the node that calculates with it, and an integer that no message can
carry ends the connection of every browser. So viser's handler is replaced by one that passes on values only, clamped to
their control's range.
"""

from __future__ import annotations

import contextlib
import http
import io
import ipaddress
import socket
import threading
from collections.abc import Callable, Iterator
from typing import Any

import viser
import websockets.asyncio.server
from viser import _messages as messages
from viser.infra import _infra as viser_infra
from websockets import Headers
from websockets.http11 import Request, Response

from fracture_collision.viewer.page.server.page_document import Document

LOCALHOST = "127.0.0.1"
LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "[::1]")
NOT_FRAMED = {"X-Frame-Options": "DENY", "Content-Security-Policy": "frame-ancestors 'none'"}
_HTTP_PORT = 80  # default port, which Host may omit

_one_at_a_time = threading.Lock()


class GateError(RuntimeError):
    """viser starts its server in a way this file does not expect: requests would go unchecked."""


class Gate:
    """The requests that a server on `host` answers."""

    def __init__(self, host: str) -> None:
        self._hosts = {*LOOPBACK_HOSTS, bracketed(host).lower()}
        address = _address(host)
        self._is_open = host == "" or (address is not None and address.is_unspecified)
        if self._is_open:  # accept this machine's name and any IP address, too
            self._hosts.add(socket.gethostname().lower())

    def refusal(self, headers: Headers, path: str, port: int) -> str:
        """The reason to reject a request for `path` at this `port`; "": accepted."""
        hosts, origins = headers.get_all("Host"), headers.get_all("Origin")
        if len(hosts) != 1 or not self._is_own(hosts[0].lower(), port):
            return "the Host header is not the page's address"
        if origins and [origin.lower() for origin in origins] != [f"http://{hosts[0].lower()}"]:
            return "commands are accepted from the page itself only"
        if "?" in path:
            return "an address with a query is not accepted"
        return ""

    def _is_own(self, host: str, port: int) -> bool:
        name, colon, digits = host.rpartition(":")
        if not colon or "]" in digits:
            name, digits = host, str(_HTTP_PORT)
        if digits != str(port):
            return False
        # An IP address, unlike a name, cannot resolve to another machine.
        return name in self._hosts or (self._is_open and _address(name.strip("[]")) is not None)


@contextlib.contextmanager
def guarded(gate: Gate, edited: Callable[[Response], Response] = lambda response: response) -> Iterator[None]:
    """A viser server created inside answers only requests that `gate` accepts, with its responses as `edited` them.

    Raises GateError; then the server must not be used: it may listen without any check.
    """
    served = False

    def serve(*arguments: Any, process_request: Callable[..., Response | None] | None = None, **options: Any) -> Any:
        nonlocal served
        served = True

        def process(connection: Any, request: Request) -> Response | None:
            port = connection.transport.get_extra_info("sockname")[1]
            if reason := gate.refusal(request.headers, request.path, port):
                body = f"{reason}\n".encode()
                headers = Headers({"Content-Type": "text/plain", "Content-Length": str(len(body)), **NOT_FRAMED})
                return Response(http.HTTPStatus.FORBIDDEN, "Forbidden", headers, body)
            response = None if process_request is None else process_request(connection, request)
            if response is not None:
                response = edited(response)
                response.headers.update(NOT_FRAMED)
            return response

        return websockets.asyncio.server.serve(*arguments, process_request=process, **options)

    with _one_at_a_time:
        theirs = viser_infra.websockets
        server = _Instead(websockets.asyncio.server, serve=serve)
        instead: Any = _Instead(theirs, asyncio=_Instead(theirs.asyncio, server=server))
        viser_infra.websockets = instead
        try:
            yield
        finally:
            viser_infra.websockets = theirs
    if not served:
        raise GateError(f"viser {viser.__version__} would leave requests unchecked: install viser 1.1")


class _Instead:
    """A module with some of its names replaced."""

    def __init__(self, module: Any, **replaced: Any) -> None:
        self.__dict__.update(replaced)
        self._module = module

    def __getattr__(self, name: str) -> Any:
        return getattr(self._module, name)


def bracketed(host: str) -> str:
    """The host as written in a URL: IPv6 addresses in brackets."""
    return f"[{host}]" if ":" in host else host


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


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
    keep_values_in_range(server)
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


def keep_values_in_range(server: viser.ViserServer) -> None:
    """From now on drop values that are not of their control's type and options, and clamp numbers to its range."""
    gui: Any = server.gui
    pass_on = gui._handle_gui_updates

    async def check(client_id: int, message: Any) -> None:
        knob = gui._gui_input_handle_from_uuid.get(message.uuid)
        value = None if knob is None or not isinstance(message.updates, dict) else _valid(knob, message.updates)
        if value is not None:
            await pass_on(client_id, messages.GuiUpdateMessage(message.uuid, {"value": value}))

    gui._websock_interface.unregister_handler(messages.GuiUpdateMessage, pass_on)
    gui._websock_interface.register_handler(messages.GuiUpdateMessage, check)


def _valid(knob: Any, updates: dict[str, Any]) -> bool | int | float | str | None:
    """The value for `knob`; None if it is none."""
    present, value, props = knob._impl.value, updates.get("value"), knob._impl.props
    if isinstance(present, bool):
        return value if isinstance(value, bool) else None
    if isinstance(present, int | float):
        is_number = isinstance(value, int | float) and not isinstance(value, bool) and value == value
        return min(max(value, props.min), props.max) if is_number else None
    return value if isinstance(value, str) and value in props.options else None

"""Access to the page: only its own origin at its own address, and no web page from another site."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from queue import Queue
from typing import Any
from urllib.parse import urlsplit

import pytest
import viser
from stages.page_client import PageClient, page_client
from websockets import Headers

from fracture_collision.viewer.page.page import Page
from fracture_collision.viewer.page.page_controls import SLOWEST
from fracture_collision.viewer.page.page_events import Handlers, SettingKnob, Start
from fracture_collision.viewer.page.server import page_gate
from fracture_collision.viewer.page.server.page_gate import Gate, GateError, guarded

FOREIGN = ("http://evil.example", "https://evil.example", "null", "http://localhost.evil.example", "file://")


@pytest.fixture(scope="module")
def port() -> Iterator[int]:
    with Page() as page:
        yield urlsplit(page.address).port


def answer(port: int, host: str, origin: str | None = None, upgrade: bool = False, path: str = "/") -> tuple[int, str]:
    """Status and head of the page's response; `upgrade`: request a websocket, as viser's own client does."""
    lines = [f"GET {path} HTTP/1.1", f"Host: {host}"]
    lines += [f"Origin: {origin}"] if origin is not None else []
    if upgrade:
        lines += ["Connection: Upgrade", "Upgrade: websocket", "Sec-WebSocket-Version: 13",
                  "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
                  f"Sec-WebSocket-Protocol: viser-v{viser.__version__}"]  # fmt: skip
    with socket.create_connection(("127.0.0.1", port), timeout=30.0) as connection:
        connection.sendall("\r\n".join([*lines, "", ""]).encode())
        head = b""
        while b"\r\n\r\n" not in head and (more := connection.recv(4096)):
            head += more
    return int(head.split()[1]), head.decode(errors="replace")


@pytest.mark.parametrize("name", ["localhost", "127.0.0.1", "[::1]", "LOCALHOST"])
def test_requests_to_the_own_address_are_served(port: int, name: str) -> None:
    host = f"{name}:{port}"
    status, head = answer(port, host)
    assert status == 200 and "frame-ancestors 'none'" in head and "X-Frame-Options: DENY" in head
    assert answer(port, host, f"http://{host}", upgrade=True)[0] == 101
    assert answer(port, host, upgrade=True)[0] == 101, "a program that is no browser"


@pytest.mark.parametrize("upgrade", [False, True])
def test_requests_with_a_foreign_host_are_rejected(port: int, upgrade: bool) -> None:
    """As in DNS rebinding, where Origin and Host agree."""
    for host in ("evil.example", f"evil.example:{port}", f"127.0.0.1.evil.example:{port}", f"127.0.0.1:{port + 1}",
                 "127.0.0.1", f"10.0.0.1:{port}", ""):  # fmt: skip
        for origin in (None, f"http://{host}"):
            assert answer(port, host, origin, upgrade)[0] == 403, (host, origin)


def test_a_foreign_origin_gets_no_websocket(port: int) -> None:
    """Also another port of this machine."""
    host = f"localhost:{port}"
    near = (f"http://localhost:{port + 1}", "http://localhost", f"https://{host}", f"http://127.0.0.1:{port}")
    for origin in (*FOREIGN, *near):
        for upgrade in (False, True):
            assert answer(port, host, origin, upgrade)[0] == 403, origin


def test_urls_that_name_another_server_are_rejected(port: int) -> None:
    """A client of viser would connect to another server if the URL's query names one."""
    for query in ("?websocket=ws://evil.example", "?playbackPath=//evil.example/x", "?"):
        assert answer(port, f"127.0.0.1:{port}", path=f"/{query}")[0] == 403


def test_repeated_headers_are_rejected() -> None:
    gate, own = Gate("127.0.0.1"), "localhost:8080"
    assert not gate.refusal(Headers(Host=own), "/", 8080)
    assert gate.refusal(Headers([("Host", own), ("Host", own)]), "/", 8080)
    origins = [("Origin", f"http://{own}"), ("Origin", "http://evil.example")]
    assert gate.refusal(Headers([("Host", own), *origins]), "/", 8080)
    assert gate.refusal(Headers(), "/", 8080)


def test_names_of_a_page_on_the_network() -> None:
    named, anywhere = Gate("10.1.2.3"), Gate("0.0.0.0")
    for host, at_named, at_any in (
        ("10.1.2.3", True, True), ("localhost", True, True), ("10.9.9.9", False, True), ("[fe80::1]", False, True),
        (socket.gethostname(), False, True), ("evil.example", False, False),
    ):  # fmt: skip
        headers = Headers(Host=f"{host}:8080", Origin=f"http://{host}:8080")
        assert bool(named.refusal(headers, "/", 8080)) != at_named, host
        assert bool(anywhere.refusal(headers, "/", 8080)) != at_any, host
    without_port = Headers(Host="[::1]")
    assert not Gate("::1").refusal(without_port, "/", 80) and Gate("::1").refusal(without_port, "/", 81)


def test_values_are_kept_within_their_controls(browserless: tuple[Queue[Any], PageClient, PageClient]) -> None:
    """Regardless of what a client sends; other clients stay connected."""
    heard, client, other = browserless
    for scene in ("/etc/passwd", "no such scene", "pane"):
        client.set("scene", scene)
    assert heard.get(timeout=30.0) == "pane"
    for value in (float("nan"), "7", True, None, [1], {}, 10.0**30):
        client.set("contacts_per_pair", value)
    assert heard.get(timeout=30.0).contacts_per_pair == 1024
    for value in ("none", 1, "glondu2014"):
        client.set("method", value)
    assert heard.get(timeout=30.0).method == "glondu2014"
    client.set("slow motion", 0)
    assert heard.get(timeout=30.0) == SLOWEST
    client.set("slow motion", "1", property="update_cb")  # would replace the control's handlers
    other.set("slow motion", float("inf"))
    assert heard.get(timeout=30.0) == 1.0
    assert heard.empty()


@pytest.fixture
def browserless() -> Iterator[tuple[Queue[Any], PageClient, PageClient]]:
    """What the handlers of a page hear, and two clients of it."""
    heard: Queue[Any] = Queue()
    knobs = {
        "contacts_per_pair": SettingKnob("contacts of a pair", 1, 1024),
        "method": SettingKnob("contacts", choices=("exact", "glondu2014")),
    }
    handlers = Handlers(slow_motion=heard.put, service_set=heard.put, scene_chosen=heard.put)
    with (
        Page(handlers, Start(("plates", "pane"), "plates", settings=knobs)) as page,
        page_client(page.address) as client,
        page_client(page.address) as other,
    ):
        yield heard, client, other


def test_another_version_of_viser_serves_no_page(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rather than a page without checks."""
    with pytest.raises(GateError, match="unchecked"), guarded(Gate("127.0.0.1")):
        pass
    stopped = []

    class Other:
        def __init__(self, **_options: object) -> None:
            pass

        def stop(self) -> None:
            stopped.append(self)

    monkeypatch.setattr(page_gate, "LocalServer", Other)
    with pytest.raises(GateError, match=viser.__version__):
        Page()
    assert len(stopped) == 1

"""Who looks at the page: one that takes what a browser is handed and draws nothing, and a real browser that draws.

All times are the wall clock's [s], as DDS stamps its messages with it: nodes, lookers and browser are on one machine.
"""

from __future__ import annotations

import re
import shutil
import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import msgspec.msgpack
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")  # root has no other way
WINDOW = {"width": 1280, "height": 720}
PATIENCE_MS = 120_000
AT_REST = 4  # pictures in which everything that has come is unpacked and drawn
_FRAGMENT = re.compile(r"/run\d+/fragment(\d+)")
# viser's frames: sizes of the messages as they were and compressed, then those, then arrays.
_SIZES = struct.Struct("<QQ")


class Mesh(NamedTuple):
    time: float
    fragment_id: int


class Pictures(NamedTuple):
    """Since the last time that was asked."""

    seconds: float
    count: int
    moved: float  # fragments a picture


class Looker(Protocol):
    def meshes(self) -> list[Mesh]:
        """All that have come so far, by time."""

    def shown(self) -> list[float]:
        """When pictures with something new in them were drawn; of who draws none, none."""

    def pictures(self) -> Pictures: ...


class Taker:
    """Takes all that a browser is handed, as fast as it comes."""

    def __init__(self, address: str) -> None:
        self._meshes: list[Mesh] = []
        self._lock = threading.Lock()
        self._count = self._moved = 0  # pictures, and places in them
        self._placed: set[int] = set()  # fragments, in the last of them
        self._asked = time.time()
        # by this viser knows a page from a stranger
        self._socket = connect(
            address.replace("http", "ws", 1), subprotocols=[f"viser-v{viser.__version__}"], compression=None,
            max_size=None,
        )  # fmt: skip
        self._socket.send(msgspec.msgpack.encode(_camera()))
        self._thread = threading.Thread(target=self._take, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._socket.close()
        self._thread.join()

    def meshes(self) -> list[Mesh]:
        return list(self._meshes)

    def shown(self) -> list[float]:
        return []

    def pictures(self) -> Pictures:
        with self._lock:
            count, moved, self._count, self._moved = self._count, self._moved, 0, 0
            asked, self._asked = self._asked, time.time()
        return Pictures(self._asked - asked, count, moved / max(count, 1))

    def _take(self) -> None:
        try:
            for frame in self._socket:
                self._note(time.time(), messages_of(frame))
        except ConnectionClosed:
            pass

    def _note(self, now: float, messages: list[dict[str, Any]]) -> None:
        placed = []
        for message in messages:
            found = _FRAGMENT.fullmatch(message.get("name") or "")
            if found and message["type"] == "GlbMessage":
                self._meshes.append(Mesh(now, int(found[1])))
            elif found and message["type"] == "SetPositionMessage":
                placed.append(int(found[1]))
        with self._lock:
            for fragment_id in placed:
                if fragment_id in self._placed or not self._placed:  # a picture places each once
                    self._count += 1
                    self._placed.clear()
                self._moved += 1
                self._placed.add(fragment_id)


def messages_of(frame: bytes) -> list[dict[str, Any]]:
    """What viser 1.1 sends a browser, less arrays."""
    size, compressed = _SIZES.unpack_from(frame)
    packed = zstandard.ZstdDecompressor().decompress(frame[_SIZES.size : _SIZES.size + compressed], size)
    return msgspec.msgpack.decode(packed)["messages"]


def _camera() -> dict[str, Any]:
    """A browser's first words."""
    return {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -3.0, 1.0), "fov": 0.7,
        "near": 0.01, "far": 1000.0, "image_height": WINDOW["height"], "image_width": WINDOW["width"],
        "look_at": (0.0, 0.0, 0.7), "up_direction": (0.0, 0.0, 1.0),
    }  # fmt: skip


# Notes in the page when meshes come (from the thread that reads its socket), when a picture is drawn, and when one that
# had new geometry in it is out: at the second animation frame after it, as the browser draws ahead by one.
_NOTES = """
(() => {
  const now = () => (performance.timeOrigin + performance.now()) / 1000.0;
  const notes = (window.__notes = { meshes: [], shown: [], pictures: 0 });
  window.Worker = class extends Worker {
    constructor(...given) {
      super(...given);
      this.addEventListener("message", (event) => {
        if (event.data?.type !== "message_batch") return;
        for (const message of event.data.messages)
          if (message.type === "GlbMessage") notes.meshes.push([now(), message.name]);
      });
    }
  };
  const gl = WebGL2RenderingContext.prototype;
  let frame = 0, drew = false;
  const fresh = [];
  for (const name of ["drawElements", "drawArrays"]) {
    const draw = gl[name];
    gl[name] = function (...given) { drew = true; return draw.apply(this, given); };
  }
  const upload = gl.bufferData;
  gl.bufferData = function (...given) {
    if (fresh.at(-1) !== frame) fresh.push(frame);
    return upload.apply(this, given);
  };
  const next = () => {
    frame += 1;
    notes.pictures += drew;
    drew = false;
    while (fresh.length && fresh[0] <= frame - 2) { fresh.shift(); notes.shown.push(now()); }
    requestAnimationFrame(next);
  };
  requestAnimationFrame(next);
})();
"""


class Browser:
    """Chromium, drawing by software: its pictures are few, and take the nodes' processors."""

    def __init__(self, page: Any) -> None:
        self._page = page
        self._count, self._asked = 0, time.time()

    def meshes(self) -> list[Mesh]:
        told = self._page.evaluate("window.__notes.meshes")
        return [Mesh(when, int(found[1])) for when, name in told if (found := _FRAGMENT.fullmatch(name))]

    def shown(self) -> list[float]:
        return self._page.evaluate("window.__notes.shown")

    def pictures(self) -> Pictures:
        before, asked = self._count, self._asked
        self._count, self._asked = self.drawn(), time.time()
        return Pictures(self._asked - asked, self._count - before, 0.0)

    def tick(self, label: str) -> None:
        self._page.get_by_label(label).check()

    def save_picture(self, path: Path) -> None:
        """When all is there that has come, without notices."""
        self._page.add_style_tag(content=".mantine-Notification-root { display: none }")
        self._page.wait_for_function(f"window.__notes.pictures > {self.drawn() + AT_REST}")
        self._page.screenshot(path=path, timeout=PATIENCE_MS)

    def drawn(self) -> int:
        return self._page.evaluate("window.__notes.pictures")


@contextmanager
def taker(address: str) -> Iterator[Taker]:
    made = Taker(address)
    try:
        yield made
    finally:
        made.close()


@contextmanager
def browser(address: str) -> Iterator[Browser]:
    """Raises RuntimeError where there is none."""
    from playwright.sync_api import sync_playwright

    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        raise RuntimeError("there is no Chromium: apt install chromium, or --no-browser")
    with sync_playwright() as running:
        chromium = running.chromium.launch(executable_path=program, args=list(SOFTWARE))
        try:
            page = chromium.new_page(viewport=WINDOW)
            page.set_default_timeout(PATIENCE_MS)
            page.add_init_script(_NOTES)
            page.goto(address)
            page.wait_for_selector("canvas")
            page.wait_for_function("window.__notes.meshes.length && window.__notes.pictures > 3")
            yield Browser(page)
        finally:
            chromium.close()

"""The page's clients: one that receives what a browser would and draws nothing, and a real browser that draws.

All times are wall clock [s], as in DDS source timestamps: nodes, clients and browser run on one machine.
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
SOFTWARE = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")  # required when running as root
WINDOW = {"width": 1280, "height": 720}
PATIENCE_MS = 120_000
AT_REST = 4  # frames until everything that has arrived is unpacked and drawn
_FRAGMENT = re.compile(r"/run\d+/fragment(\d+)")
# viser's frame format: uncompressed and compressed size of the messages, then the messages, then arrays.
_SIZES = struct.Struct("<QQ")


class Mesh(NamedTuple):
    time: float
    fragment_id: int


class Pictures(NamedTuple):
    """Since the last call."""

    seconds: float
    count: int
    moved: float  # fragments per frame


class Looker(Protocol):
    def meshes(self) -> list[Mesh]:
        """All that have arrived so far, by time."""

    def shown(self) -> list[float]:
        """Times at which frames with new geometry were drawn; empty for a client that does not draw."""

    def pictures(self) -> Pictures: ...


class Taker:
    """Receives everything that a browser would, as fast as it arrives."""

    def __init__(self, address: str) -> None:
        self._meshes: list[Mesh] = []
        self._lock = threading.Lock()
        self._count = self._moved = 0  # frames, and positions in them
        self._placed: set[int] = set()  # fragments in the current frame
        self._asked = time.time()
        # viser accepts only clients with this subprotocol
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
                if fragment_id in self._placed or not self._placed:  # a frame sets each position once
                    self._count += 1
                    self._placed.clear()
                self._moved += 1
                self._placed.add(fragment_id)


def messages_of(frame: bytes) -> list[dict[str, Any]]:
    """The messages in one of viser 1.1's frames, without arrays."""
    size, compressed = _SIZES.unpack_from(frame)
    packed = zstandard.ZstdDecompressor().decompress(frame[_SIZES.size : _SIZES.size + compressed], size)
    return msgspec.msgpack.decode(packed)["messages"]


def _camera() -> dict[str, Any]:
    """The first message that a browser sends."""
    return {
        "type": "ViewerCameraMessage", "wxyz": (1.0, 0.0, 0.0, 0.0), "position": (0.0, -3.0, 1.0), "fov": 0.7,
        "near": 0.01, "far": 1000.0, "image_height": WINDOW["height"], "image_width": WINDOW["width"],
        "look_at": (0.0, 0.0, 0.7), "up_direction": (0.0, 0.0, 1.0),
    }  # fmt: skip


# Records in the page when meshes arrive (from its socket's thread), when a frame is drawn, and when a frame with new
# geometry is on screen: at the second animation frame after it, as the browser draws one frame ahead.
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
    """Chromium with software rendering: its frame rate is low, and it competes with the nodes for processor time."""

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
        """Waits until everything that has arrived is drawn; hides notifications."""
        self._page.add_style_tag(content=".mantine-Notification-root { display: none }")
        self._page.mouse.move(1, 1)  # away from a control, whose hint would be in the picture
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
    """Raises RuntimeError if Chromium is not installed."""
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

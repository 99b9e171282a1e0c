"""A headless Chromium with software WebGL, for tests of the page; without one they are skipped with a reason."""

from __future__ import annotations

import io
import re
import shutil
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

import numpy as np
import pytest
from matplotlib.image import imread

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")  # --no-sandbox: required as root
PATIENCE = 120.0  # [s] with software rendering on a loaded machine
WIDTH, HEIGHT = 800, 270
PANEL = 340  # [px] on the right
# viser 1.1's console error about its own listeners during a drag; harmless.
KNOWN = "Unable to preventDefault inside passive event listener"
# viser warns of software rendering in a notice over the scene, at an unpredictable time. Notices stay in the
# document, but are invisible in pictures and let clicks through.
UNSEEN = """
document.addEventListener("DOMContentLoaded", () => {
  const style = document.createElement("style");
  style.textContent = ".mantine-Notification-root { opacity: 0 !important; pointer-events: none !important }";
  document.head.append(style);
});
"""

Found = TypeVar("Found")


@contextmanager
def chromium() -> Iterator[Any]:
    playwright = pytest.importorskip("playwright.sync_api", reason="the page is tested by playwright: not installed")
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        pytest.skip("no Chromium on this machine to test the page in: apt install chromium")
    with playwright.sync_playwright() as running:
        browser = running.chromium.launch(executable_path=program, args=list(ARGUMENTS))
        try:
            yield browser
        finally:
            browser.close()


@contextmanager
def opened(browser: Any, address: str, width: int = WIDTH, height: int = HEIGHT) -> Iterator[Any]:
    """A page that has loaded the scene, in a window of this size.

    On exit it asserts that the console has no errors and that every request went to the address.
    """
    context = browser.new_context(viewport={"width": width, "height": height})
    context.add_init_script(UNSEEN)
    page = context.new_page()
    page.set_default_timeout(1e3 * PATIENCE)
    wrong: list[str] = []
    elsewhere: list[str] = []

    def on_console(said: Any) -> None:
        if said.type == "error" and KNOWN not in said.text:
            wrong.append(said.text)

    def on_request(asked: Any) -> None:
        if not asked.url.startswith((address, "data:", "blob:")):
            elsewhere.append(asked.url)

    page.on("console", on_console)
    page.on("request", on_request)
    page.on("pageerror", lambda error: wrong.append(str(error)))
    page.goto(address)
    page.wait_for_selector("canvas")
    try:
        yield page
        assert not wrong and not elsewhere, (wrong, elsewhere)
    finally:
        context.close()


def picture_of(page: Any) -> np.ndarray:
    """(height, width, 3) 0..1, of the part beside the panel."""
    shot = page.screenshot(clip={"x": 0, "y": 0, "width": WIDTH - PANEL, "height": HEIGHT}, timeout=1e3 * PATIENCE)
    return imread(io.BytesIO(shot))[..., :3]


def knob(page: Any, label: str) -> Any:
    """The input in a label's row: a slider's number or a dropdown's text."""
    row = page.locator("label", has_text=re.compile(f"^{re.escape(label)}$")).locator("xpath=ancestor::*[.//input][1]")
    return row.locator("input:visible").last


def camera_of(page: Any) -> np.ndarray:
    """Where the one browser says its camera is."""
    (client,) = page._server.get_clients().values()
    return np.array(client.camera.position)


def await_frames(seen: Any) -> None:
    """Until the browser has drawn ten times."""
    seen.evaluate("""async () => {
      for (let i = 0; i < 10; i++) await new Promise(drawn => requestAnimationFrame(drawn));
    }""")


def until(look: Callable[[], Found], good: Callable[[Found], bool], patience: float = PATIENCE) -> Found:
    """Polls `look`, which may take time itself, until `good` accepts its result."""
    end = time.monotonic() + patience
    while not good(seen := look()):
        assert time.monotonic() < end, seen
    return seen

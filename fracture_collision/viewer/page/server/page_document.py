"""The page's HTML: that of viser's client, with a title and an icon of its own, and a layout for narrow windows.

viser's client has its own name as title and its own icon. In windows of up to 576 pixels (its "xs" breakpoint, which is
a phone held upright) it shows the controls in a sheet at the bottom edge, open, as wide as on a desktop, and without a
sign that a tap closes it. Its elements have no names, so the style below finds them by viser 1.1's inline styles.
"""

from __future__ import annotations

import gzip
import html
import json
import re
from urllib.parse import quote

from websockets.http11 import Response

TITLE = "fracture_collision"
# A plate with a crack across it.
ICON = (
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 32 32"><circle cx="16" cy="16" r="15" fill="#265e96"/>'
    '<circle cx="16" cy="16" r="8.5" fill="none" stroke="#9cc3e6" stroke-width="2"/>'
    '<path d="M7 2l7 9-4 5 8 5-3 11" fill="none" stroke="#fff" stroke-width="2.5"/></svg>'
)
SHEET = 'div[style*="position: fixed"][style*="bottom: 0"]'  # the controls, in a narrow window
HANDLE = 'div[style*="cursor: pointer"][style*="height: 3.5em"]'  # of that sheet: a tap closes and opens it
NARROW = "(max-width: 576px)"
STYLE = f"""
/* Names of settings are long words. */
label {{ overflow-wrap: anywhere; }}
@media {NARROW} {{
  {SHEET}, {SHEET} div[style*="width: 20em"] {{ width: 100% !important; }}
  {SHEET} div[style*="width: 20em"] {{ zoom: 1.2; }}
  {SHEET} {{ max-height: 50% !important; }}
  {SHEET} {HANDLE}::after {{ content: "controls \\2195"; padding: 0 0.5em; color: #265e96; white-space: nowrap; }}
}}
"""
# The sheet is closed once, when it first appears; from then on it is the user's.
SCRIPT = f"""
const narrow = matchMedia({json.dumps(NARROW)});
const watch = new MutationObserver(() => {{
  const handle = narrow.matches && document.querySelector({json.dumps(f"{SHEET} {HANDLE}")});
  if (!handle) return;
  watch.disconnect();
  handle.click();
}});
watch.observe(document, {{ childList: true, subtree: true }});
"""


# viser's client listens to the arrow keys twice: for commands at the root element, for its camera at the document. An
# event reaches the root first, and is stopped there.
ARROWS_FOR_COMMANDS = """
document.documentElement.addEventListener("keydown", (event) => {
  if (event.code.startsWith("Arrow")) event.stopPropagation();
});
"""


class Document:
    """The document with its current title. Any thread may set `name`."""

    def __init__(self, name: str, has_arrow_commands: bool = False) -> None:
        """`has_arrow_commands`: the arrow keys are those of commands, and do not turn the camera."""
        self.name = name  # of the scene or recording; "": none
        self._script = SCRIPT + (ARROWS_FOR_COMMANDS if has_arrow_commands else "")

    @property
    def title(self) -> str:
        """Names what is shown, then the package."""
        return f"{self.name} - {TITLE}" if self.name else TITLE

    def edited(self, response: Response) -> Response:
        """The response of viser's server; its HTML with this title, the icon and the layout."""
        if not response.headers.get("Content-Type", "").startswith("text/html"):
            return response
        is_packed = response.headers.get("Content-Encoding") == "gzip"
        text = (gzip.decompress(response.body) if is_packed else response.body).decode()
        body = self._edited(text).encode()
        response.body = gzip.compress(body, 1) if is_packed else body
        del response.headers["Content-Length"]
        response.headers["Content-Length"] = str(len(response.body))
        return response

    def retitling(self) -> str:
        """JavaScript that gives an open page the current title."""
        return f"document.title = {json.dumps(self.title)};"

    def _edited(self, text: str) -> str:
        head = f"<title>{html.escape(self.title)}</title>\n<style>{STYLE}</style>\n<script>{self._script}</script>"
        icon = f'<link rel="icon" href="data:image/svg+xml,{quote(ICON)}" />'
        text = re.sub(r'<link\s+rel="icon"\s[^>]*>', lambda _found: icon, text, count=1)
        return re.sub(r"<title>.*?</title>", lambda _found: head, text, count=1)

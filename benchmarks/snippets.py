"""Code blocks of the documents, as their readers run them: one after the other, in one namespace."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import Any, NamedTuple

DOCS = Path(__file__).resolve().parents[1] / "docs"
_FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


class Block(NamedTuple):
    """A fenced block of a document."""

    language: str
    text: str
    line: int  # of its first line in the document


class Printed(NamedTuple):
    """What a document says that its code prints, and what it prints."""

    line: int
    expected: str
    got: str


def blocks(document: Path) -> list[Block]:
    """All fenced blocks, in their order."""
    text = document.read_text(encoding="utf-8")
    return [Block(m[1], m[2], text.count("\n", 0, m.start(2)) + 1) for m in _FENCE.finditer(text)]


def run(document: Path) -> tuple[dict[str, Any], list[Printed]]:
    """The namespace after all `python` blocks, and each `text` block with what was printed since the last."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    printed, told = [], io.StringIO()
    for block in blocks(document):
        if block.language == "python":
            code = compile("\n" * (block.line - 1) + block.text, str(document), "exec")
            with contextlib.redirect_stdout(told):
                exec(code, namespace)
        elif block.language == "text":
            printed.append(Printed(block.line, block.text, told.getvalue()))
            told = io.StringIO()
    return namespace, printed

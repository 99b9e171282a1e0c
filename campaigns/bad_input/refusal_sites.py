"""The lines of world/ that refuse input, read from its source, and which of them a campaign has reached."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path
from typing import NamedTuple

from fracture_collision import world

REFUSING = {"refuse"}
RAISED = {"InvalidMessage", "StatesAhead"}
# What it refuses are arguments of Python's calls, no messages: test/world/test_queries.py reaches each line.
NOT_OF_MESSAGES = {"queries.py"}


class Site(NamedTuple):
    file: str
    first_line: int
    last_line: int
    function: str

    def __str__(self) -> str:
        return f"{Path(self.file).relative_to(Path(world.__path__[0]).parent)}:{self.first_line} in {self.function}"


def refusal_sites() -> list[Site]:
    """Every call of `refuse` and every `raise` that refuses a message, except the one in `refuse` itself."""
    sites = []
    for file in files_of_messages():
        for function in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(function, ast.FunctionDef) and function.name not in REFUSING:
                sites += [
                    Site(str(file), node.lineno, node.end_lineno or node.lineno, function.name)
                    for node in ast.walk(function)
                    if _refuses(node)
                ]
    return sites


def files_of_messages() -> list[Path]:
    """Those of world/ that refuse messages."""
    return [file for file in sorted(Path(world.__path__[0]).rglob("*.py")) if file.name not in NOT_OF_MESSAGES]


def _refuses(node: ast.AST) -> bool:
    if isinstance(node, ast.Raise):
        return isinstance(node.exc, ast.Call) and getattr(node.exc.func, "id", "") in RAISED
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") in REFUSING


def counted(reached: Counter[tuple[str, int]]) -> dict[Site, int]:
    """How often each site was reached; `reached` by file and line."""
    return {
        site: sum(reached[site.file, line] for line in range(site.first_line, site.last_line + 1))
        for site in refusal_sites()
    }

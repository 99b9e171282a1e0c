"""Functions that can be called and read without a map: at most PARAMETERS parameters and LINES lines.

`self` and docstrings do not count. KERNELS names the kernels that exceed the limits, by reason; one that is no longer
too large must be removed.

    python -m lint.signatures
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
PLACES = ("fracture_collision", "test", "benchmarks", "campaigns", "lint", "bags", "examples", "launch")
PARAMETERS, LINES = 8, 60

# Why a kernel may exceed the limits, and the kernels: "file: function".
KERNELS: dict[str, frozenset[str]] = {
    "the coordinates of the corners of a triangle or a tetrahedron, or the ten moments of one": frozenset({
        "fracture_collision/core/mesh/closest_point.py: triangle_normal",
        "fracture_collision/core/mesh/moments.py: add_row",
    }),
    "one loop whose state is a dozen numbers that each iteration changes": frozenset({
        "fracture_collision/core/lookahead/first_touch.py: first_touch",
        "fracture_collision/core/search/sample_search.py: search_samples",
    }),
}


class Function(NamedTuple):
    """A function beyond a limit."""

    name: str  # "file: function"
    parameters: int
    lines: int


def functions(file: Path, name: str) -> Iterator[Function]:
    """All functions of a file; name: the file's, as it is to be printed."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        taken = [p.arg for p in node.args.posonlyargs + node.args.args + node.args.kwonlyargs]
        first = 1 if ast.get_docstring(node) is not None and len(node.body) > 1 else 0
        start = node.body[0].end_lineno + 1 if first else node.lineno
        yield Function(
            f"{name}: {node.name}", len(taken) - (taken[:1] in (["self"], ["cls"])), node.end_lineno - start + 1
        )


def problems(root: Path = ROOT) -> list[str]:
    """A line for each function beyond its limit, and for each kernel of KERNELS that no longer is."""
    excepted = frozenset[str]().union(*KERNELS.values())
    found, needed = [], set()
    for place in PLACES:
        for file in sorted((root / place).rglob("*.py")):
            for name, parameters, lines in functions(file, str(file.relative_to(root))):
                if parameters <= PARAMETERS and lines <= LINES:
                    continue
                needed.add(name)
                if name not in excepted:
                    found.append(f"{name}: {parameters} parameters, {lines} lines")
    return found + [f"{name}: small enough, remove it from KERNELS" for name in sorted(excepted - needed)]


if __name__ == "__main__":
    told = problems()
    print("\n".join(told) or "Signatures: kept")
    sys.exit(bool(told))

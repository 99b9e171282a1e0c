"""Folders that can be scanned and files that can be read in one go: limits.

A folder has at most FILES Python files, a file at most LINES lines.

    python -m lint.sizes
"""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
PLACES = ("fracture_collision", "test", "benchmarks", "campaigns", "lint", "bags", "examples", "launch")
FILES, LINES = 15, 350


def problems(root: Path = ROOT) -> list[str]:
    """A line for each folder or file beyond its limit."""
    found = []
    files = [file for place in PLACES for file in sorted((root / place).rglob("*.py"))]
    for folder in sorted({file.parent for file in files}):
        count = sum(file.parent == folder and file.stat().st_size > 0 for file in files)
        if count > FILES:
            found.append(f"{folder.relative_to(root)}: {count} files, more than {FILES}")
    for file in files:
        name, lines = str(file.relative_to(root)), len(file.read_text(encoding="utf-8").splitlines())
        if lines > LINES:
            found.append(f"{name}: {lines} lines, more than {LINES}")
    return found


if __name__ == "__main__":
    told = problems()
    print("\n".join(told) or "Sizes: kept")
    sys.exit(bool(told))

"""`make docs`: the pages and the API reference are built without a warning, and their links lead somewhere."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    (rule,) = re.findall(r"^docs:.*\n((?:\t.*\n)+)", (ROOT / "Makefile").read_text(), re.MULTILINE)
    assert "--fail-on-warning" in rule and "--conf-dir docs/site" in rule
    command = [
        sys.executable, "-m", "sphinx", "--builder", "html", "--conf-dir", "docs/site", "--doctree-dir",
        tmp_path / "doctrees", "--fail-on-warning", "--keep-going", "--quiet", ".", tmp_path / "site",
    ]  # fmt: skip
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    assert "README.html" in (tmp_path / "site" / "index.html").read_text()
    reference = (tmp_path / "site" / "docs" / "api.html").read_text()
    for name in ("CollisionWorld", "FractureEvent", "voronoi", "read_mesh", "penetration_tolerance"):
        assert f".{name}" in reference, name
    assert "Alias for field number" not in reference


@pytest.mark.parametrize("page", ["README.md", "docs/tutorial.md", "docs/api.md"])
def test_the_contents_have_the_page(page: str) -> None:
    contents = (ROOT / "docs" / "site" / "conf.py").read_text()
    assert page.removesuffix(".md") in contents

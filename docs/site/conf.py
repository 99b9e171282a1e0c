"""Sphinx's configuration of `make docs`: README, docs/ and an API reference, read from the root of the checkout."""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from fracture_collision import __version__  # noqa: E402

project = "fracture_collision"
author = copyright = "fracture_collision maintainers"
version = release = __version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.viewcode", "sphinx_copybutton"]
root_doc = "README"
include_patterns = [
    "README.md", "CONTRIBUTING.md", "CHANGELOG.md", "docs/*.md", "docs/decisions/*.md", "bags/README.md",
    "config/meshes/README.md",
]  # fmt: skip
suppress_warnings = ["myst.header"]  # headings of decision records begin at the second level
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]

html_theme = "furo"
html_title = f"fracture_collision {__version__}"
html_static_path: list[str] = []
html_show_copyright = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "undoc-members": False, "show-inheritance": False}
nitpicky = False


# The order of pages; README.md is the first, and stays readable without it.
CONTENTS = """

```{toctree}
:hidden:
:caption: Use it
docs/tutorial
docs/solvers
docs/scenes
docs/ros
docs/api
bags/README
docs/security
```

```{toctree}
:hidden:
:caption: Understand it
docs/paper
docs/numerics
docs/accuracy
docs/benchmarks
docs/reliability
docs/architecture
docs/decisions/README
```

```{toctree}
:hidden:
:caption: Work on it
CONTRIBUTING
CHANGELOG
config/meshes/README
```
"""
DECISIONS = """

```{toctree}
:hidden:
:glob:
0*
```
"""
START = '<meta http-equiv="refresh" content="0; url=README.html"><a href="README.html">fracture_collision</a>\n'


def _add_contents(_app, name: str, source: list[str]) -> None:
    source[0] += {"README": CONTENTS, "docs/decisions/README": DECISIONS}.get(name, "")


def _to_restructured_text(_app, _what, _name, _object, _options, lines: list[str]) -> None:
    """Docstrings are plain text with `code` in single backticks, which reStructuredText takes for roles.

    Entries of `Fields:` stand beside each field.
    """
    if "Fields:" in lines:
        del lines[lines.index("Fields:") :]
    lines[:] = [re.sub(r"(?<!`)`([^`]+)`(?!`)", r"``\1``", line).replace("*", r"\*") for line in lines]


def _write_start(app, _error) -> None:
    Path(app.outdir, "index.html").write_text(START)


def setup(app) -> None:
    """Called by Sphinx."""
    app.connect("source-read", _add_contents)
    app.connect("autodoc-process-docstring", _to_restructured_text)
    app.connect("build-finished", _write_start)

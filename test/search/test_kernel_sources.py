"""Cached machine code is used only if all that it was compiled from is unchanged, and numba itself is left alone."""

from __future__ import annotations

import ast
import shutil
from pathlib import Path

import pytest
from own_process import said

import fracture_collision
from fracture_collision import kernel_sources
from fracture_collision.kernel_sources import _imports, _source, source_digest, sources_of

PACKAGE = Path(fracture_collision.__file__).resolve().parent


def imported_by(tree: ast.AST) -> set[Path]:
    """Files of this package that a syntax tree imports from: the slow twin of the regular expression."""
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names += [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
    return {path for name in names if (path := _source(PACKAGE.parent, name)) is not None}


def test_every_import_is_found() -> None:
    files = sorted(PACKAGE.rglob("*.py"))
    assert len(files) > 100
    for file in files:
        assert _imports(file) == imported_by(ast.parse(file.read_text())), file


def test_an_installed_package_has_the_digests_of_its_checkout(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Numba and all others lie beside it there."""
    site = tmp_path / "site-packages"
    shutil.copytree(PACKAGE, site / "fracture_collision", ignore=shutil.ignore_patterns("__pycache__"))
    (site / "numba").mkdir()
    (site / "numba" / "__init__.py").write_text("")
    (site / "ast.py").write_text("")
    monkeypatch.setattr(kernel_sources, "PACKAGE", site / "fracture_collision")
    monkeypatch.setattr(kernel_sources, "INSTALLED", {site})
    kernels = Path("core", "pair", "narrow_phase.py")
    found = sources_of(site / "fracture_collision" / kernels)
    assert {path.relative_to(site) for path in found} == {
        path.relative_to(PACKAGE.parent) for path in sources_of(PACKAGE / kernels)
    }
    assert source_digest(site / "fracture_collision" / kernels) == source_digest(PACKAGE / kernels)


CALLER = """
from {kinds} import {kind}
from callee import part

@{kind}
def whole(x):
    return part(x) + 1.0
"""

CALLEE = """
from {kinds} import {kind}
import factors

@{kind}
def part(x):
    return factors.FACTOR * x
"""

CALL = """
import json
from caller import whole
value = whole(2.0)
print(json.dumps([value, sum(whole.stats.cache_hits.values())]))
"""


@pytest.mark.parametrize(
    ("kinds", "kind"),
    [
        ("fracture_collision.core.memory.compiled", "kernel"),
        ("fracture_collision.core.memory.compiled", "query_kernel"),
        ("fracture_collision.kernel_sources", "cached_njit"),
    ],
)
def test_an_edit_below_a_cached_kernel_compiles_it_again(kinds: str, kind: str, tmp_path: Path) -> None:
    """The edit is two files away from the kernel that Python calls."""
    (tmp_path / "caller.py").write_text(CALLER.format(kinds=kinds, kind=kind))
    (tmp_path / "callee.py").write_text(CALLEE.format(kinds=kinds, kind=kind))
    (tmp_path / "factors.py").write_text("FACTOR = 3.0\n")
    assert said(CALL, tmp_path) == [7.0, 0]
    assert said(CALL, tmp_path) == [7.0, 1]
    before = set(tmp_path.rglob("*.nb[ic]"))
    (tmp_path / "factors.py").write_text("FACTOR = 5.0\n")
    assert said(CALL, tmp_path) == [11.0, 0]
    after = set(tmp_path.rglob("*.nb[ic]"))
    assert after and not after & before, "files of the old digest are removed"


BESIDE_NUMBA = """
import json, sys
import numpy as np
import numba
from numba.core.registry import cpu_target
from numba.core.codegen import JITCodeLibrary
from fracture_collision.core.mesh.connected_pieces import joined
joined(np.array([0, 3]), np.array([2, 4]), 6)
print(json.dumps([cpu_target.target_context.codegen()._library_class is JITCodeLibrary, None in sys.modules.values()]))
"""


def test_numba_is_the_same_after_a_kernel_was_loaded(tmp_path: Path) -> None:
    assert said(BESIDE_NUMBA, tmp_path) == [True, False]


NEARER = "feature, source, where = e2,"  # where flood.py takes a squared distance

DEPTH = """
import json
import numpy as np
from fracture_collision.geometry.generators import brick
from fracture_collision.world import CollisionBody, CollisionWorld, FragmentStates, PaperSettings, Settings
mesh = brick((1.0, 1.0, 1.0), 0.5)
paper = PaperSettings(field="exact")
world = CollisionWorld(Settings(method="glondu2014", paper=paper))
for number in (1, 2):
    world.add_body(CollisionBody(number, number, vertices=mesh.vertices.ravel(), tetrahedra=mesh.tetrahedra.ravel()))
positions, turns = np.array([0.0, 0.0, 0.0, 0.03, 0.04, 0.98]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
print(json.dumps(world.contacts(FragmentStates(1, 0, np.array([1, 2]), positions, turns)).gaps.min()))
"""


@pytest.mark.slow
def test_an_edit_of_the_exact_field_changes_the_next_answer(tmp_path: Path) -> None:
    """A whole copy of the package with its compiled kernels, of which one line is edited by hand: some minutes."""
    shutil.copytree(PACKAGE, tmp_path / "fracture_collision")
    before = said(DEPTH, tmp_path)
    assert abs(before + 0.02) < 1e-12
    flood = tmp_path / "fracture_collision" / "core" / "field" / "flood.py"
    text = flood.read_text()
    assert text.count(NEARER) == 2
    flood.write_text(text.replace(NEARER, NEARER.replace("e2", "16.0 * e2")))
    assert said(DEPTH, tmp_path) != before

"""Cached kernels: loading them prepares no compilation, and any edit of what they were compiled from discards them."""

from __future__ import annotations

import ast
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

import fracture_collision
from fracture_collision import kernel_sources
from fracture_collision.kernel_sources import _imports, _source, source_digest, sources_of


def said(script: str, folder: Path | None = None) -> Any:
    """What a process prints; `folder`: it runs there, and imports from there first."""
    environment = dict(os.environ)
    if folder is not None:
        environment["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=folder, env=environment, capture_output=True, text=True, timeout=800
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


LOAD_THEN_COMPILE = """
import json, sys
import numpy as np
from numba.core.registry import cpu_target
from numba.core.codegen import JITCodeLibrary
from fracture_collision.core.mesh.connected_pieces import _joined, joined
from numba import njit

def for_compiling():
    return sorted({"numba.np.random.generator_methods"} & sys.modules.keys())

pieces = joined(np.array([0, 3]), np.array([2, 4]), 6).tolist()
told = {"pieces": pieces, "hits": sum(_joined.stats.cache_hits.values()), "imported for compiling": for_compiling()}
is_same = cpu_target.target_context.codegen()._library_class is JITCodeLibrary
told |= {"numba is the same": is_same, "modules without one": None in sys.modules.values()}

@njit
def pieces_of_a_ring(count):
    nodes = np.arange(count)
    return _joined(nodes, np.append(nodes[1:], 0), count).max() + 1

print(json.dumps(told | {"ring": int(pieces_of_a_ring(7)), "compiled": for_compiling() != []}))
"""

START = """
import json, sys
import fracture_collision.ros.service.collision_node
from fracture_collision.world import warm_up
announced = sorted({"numba", "scipy"} & sys.modules.keys())
warm_up.compile_kernels(lambda what: None)
print(json.dumps([announced, "numba" in sys.modules]))
"""


def test_cached_kernels_load_without_preparing_to_compile() -> None:
    said(LOAD_THEN_COMPILE)  # fills the cache if necessary
    assert said(LOAD_THEN_COMPILE) == {
        "pieces": [0, 1, 0, 2, 2, 3], "hits": 1, "imported for compiling": [], "ring": 1, "compiled": True,
        "numba is the same": True, "modules without one": False,
    }  # fmt: skip


def test_a_service_announces_itself_before_numba() -> None:
    assert said(START) == [[], True]


FROM_KERNELS = """
import json
import numpy as np
from fracture_collision.core.memory.callees import is_callee
from kernels_for_the_cache import outer, middle, inner, allocating
from numba import njit
first = outer(np.arange(6.0))
callees = [name.py_func.__name__ for name in (inner, allocating) if all(map(is_callee, name.overloads.values()))]
hits = sum(outer.stats.cache_hits.values())

@njit
def of_the_user(values):
    return middle(values, 3.0) + outer(values)

print(json.dumps([first, callees, hits, float(inner(np.arange(3.0), 2.0)), of_the_user(np.arange(6.0))]))
"""

KERNELS = """
import numpy as np
from fracture_collision.core.memory.compiled import kernel, query_kernel

@query_kernel
def twice(x):
    return 2.0 * x

@kernel
def allocating(values):
    return np.sort(np.concatenate((values, values[::-1] + 0.5)))[: len(values)].reshape(2, -1)

@kernel
def inner(values, x):
    if x < 0.0:
        raise ValueError("negative")
    total = 0.0
    for value in values:
        total += twice(value) * x
    return total

@query_kernel
def middle(values, x):
    return inner(values, x) + 1.0

@kernel
def outer(values):
    return middle(values, 1.0) + allocating(values)[1, 2]
"""


def test_callees_are_linked_into_what_python_calls(tmp_path: Path) -> None:
    """Compiled here, then loaded by another process, which has nothing else compiled that it might be linked with.

    A function of the user calls them, too.
    """
    (tmp_path / "kernels_for_the_cache.py").write_text(KERNELS)
    for hits, callees in ((0, ["inner", "allocating"]), (1, ["inner", "allocating"])):
        assert said(FROM_KERNELS, tmp_path) == [33.5, callees, hits, 12.0, 91.0 + 33.5]


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

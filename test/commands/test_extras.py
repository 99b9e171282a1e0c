"""What works with numpy and numba alone, and what the rest says that is missing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import llvmlite
import numba
import numpy as np
import pytest
from packaging.requirements import Requirement

from benchmarks.snippets import blocks
from fracture_collision.extras import EXTRAS, MissingExtra, need

ROOT = Path(__file__).resolve().parents[2]
@pytest.fixture(scope="module")
def library_alone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of modules that has nothing but the package, numpy and numba."""
    folder = tmp_path_factory.mktemp("modules")
    found = [ROOT / "fracture_collision"]
    for module in (np, numba, llvmlite):
        package = Path(module.__file__).parent
        found += [package, *package.parent.glob(f"{package.name}-*.dist-info"), *package.parent.glob("numpy.libs")]
    for each in dict.fromkeys(found):
        (folder / each.name).symlink_to(each)
    return folder


def run_with(folder: Path, code: str) -> subprocess.CompletedProcess[str]:
    """Runs code with the standard library and the modules in a folder, where it stands, too."""
    start = f"import sys; sys.path.append({str(folder)!r})\n"
    command = [sys.executable, "-I", "-S", "-c", start + code]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=600)


def test_the_library_needs_numpy_and_numba_alone(library_alone: Path) -> None:
    code, printed = (block.text for block in blocks(ROOT / "README.md"))
    done = run_with(library_alone, code)
    assert done.stdout == printed, done.stderr


@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("import fracture_collision.lockstep", "fracture_collision.simulation needs click, rich, pyyaml, scipy"),
        ("import fracture_collision.replay", "fracture_collision.bag needs mcap, lz4, zstandard, pyyaml"),
        ("import fracture_collision.viewer.film.film", "fracture_collision.viewer needs mcap"),
        (
            "from pathlib import Path; from fracture_collision.geometry import surface_files\n"
            "Path('part.stl').touch(); surface_files.read_surface(Path('part.stl'), 1.0)",
            "reading part.stl needs trimesh, scipy, meshio: `pip install '.[meshing]'`",
        ),
        (
            "from fracture_collision.cli import main; main(['scenes'])",
            "Error: the command line needs click, rich, pyyaml, scipy: `pip install '.[cli]'`",
        ),
    ],
)  # fmt: skip
def test_what_is_missing_is_named_with_its_extra(library_alone: Path, code: str, words: str) -> None:
    done = run_with(library_alone, code)
    assert done.returncode == 1 and words in done.stderr.splitlines()[-1]


def test_requirements_are_what_is_asked_for() -> None:
    for extra, modules in EXTRAS.items():
        assert set(modules.values()) == distributions_of(extra)


def distributions_of(extra: str) -> set[str]:
    found = set()
    for line in (ROOT / "requirements" / f"{extra}.in").read_text().splitlines():
        words = line.split("#")[0].strip()
        if words.startswith("-r "):
            found |= distributions_of(words.removeprefix("-r ").removesuffix(".in"))
        elif words:
            found.add(Requirement(words).name)
    return found


def test_the_error_is_that_of_a_missing_module(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EXTRAS, "cli", {"no_such_module": "no-such-distribution"})
    with pytest.raises(MissingExtra, match=r"a test needs no-such-distribution: `pip install '\.\[cli\]'`") as caught:
        need("cli", "a test")
    assert isinstance(caught.value, ModuleNotFoundError) and caught.value.name == "no-such-distribution"

"""Ties cached machine code to all source it was compiled from.

numba stamps the cached code of a function by the content of the function's own file, although the code contains all
that the function calls. Here the name of the cache's files has a digest of that file and of every file that it imports
from, directly or indirectly, and of the versions of this package and of numba. If any of these changes, the function is
compiled again. Files with another digest are removed when the new code is stored.
"""

from __future__ import annotations

import hashlib
import os
import re
import sysconfig
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import llvmlite
import numba
from numba import njit
from numba.core.caching import (
    CompileResultCacheImpl,
    FunctionCache,
    InTreeCacheLocator,
    UserProvidedCacheLocator,
    UserWideCacheLocator,
)

from fracture_collision import __version__

PACKAGE = Path(__file__).resolve().parent
INSTALLED = {Path(sysconfig.get_path(name)).resolve() for name in ("purelib", "platlib")}
VERSIONS = f"{__version__} {numba.__version__} {llvmlite.__version__}"
IMPORT = re.compile(
    r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+import[ \t]+(?:\(([^)]*)\)|([^\n#]*))|import[ \t]+([\w., \t]+))", re.MULTILINE
)


@cache
def source_digest(file: Path) -> str:
    """Hex digest of `file`, of what it imports, and of the versions of this package, numba and llvmlite."""
    digest = hashlib.sha256(VERSIONS.encode())
    for name, content in sorted((path.name, _content(path)) for path in sources_of(file)):
        digest.update(f"{name} {len(content)} ".encode() + content)
    return digest.hexdigest()[:16]


def sources_of(file: Path) -> set[Path]:
    """`file` and all files that it imports from, directly or indirectly: of this package, and of its own or beside it.

    Not of other installed packages: of numba, the version stands for the content.
    """
    found, left = {file}, [file]
    while left:
        new = _imports(left.pop()) - found
        found |= new
        left += new
    return found


@cache
def _content(file: Path) -> bytes:
    return file.read_bytes()


@cache
def _imports(file: Path) -> frozenset[Path]:
    own_root = _import_root(file.parent)
    installed = own_root in INSTALLED
    own_top = file.relative_to(own_root).parts[0].removesuffix(".py")
    names: list[str] = []
    for module, bracketed, listed, modules in IMPORT.findall(_content(file).decode()):
        imported = re.findall(r"\w+", re.sub("#.*", "", bracketed) or listed)
        names += [module, *(f"{module}.{name}" for name in imported), *re.split(r"[\s,]+", modules)]
    found = {_source(PACKAGE.parent, name) for name in names if name.partition(".")[0] == PACKAGE.name}
    found |= {_source(own_root, name) for name in names if not installed or name.partition(".")[0] == own_top}
    return frozenset(path for path in found if path is not None)


@cache
def _import_root(folder: Path) -> Path:
    """The folder from which a module in `folder` is imported."""
    return _import_root(folder.parent) if (folder / "__init__.py").exists() else folder


@cache
def _source(root: Path, module: str) -> Path | None:
    """The file of a module or package below `root`; None: there is none, as for a function in a module."""
    package, _, name = module.rpartition(".")
    if not name or (package and _source(root, package) is None):
        return None
    path = root.joinpath(*module.split("."))
    return next((file for file in (path.with_suffix(".py"), path / "__init__.py") if file.is_file()), None)


class _Digested:
    """A place of cache files (numba's locators) whose names have the digest of the sources."""

    _py_file: str
    _lineno: int

    def get_source_stamp(self) -> str:
        return source_digest(Path(self._py_file).resolve())

    def get_disambiguator(self) -> str:
        return f"{self._lineno}-{self.get_source_stamp()}"


class _UserProvided(_Digested, UserProvidedCacheLocator):
    pass


class _InTree(_Digested, InTreeCacheLocator):
    pass


class _UserWide(_Digested, UserWideCacheLocator):
    pass


class _Files(CompileResultCacheImpl):
    _locator_classes = [_UserProvided, _InTree, _UserWide]


class SourceCache(FunctionCache):
    """numba's cache of one function, in files named after the digest of its sources."""

    _impl_class = _Files

    def save_overload(self, sig: Any, data: Any) -> None:
        """As numba's; then removes the files of other digests."""
        super().save_overload(sig, data)
        digest = self._impl.locator.get_source_stamp()
        line_and_digest = self._impl.locator.get_disambiguator()
        function, python = self._impl.filename_base.split(line_and_digest)
        for path in Path(self.cache_path).glob(f"{function}*{python}.*"):
            if digest not in path.name:
                with suppress(OSError):  # another process was quicker
                    path.unlink()


def is_cached(dispatcher: Any) -> bool:
    """Whether the cache has code, for whatever types, of a function of `cached_njit`, made from the present sources."""
    cache = getattr(dispatcher, "_cache", None)  # None under NUMBA_DISABLE_JIT
    return cache is not None and any(Path(cache.cache_path).glob(f"{cache._impl.filename_base}.*.nbc"))


def can_be_cached(dispatcher: Any) -> bool:
    """Whether code of a function of `cached_njit` can be stored: it is compiled, and its cache can be written to."""
    cache = getattr(dispatcher, "_cache", None)
    if cache is None:
        return False
    folders = (Path(cache.cache_path), *Path(cache.cache_path).parents)
    return os.access(next(folder for folder in folders if folder.exists()), os.W_OK)


def cached_njit(function: Callable | None = None, **options: Any) -> Any:
    """Numba's njit, cached on disk until a source that the code was compiled from changes."""
    if function is None:
        return lambda decorated: cached_njit(decorated, **options)
    dispatcher = njit(function, **options)
    if dispatcher is not function:  # they are the same under NUMBA_DISABLE_JIT
        dispatcher._cache = SourceCache(function)  # what cache=True does with numba's own
    return dispatcher

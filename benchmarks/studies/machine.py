"""Environment of a measurement: the machine's name, the versions, the sources."""

from __future__ import annotations

import hashlib
import os
import platform
from importlib import metadata
from pathlib import Path

import fracture_collision

# Libraries that affect times and digits.
LIBRARIES = ("numpy", "numba", "scipy", "pybullet", "dask")


def machine() -> dict[str, str]:
    """The calling process's machine."""
    cores = len(os.sched_getaffinity(0))
    return {
        "cpu": f"{_cpu_name()}, {cores} core{'s' if cores != 1 else ''}",
        "system": f"{platform.system()} {platform.machine()}",
        **versions(),
    }


def versions() -> dict[str, str]:
    """Versions of Python, the libraries and the sources: two processes with equal versions compute the same."""
    libraries = ", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES)
    return {"versions": f"Python {platform.python_version()}, {libraries}", "sources": _digest_of_sources()}


def load_average() -> float:
    """Average number of runnable processes over the last minute."""
    return os.getloadavg()[0]


def _cpu_name() -> str:
    for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
        name, _, value = line.partition(":")
        if name.strip() == "model name":
            return value.strip()
    return platform.processor() or "unknown"


def _digest_of_sources() -> str:
    """Twelve digits of a SHA-256 over the package's and the studies' Python files, scenes and meshes."""
    root = Path(fracture_collision.__file__).resolve().parents[1]
    whole = hashlib.sha256()
    for folder, pattern in (("fracture_collision", "*.py"), ("benchmarks/studies", "*.py"), ("config", "*.*")):
        for file in sorted((root / folder).rglob(pattern)):
            whole.update(str(file.relative_to(root)).encode() + b"\0" + file.read_bytes())
    return whole.hexdigest()[:12]

"""What a measurement was made with: the machine's name, the versions, the sources."""

from __future__ import annotations

import hashlib
import os
import platform
from importlib import metadata
from pathlib import Path

import fracture_collision

# What decides about times and digits.
LIBRARIES = ("numpy", "numba", "scipy", "pybullet", "dask")


def machine() -> dict[str, str]:
    """Of the process that calls it."""
    cores = len(os.sched_getaffinity(0))
    return {
        "cpu": f"{_cpu_name()}, {cores} core{'s' if cores != 1 else ''}",
        "system": f"{platform.system()} {platform.machine()}",
        **versions(),
    }


def versions() -> dict[str, str]:
    """Of Python, the libraries and the sources: two processes where these are equal compute the same."""
    libraries = ", ".join(f"{name} {metadata.version(name)}" for name in LIBRARIES)
    return {"versions": f"Python {platform.python_version()}, {libraries}", "sources": _digest_of_sources()}


def load_average() -> float:
    """Processes that wanted a core, over the last minute."""
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

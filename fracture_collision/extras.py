"""The extras of the package, and the error that names the one that is missing.

The library (`world`, `core`, `fracture`, `geometry`) needs numpy and numba. Every other room asks here for what it
needs before it imports it: `pip install .` is small, and nobody has to guess a distribution's name.
"""

from __future__ import annotations

from importlib.util import find_spec

_BAGS = {"mcap": "mcap", "lz4": "lz4", "zstandard": "zstandard", "yaml": "pyyaml"}
# extra -> what it imports -> its distribution. requirements/<extra>.in has the versions.
EXTRAS = {
    "cli": {"click": "click", "rich": "rich", "yaml": "pyyaml", "scipy": "scipy"},
    "bags": _BAGS,
    "viewer": _BAGS | {
        "matplotlib": "matplotlib", "embreex": "embreex", "PIL": "pillow", "scipy": "scipy", "trimesh": "trimesh",
        "viser": "viser", "websockets": "websockets",
    },
    "meshing": {"trimesh": "trimesh", "scipy": "scipy", "meshio": "meshio"},
    "mujoco": {"mujoco": "mujoco-core"},
    "bullet": {"pybullet": "pybullet"},
}  # fmt: skip


class MissingExtra(ModuleNotFoundError):
    """A part of the package was imported without what it needs; the text says what to install."""


def missing_of(extra: str) -> list[str]:
    """Distributions of an extra that are not installed."""
    return [distribution for module, distribution in EXTRAS[extra].items() if find_spec(module) is None]


def need(extra: str, what: str) -> None:
    """Raise MissingExtra unless all of an extra is installed; `what` needs it."""
    if missing := missing_of(extra):
        raise MissingExtra(
            f"{what} needs {', '.join(missing)}: `pip install '.[{extra}]'` in a checkout", name=missing[0]
        )

"""All methods that can run in this environment."""

from __future__ import annotations

from importlib import import_module

from benchmarks.peers.method import Method

# The module of each family, and the libraries it measures, by distribution name.
FAMILIES = {
    "ours": ("numba",),
    "rapier": ("rapier3d",),
    "mujoco_shapes": ("mujoco", "vhacdx", "coacd"),
    "bullet": ("pybullet",),
    "fcl_shapes": ("python-fcl",),
    "coal_shapes": ("coal",),
    "newton_meshes": ("newton",),
    "vertex_distances": ("libigl",),
    "warp_distances": ("warp-lang",),
}


def all_methods(slow: bool = True) -> tuple[list[Method], dict[str, str]]:
    """Methods, the slow ones only if `slow`, and the reason for each family that cannot be imported."""
    found: list[Method] = []
    missing: dict[str, str] = {}
    for family in FAMILIES:
        try:
            found += import_module(f"benchmarks.peers.libraries.{family}").methods()
        except ImportError as error:
            missing[family] = str(error)
    return [m for m in found if slow or m.is_quick], missing

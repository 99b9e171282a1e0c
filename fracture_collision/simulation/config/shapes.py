"""Shapes of a scene's bodies, by kind: primitives, capsules as triangles, all others as tetrahedral meshes.

A kind's fields are the arguments of the function that makes its mesh, under the same names.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.geometry import generators, round_solids, sampled_bodies, stored_meshes
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.vase import vase
from fracture_collision.portable_math import lengths
from fracture_collision.simulation.config.scene_fields import Fields, SceneError, quoted

MESHES: dict[str, Callable[..., TetGeometry]] = {
    "ball": generators.ball,
    "shell": generators.shell,
    "brick": generators.brick,
    "plate": generators.plate,
    "bowl": generators.bowl,
    "torus": generators.torus,
    "l_block": generators.l_block,
    "sampled_ball": sampled_bodies.sampled_ball,
    "sampled_shell": sampled_bodies.sampled_shell,
    "bunny": stored_meshes.bunny,
    "piggy_bank": generators.piggy_bank,
    "stored_mesh": stored_meshes.stored_mesh,
    "vase": vase,
}
# Rigid.
SURFACES: dict[str, Callable[..., tuple[np.ndarray, np.ndarray]]] = {
    "cylinder": round_solids.cylinder,
    "cone": round_solids.cone,
    "capsule": round_solids.capsule,
}
MAKERS: dict[str, Callable[..., object]] = {**SURFACES, **MESHES}
# What the fields of shapes mean; checked by the functions that make the meshes.
WORDS = {
    "coefficients": "a, b, c, d [m]: solid where a x + b y + c z + d < 0; (a, b, c) of unit length",
    "radius": "[m]",
    "edge_length": "[m] of the tetrahedra, about",
    "outer_radius": "[m]",
    "inner_radius": "[m] of the hollow",
    "layers": "of tetrahedra through the wall; by default as many as edge_length gives, at least 2",
    "size_xyz": "[m] lengths of its edges",
    "diameter": "[m]",
    "thickness": "[m]",
    "rim_height": "[m] by which the rim rises, up to half the diameter",
    "depth": "[m] from the rim to the lowest point outside, up to half the diameter",
    "major_radius": "[m] of the ring",
    "minor_radius": "[m] of its tube",
    "notch_xy": "[m] lengths of the missing corner along x and y",
    "frequency": "each edge of an icosahedron is divided into so many: 20 frequency^2 triangles",
    "outer_frequency": "that of the outer surface, as of sampled_ball",
    "inner_frequency": "that of the inner surface",
    "interior_points": "nodes inside, about",
    "longest_side": "[m]",
    "length": "[m] from snout to tail",
    "wall": "[m] thickness of the wall",
    "file": "name of a .npz file beside the scene, with arrays vertices [m] and tetrahedra",
    "height": "[m]",
    "straight_length": "[m] between the centres of its two half balls",
}
ARGUMENTS = {
    "float": "number", "int": "whole number", "int | None": "whole number", "str": "text",
    "tuple[float, float, float]": "3 numbers", "tuple[float, float]": "2 numbers",
}  # fmt: skip
LIMITS = {
    "number": "more than 0", "whole number": "at least 1", "text": "", "3 numbers": "more than 0",
    "2 numbers": "more than 0", "rim_height": "at least 0", "inner_radius": "at least 0, less than outer_radius",
    "interior_points": "at least 0", "inner_frequency": "at least 0",
}  # fmt: skip
KINDS = ("plane", "box", "sphere", *SURFACES, *MESHES)
_PRIMITIVES = {"plane": "a half-space", "box": "a box about the origin", "sphere": "a sphere about the origin"}
# Each kind with the first sentence of what makes it.
SHAPES = _PRIMITIVES | {
    kind: (make.__doc__ or "").split("\n\n")[0].split(": vertices")[0] for kind, make in MAKERS.items()
}


class Shape(NamedTuple):
    """One of the kinds; the other fields are empty."""

    kind: str  # one of KINDS
    plane: tuple[float, ...] = ()  # a, b, c, d: solid where a x + b y + c z + d < 0
    size: tuple[float, ...] = ()  # [m] of a box its edge lengths, of one of SURFACES what makes it
    radius: float = 0.0  # of a sphere [m]
    mesh: TetGeometry | None = None  # of one of MESHES
    surface: tuple[np.ndarray, np.ndarray] | None = None  # of one of SURFACES: vertices (n, 3) [m], triangles (t, 3)

    def half_length(self) -> float:
        """R [m], as the service has it: half the longest side of the box about the body; inf for a plane."""
        if self.mesh is not None:
            return 0.5 * float(np.ptp(self.mesh.vertices, axis=0).max())
        if self.surface is not None:
            return 0.5 * float(np.ptp(self.surface[0], axis=0).max())
        return math.inf if self.kind == "plane" else max(0.5 * max(self.size, default=0.0), self.radius)


def parse_shape(fields: Fields, made: dict[tuple, TetGeometry], folder: Path | None = None) -> Shape:
    """The shape described by exactly one field, named by a kind; raises SceneError.

    `made` caches meshes, so that equal ones are shared. Files it names lie in `folder`.
    """
    kinds = fields.keys()
    if len(kinds) != 1 or kinds[0] not in KINDS:
        raise SceneError(f"{fields.name('')[:-1]}: needs just one of {', '.join(KINDS)}, got {quoted(kinds)}")
    kind = kinds[0]
    part = Fields(fields.mapping(kind, SHAPES[kind]), fields.name(kind))
    if kind == "plane":
        plane = part.vector("coefficients", WORDS["coefficients"], 4)
        if not math.isclose(float(lengths(plane[:3])), 1.0, abs_tol=1e-9):
            raise SceneError(f"{part.name('coefficients')}: the normal (a, b, c) is not of unit length")
        shape = Shape(kind, plane=tuple(map(float, plane)))
    elif kind == "box":
        size = part.vector("size", "[m] lengths of its edges", 3, above=0.0)
        shape = Shape(kind, size=tuple(map(float, size)))
    elif kind == "sphere":
        shape = Shape(kind, radius=part.number("radius", WORDS["radius"], above=0.0))
    elif kind in SURFACES:
        arguments = _arguments(SURFACES[kind], part)
        try:
            shape = Shape(kind, size=tuple(arguments.values()), surface=SURFACES[kind](**arguments))
        except (ValueError, TypeError) as error:
            raise SceneError(f"{part.name('')}{error}") from error
    else:
        shape = Shape(kind, mesh=_mesh(kind, part, made, folder))
    part.finish()
    return shape


def _mesh(kind: str, fields: Fields, made: dict[tuple, TetGeometry], folder: Path | None) -> TetGeometry:
    make = MESHES[kind]
    arguments = _arguments(make, fields)
    if kind == "stored_mesh" and isinstance(arguments["file"], str):
        arguments["file"] = str((folder or Path()) / arguments["file"])
    mesh = (kind, *arguments.values())
    try:
        if mesh not in made:
            made[mesh] = make(**arguments)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{fields.name('')}{error}") from error
    return made[mesh]


def _arguments(make: Callable[..., object], fields: Fields) -> dict[str, Any]:
    """The fields that `make` takes as arguments, by their names."""
    arguments: dict[str, Any] = {}
    for key, parameter in inspect.signature(make).parameters.items():
        default = ... if parameter.default is inspect.Parameter.empty else parameter.default
        kind_of_value = ARGUMENTS[str(parameter.annotation)]
        value = fields.take(key, WORDS[key], default, kind_of_value, LIMITS.get(key, LIMITS[kind_of_value]))
        arguments[key] = tuple(value) if isinstance(value, list) else value
    return arguments

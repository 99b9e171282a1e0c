"""Shapes of a scene's bodies, by kind: planes, boxes and spheres as primitives, all others as tetrahedral meshes.

A kind's fields are the arguments of the function that makes its mesh, under the same names.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fracture_collision.geometry import concave_shapes, generators, sampled_bodies, stored_meshes
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.geometry.piggy_bank import piggy_bank
from fracture_collision.geometry.vase import vase
from fracture_collision.portable_math import lengths
from fracture_collision.simulation.config.scene_fields import Fields, SceneError, quoted

MESHES: dict[str, Callable[..., TetGeometry]] = {
    "ball": generators.ball,
    "shell": generators.shell,
    "brick": generators.brick,
    "plate": generators.plate,
    "bowl": generators.bowl,
    "torus": concave_shapes.torus,
    "l_block": concave_shapes.l_block,
    "sampled_ball": sampled_bodies.sampled_ball,
    "sampled_shell": sampled_bodies.sampled_shell,
    "bunny": stored_meshes.bunny,
    "piggy_bank": piggy_bank,
    "stored_mesh": stored_meshes.stored_mesh,
    "vase": vase,
}
KINDS = ("plane", "box", "sphere", *MESHES)


class Shape(NamedTuple):
    """One of the kinds; the other fields are empty."""

    kind: str  # one of KINDS
    plane: tuple[float, ...] = ()  # a, b, c, d: solid where a x + b y + c z + d < 0
    size: tuple[float, ...] = ()  # of a box, edge lengths [m]
    radius: float = 0.0  # of a sphere [m]
    mesh: TetGeometry | None = None  # of one of MESHES


def parse_shape(fields: Fields, made: dict[tuple, TetGeometry], folder: Path | None = None) -> Shape:
    """The shape described by exactly one field, named by a kind; raises SceneError.

    `made` caches meshes, so that equal ones are shared. Files it names lie in `folder`.
    """
    kinds = fields.keys()
    if len(kinds) != 1 or kinds[0] not in KINDS:
        raise SceneError(f"{fields.name('')[:-1]}: needs just one of {', '.join(KINDS)}, got {quoted(kinds)}")
    kind = kinds[0]
    part = Fields(fields.mapping(kind), fields.name(kind))
    if kind == "plane":
        plane = part.vector("coefficients", 4)
        if not math.isclose(float(lengths(plane[:3])), 1.0, abs_tol=1e-9):
            raise SceneError(f"{part.name('coefficients')}: the normal (a, b, c) is not of unit length")
        shape = Shape(kind, plane=tuple(map(float, plane)))
    elif kind == "box":
        size = part.vector("size", 3)
        if np.any(size <= 0.0):
            raise SceneError(f"{part.name('size')}: needs positive lengths, got {size.tolist()}")
        shape = Shape(kind, size=tuple(map(float, size)))
    elif kind == "sphere":
        shape = Shape(kind, radius=part.number("radius", above=0.0))
    else:
        shape = Shape(kind, mesh=_mesh(kind, part, made, folder))
    part.finish()
    return shape


def _mesh(kind: str, fields: Fields, made: dict[tuple, TetGeometry], folder: Path | None) -> TetGeometry:
    make = MESHES[kind]
    arguments = {}
    for key, parameter in inspect.signature(make).parameters.items():
        default = ... if parameter.default is inspect.Parameter.empty else parameter.default
        value = fields.take(key, default)
        arguments[key] = tuple(value) if isinstance(value, list) else value
    if kind == "stored_mesh" and isinstance(arguments["file"], str):
        arguments["file"] = str((folder or Path()) / arguments["file"])
    mesh = (kind, *arguments.values())
    try:
        if mesh not in made:
            made[mesh] = make(**arguments)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{fields.name('')}{error}") from error
    return made[mesh]

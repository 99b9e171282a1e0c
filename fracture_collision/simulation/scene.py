"""Scenes: what stands where, of what, and what is thrown at it. YAML in, NamedTuples out.

config/scenes/plates.yaml shows every field with its unit. All errors are a SceneError that names the field.
"""

from __future__ import annotations

import inspect
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from fracture_collision.geometry import generators
from fracture_collision.share import share_directory
from fracture_collision.simulation.contact_solver import SolverSettings
from fracture_collision.simulation.fracture_pattern import PatternSettings

GENERATORS = ("ball", "shell", "brick", "plate", "bowl")


class SceneError(ValueError):
    """A scene file says something that cannot be; the text begins with the field's path."""


class Fracture(NamedTuple):
    """When and how a material breaks."""

    strength: float  # [N s] sum of the normal impulses of one step that a fragment bears
    minimum_mass: float  # [kg] lighter fragments do not break
    pattern: PatternSettings


class Material(NamedTuple):
    density: float  # [kg/m3]
    friction: float  # Coulomb coefficient
    restitution: float  # 0..1
    rolling_arm: float  # [m] rolling and spinning resistance: torque per normal force
    fracture: Fracture | None  # None: does not break


class Shape(NamedTuple):
    """One of the kinds; the other fields are empty."""

    kind: str  # "plane", "box", "sphere", or one of GENERATORS
    plane: tuple[float, ...] = ()  # a, b, c, d: solid where a x + b y + c z + d < 0
    size: tuple[float, ...] = ()  # of a box, edge lengths [m]
    radius: float = 0.0  # of a sphere [m]
    mesh: generators.TetGeometry | None = None


class SceneBody(NamedTuple):
    name: str
    shape: Shape
    material: Material
    is_static: bool
    position: np.ndarray  # (3,) [m], of the body frame in the world
    orientation: np.ndarray  # (4,) unit quaternion x y z w
    start_time: float  # [s] takes part from here on
    linear_velocity: np.ndarray  # (3,) [m/s] at its start
    angular_velocity: np.ndarray  # (3,) [rad/s], world axes


class Scene(NamedTuple):
    name: str
    seed: int
    gravity: np.ndarray  # (3,) [m/s2]
    time_step: float  # [s]
    duration: float  # [s]
    solver: SolverSettings
    bodies: tuple[SceneBody, ...]

    @property
    def step_count(self) -> int:
        return math.ceil(self.duration / self.time_step - 1e-9)


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of this file, or of this name among the scenes that come with the package."""
    path = _find(name_or_path)
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except yaml.YAMLError as error:
        raise SceneError(f"{path}: not YAML: {error}") from error
    return parse_scene(content, path.stem)


def parse_scene(content: Any, name: str) -> Scene:
    """The scene that `content`, as YAML gives it, describes; raises SceneError."""
    root = _Fields(content, "")
    materials = {
        str(key): _material(_Fields(value, f"materials.{key}")) for key, value in root.mapping("materials").items()
    }
    bodies = tuple(
        _body(_Fields(value, f"bodies[{i}]"), materials) for i, value in enumerate(root.sequence("bodies"))
    )
    names = [body.name for body in bodies]
    for body_name in names:
        if names.count(body_name) > 1:
            raise SceneError(f"bodies: the name {body_name!r} occurs {names.count(body_name)} times")
    scene = Scene(
        name=name,
        seed=root.integer("seed", minimum=0),
        gravity=root.vector("gravity", 3),
        time_step=root.number("time_step", above=0.0),
        duration=root.number("duration", above=0.0),
        solver=_settings(_Fields(root.mapping("solver", {}), "solver"), SolverSettings()),
        bodies=bodies,
    )
    root.finish()
    return scene


def _find(name_or_path: str | Path) -> Path:
    candidates = [Path(name_or_path), share_directory() / "config" / "scenes" / f"{name_or_path}.yaml"]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    raise SceneError(f"no scene {str(name_or_path)!r}: looked for {' and '.join(map(str, candidates))}")


class _Fields:
    """A mapping whose fields are taken out one by one; what is left at the end is a slip of the pen."""

    def __init__(self, content: Any, path: str) -> None:
        if not isinstance(content, Mapping):
            raise SceneError(f"{path or 'scene'}: needs fields, got {content!r}")
        self._left = dict(content)
        self._path = path

    def name(self, key: str) -> str:
        return f"{self._path}.{key}" if self._path else key

    def take(self, key: str, default: Any = ...) -> Any:
        if key in self._left:
            return self._left.pop(key)
        if default is ...:
            raise SceneError(f"{self.name(key)}: missing")
        return default

    def number(self, key: str, default: Any = ..., minimum: float = -math.inf, above: float = -math.inf) -> float:
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise SceneError(f"{self.name(key)}: needs a finite number, got {value!r}")
        if value < minimum or value <= above:
            limit = f"at least {minimum}" if value < minimum else f"more than {above}"
            raise SceneError(f"{self.name(key)}: needs {limit}, got {value}")
        return float(value)

    def integer(self, key: str, default: Any = ..., minimum: int = 0) -> int:
        value = self.take(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < minimum:
            raise SceneError(f"{self.name(key)}: needs a whole number of at least {minimum}, got {value!r}")
        return value

    def vector(self, key: str, size: int, default: Any = ...) -> np.ndarray:
        value = self.take(key, default)
        if not isinstance(value, list | tuple) or len(value) != size:
            raise SceneError(f"{self.name(key)}: needs {size} numbers, got {value!r}")
        parts = _Fields(dict(enumerate(value)), self.name(key))
        return np.array([parts.number(i) for i in range(size)])

    def mapping(self, key: str, default: Any = ...) -> Mapping:
        value = self.take(key, default)
        if not isinstance(value, Mapping):
            raise SceneError(f"{self.name(key)}: needs fields, got {value!r}")
        return value

    def sequence(self, key: str) -> list:
        value = self.take(key)
        if not isinstance(value, list) or not value:
            raise SceneError(f"{self.name(key)}: needs a list, got {value!r}")
        return value

    def keys(self) -> list[str]:
        return list(self._left)

    def finish(self) -> None:
        for key in self._left:
            raise SceneError(f"{self.name(str(key))}: unknown field")


def _settings(fields: _Fields, defaults: Any) -> Any:
    """A NamedTuple of numbers, none of them negative, from fields of the same names."""
    values = {
        key: fields.integer(key, default) if isinstance(default, int) else fields.number(key, default, minimum=0.0)
        for key, default in defaults._asdict().items()
    }
    fields.finish()
    return type(defaults)(**values)


def _material(fields: _Fields) -> Material:
    material = Material(
        density=fields.number("density", above=0.0),
        friction=fields.number("friction", minimum=0.0),
        restitution=fields.number("restitution", 0.0, minimum=0.0),
        rolling_arm=fields.number("rolling_arm", 0.0, minimum=0.0),
        fracture=None,
    )
    if material.restitution > 1.0:
        raise SceneError(f"{fields.name('restitution')}: needs at most 1, got {material.restitution}")
    breaks = fields.take("fracture", None)
    if breaks is not None:
        part = _Fields(breaks, fields.name("fracture"))
        fracture = Fracture(
            strength=part.number("strength", above=0.0),
            minimum_mass=part.number("minimum_mass", minimum=0.0),
            pattern=_settings(_Fields(part.mapping("pattern", {}), part.name("pattern")), PatternSettings()),
        )
        part.finish()
        material = material._replace(fracture=fracture)
    fields.finish()
    return material


def _body(fields: _Fields, materials: Mapping[str, Material]) -> SceneBody:
    material_name = str(fields.take("material"))
    if material_name not in materials:
        raise SceneError(f"{fields.name('material')}: {material_name!r} is none of {', '.join(materials)}")
    is_static = fields.take("static", False)
    if not isinstance(is_static, bool):
        raise SceneError(f"{fields.name('static')}: needs true or false, got {is_static!r}")
    body = SceneBody(
        name=str(fields.take("name")),
        shape=_shape(_Fields(fields.mapping("shape"), fields.name("shape"))),
        material=materials[material_name],
        is_static=is_static,
        position=fields.vector("position", 3, (0.0, 0.0, 0.0)),
        orientation=Rotation.from_euler("xyz", fields.vector("rotation", 3, (0.0, 0.0, 0.0)), degrees=True).as_quat(),
        start_time=fields.number("start_time", 0.0, minimum=0.0),
        linear_velocity=fields.vector("linear_velocity", 3, (0.0, 0.0, 0.0)),
        angular_velocity=fields.vector("angular_velocity", 3, (0.0, 0.0, 0.0)),
    )
    if body.shape.kind == "plane" and not body.is_static:
        raise SceneError(f"{fields.name('static')}: a plane cannot move")
    if body.is_static and (body.start_time or np.any(body.linear_velocity) or np.any(body.angular_velocity)):
        raise SceneError(f"{fields.name('static')}: a static body has no start time and no velocity")
    fields.finish()
    return body


def _shape(fields: _Fields) -> Shape:
    kinds = fields.keys()
    known = ("plane", "box", "sphere", *GENERATORS)
    if len(kinds) != 1 or kinds[0] not in known:
        raise SceneError(f"{fields.name('')[:-1]}: needs just one of {', '.join(known)}, got {kinds}")
    kind = kinds[0]
    part = _Fields(fields.mapping(kind), fields.name(kind))
    if kind == "plane":
        plane = part.vector("coefficients", 4)
        if not math.isclose(float(np.linalg.norm(plane[:3])), 1.0, abs_tol=1e-9):
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
        shape = Shape(kind, mesh=_generated(kind, part))
    part.finish()
    return shape


def _generated(kind: str, fields: _Fields) -> generators.TetGeometry:
    generator = getattr(generators, kind)
    arguments = {}
    for key, parameter in inspect.signature(generator).parameters.items():
        default = ... if parameter.default is inspect.Parameter.empty else parameter.default
        value = fields.take(key, default)
        arguments[key] = tuple(value) if isinstance(value, list) else value
    try:
        return generator(**arguments)
    except (ValueError, TypeError) as error:
        raise SceneError(f"{fields.name('')}{error}") from error

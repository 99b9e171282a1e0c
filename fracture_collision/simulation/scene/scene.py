"""Scenes: bodies, their places and materials, and what is thrown at them. YAML in, NamedTuples out.

In config/scenes plates.yaml shows the fields with their units, bunnies.yaml a hand, reference_sphere.yaml variants.
Every error is a SceneError that names the field.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.fracture.pattern import PatternSettings
from fracture_collision.geometry.generators import TetGeometry
from fracture_collision.near_names import did_you_mean
from fracture_collision.records import BOX, CONE, CYLINDER, SPHERE, CollisionBody, SolidPrimitive, documented
from fracture_collision.share import share_directory
from fracture_collision.simulation.actors.hand import Hand, parse_hand
from fracture_collision.simulation.actors.robot import RobotPlan, parse_robot
from fracture_collision.simulation.config.scene_fields import ROTATION, Fields, SceneError, quoted, read_yaml
from fracture_collision.simulation.config.shapes import Shape, parse_shape
from fracture_collision.simulation.rotations import DEGREE, from_euler_angles
from fracture_collision.simulation.solver.contact_solver import SolverSettings

MAX_STEPS = 1_000_000_000
# What solves contacts and moves bodies, see simulation/dynamics.py.
OWN, MUJOCO = ENGINES = "own", "mujoco"
EARTH = (0.0, 0.0, -9.81)  # [m/s2] gravity, unless a scene has its own
# What longer descriptions of fields say.
VARIANTS = "scenes derived from this one, by name: fields that replace those above, bodies by their names"
SOLVER = "settings of the contact solver; equations in simulation/solver/contact_solver.py"


@documented
class Fracture(NamedTuple):
    """When and how a material breaks.

    Fields:
      strength: [N s] sum of the normal impulses that a fragment bears in a step
      minimum_mass: [kg] lighter fragments do not break
      pattern: of the cracks: Voronoi cells around the impact
    """

    strength: float
    minimum_mass: float
    pattern: PatternSettings


@documented
class Material(NamedTuple):
    """What a body consists of.

    Fields:
      density: [kg/m3]
      friction: Coulomb coefficient; a pair has the geometric mean
      restitution: 0: no bounce, 1: no loss; a pair has the larger one
      rolling_arm: [m] rolling and spinning resistance, torque per normal force; a pair has the larger one
      fracture: when and how it breaks; without it, it does not
    """

    density: float
    friction: float
    restitution: float = 0.0
    rolling_arm: float = 0.0
    fracture: Fracture | None = None


class SceneBody(NamedTuple):
    """A body of a scene, at its start."""

    name: str
    shape: Shape
    material: Material
    is_static: bool
    position: np.ndarray  # (3,) [m], of the body frame in the world
    orientation: np.ndarray  # (4,) unit quaternion x y z w
    start_time: float  # [s] when it enters the scene
    linear_velocity: np.ndarray  # (3,) [m/s] at its start
    angular_velocity: np.ndarray  # (3,) [rad/s], world axes

    def __deepcopy__(self, _memo: dict[int, Any]) -> SceneBody:
        """Itself: nothing changes it, and its mesh may be large."""
        return self


class Model(NamedTuple):
    """A MuJoCo model in a scene, with the engine mujoco."""

    file: Path  # MJCF
    links: tuple[str, ...]  # the scene's bodies that are its geoms


class Scene(NamedTuple):
    """A scene: its bodies, and all settings of the simulation."""

    name: str
    seed: int
    gravity: np.ndarray  # (3,) [m/s2]
    time_step: float  # [s]
    duration: float  # [s]
    solver: SolverSettings
    bodies: tuple[SceneBody, ...]
    hand: Hand | None = None  # that drags bodies
    engine: str = OWN  # of ENGINES
    model: Model | None = None
    robot: RobotPlan | None = None  # its collision shapes are among the bodies, under the names of its `shapes`

    @property
    def step_count(self) -> int:
        """Number of steps that cover `duration`."""
        return math.ceil(self.duration / self.time_step - 1e-9)

    def __deepcopy__(self, _memo: dict[int, Any]) -> Scene:
        """Itself: nothing changes it."""
        return self


class SceneFile(NamedTuple):
    """A scene file of the package."""

    path: Path
    title: str  # its first line
    variants: tuple[str, ...]


def scene_files() -> list[SceneFile]:
    """The scenes of the package, by name."""
    files = sorted((share_directory() / "config" / "scenes").glob("*.yaml"))
    return [
        SceneFile(
            file, file.read_text(encoding="utf-8").splitlines()[0].lstrip("# "), tuple(_variants(read_yaml(file)))
        )
        for file in files
    ]


def scene_names() -> list[str]:
    """Names that load_scene accepts without a path: the package's scenes, each with its variants."""
    return [
        name for file in scene_files()
        for name in (file.path.stem, *(f"{file.path.stem}:{variant}" for variant in file.variants))
    ]  # fmt: skip


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of this file, or of this name among the package's scenes.

    NAME:VARIANT is the scene with the changes that its field `variants` lists for this variant.
    """
    path, variant = _find(str(name_or_path))
    return parse_scene(read_yaml(path), path.stem, variant, path.parent)


def parse_scene(content: Any, name: str, variant: str = "", folder: Path | None = None) -> Scene:
    """The scene described by `content`, parsed YAML; raises SceneError. Files it names lie in `folder`."""
    if variant:
        known = _variants(content)
        if variant not in known:
            raise SceneError(f"{name}: has no variant {variant!r}; there are {', '.join(known) or 'none'}")
        content, name = _merged(content, known[variant], "variants." + variant), f"{name}:{variant}"
    root = Fields(content, "")
    root.mapping("variants", VARIANTS, {})
    materials = {
        str(key): _material(Fields(value, f"materials.{key}"))
        for key, value in root.mapping("materials", "materials by name").items()
    }
    made: dict[tuple, TetGeometry] = {}
    bodies = tuple(
        _body(Fields(value, f"bodies[{i}]"), materials, made, folder)
        for i, value in enumerate(root.sequence("bodies", "all bodies"))
    )
    dragged = [body.name for body in bodies if not body.is_static]
    machines, more = _machines(root, materials, folder)
    bodies += more
    names = [body.name for body in bodies]
    for body_name in names:
        if names.count(body_name) > 1:
            raise SceneError(f"bodies: the name {quoted(body_name)} occurs {names.count(body_name)} times")
    hand = root.take("hand", "a hand that takes hold of bodies and drags them", None, "fields")
    if hand is not None:
        hand = parse_hand(Fields(hand, "hand"), folder, dragged)
    scene = Scene(
        name=name,
        seed=root.integer("seed", "of the fracture patterns: another seed, other cracks", 1),
        gravity=root.vector("gravity", "[m/s2]", 3, EARTH),
        time_step=root.number("time_step", "[s] of the simulation", above=0.0),
        duration=root.number("duration", "[s] of the run", above=0.0),
        solver=root.settings("solver", SOLVER, SolverSettings),
        bodies=bodies,
        hand=hand,
        **machines,
    )
    root.finish()
    if scene.duration > MAX_STEPS * scene.time_step:
        raise SceneError(f"duration: {scene.duration} s are more than {MAX_STEPS} steps of {scene.time_step} s")
    return scene


def _machines(
    root: Fields, materials: Mapping[str, Material], folder: Path | None
) -> tuple[dict[str, Any], tuple[SceneBody, ...]]:
    """The scene's fields `robot`, `engine` and `model`, and the bodies that these bring."""
    found: dict[str, Any] = {"robot": None, "model": None}
    bodies: tuple[SceneBody, ...] = ()
    robot = root.take("robot", "a robot from a URDF file, moved by PyBullet", None, "fields")
    if robot is not None:
        fields = Fields(robot, "robot")
        material, found["robot"] = _material_of(fields, materials), parse_robot(fields, folder)
        bodies += _robot_bodies(found["robot"], material)
    found["engine"] = known_engine(root.text("engine", f"what solves contacts: {' or '.join(ENGINES)}", OWN))
    model = root.take("model", "a MuJoCo model that stands in the scene; needs engine: mujoco", None, "fields")
    if model is not None:
        if found["engine"] != MUJOCO:
            raise SceneError(f"model: needs engine: {MUJOCO}")
        fields = Fields(model, "model")
        file, links = _model_bodies(fields, _material_of(fields, materials), folder)
        found["model"], bodies = Model(file, tuple(body.name for body in links)), bodies + links
    return found, bodies


def known_engine(name: str) -> str:
    """The name, if it is one of ENGINES; raises SceneError."""
    if name not in ENGINES:
        raise SceneError(f"engine: {quoted(name)} is none of {', '.join(ENGINES)}{did_you_mean(name, ENGINES)}")
    return name


def _find(name: str) -> tuple[Path, str]:
    """The file of a scene, and the variant named."""
    folder = share_directory() / "config" / "scenes"
    stem, _, variant = name.partition(":")
    candidates = [(Path(name), ""), (folder / f"{name}.yaml", "")]
    if variant:
        candidates += [(Path(stem), variant), (folder / f"{stem}.yaml", variant)]
    for path, wanted in candidates:
        if path.is_file():
            return path, wanted
    if Path(name).suffix or len(Path(name).parts) > 1:
        raise SceneError(f"{name}: no such file")
    known = [file.path.stem for file in scene_files()]
    raise SceneError(f"no scene {name!r}{did_you_mean(stem, known) or ';'} `fracture-collision scenes` lists all")


def _variants(content: Any) -> Mapping[str, Any]:
    return Fields(content, "").mapping("variants", VARIANTS, {})


def _merged(content: Any, change: Any, path: str) -> Any:
    """`content` with the fields of `change` in place of its own; in a list, `change` selects bodies by name."""
    if isinstance(content, Mapping) and isinstance(change, Mapping):
        return {**content, **{key: _merged(content.get(key), new, f"{path}.{key}") for key, new in change.items()}}
    if isinstance(content, list) and isinstance(change, Mapping):
        places = {item.get("name"): i for i, item in enumerate(content) if isinstance(item, Mapping)}
        changed = list(content)
        for name, value in change.items():
            if name not in places:
                raise SceneError(f"{path}: no body {quoted(name)}")
            changed[places[name]] = _merged(content[places[name]], value, f"{path}.{name}")
        return changed
    return change


def _material(fields: Fields) -> Material:
    material = Material(**fields.numbers(Material, above=("density",), shares=("restitution",)))
    breaks = fields.take("fracture", Material.fracture.__doc__ or "", None, "fields")
    if breaks is not None:
        part = Fields(breaks, fields.name("fracture"))
        values = part.numbers(Fracture, above=("strength",))
        pattern = part.settings("pattern", Fracture.pattern.__doc__ or "", PatternSettings)
        part.finish()
        material = material._replace(fracture=Fracture(**values, pattern=pattern))
    fields.finish()
    return material


def _material_of(fields: Fields, materials: Mapping[str, Material]) -> Material:
    name = fields.text("material", "name of its material")
    if name not in materials:
        raise SceneError(f"{fields.name('material')}: {quoted(name)} is none of {', '.join(materials)}")
    return materials[name]


def _model_bodies(
    fields: Fields, material: Material, folder: Path | None
) -> tuple[Path, tuple[SceneBody, ...]]:  # fmt: skip
    """The file of a MuJoCo model, and its geoms that collide as bodies."""
    from fracture_collision.simulation.mujoco_model import links_of  # late: of an extra

    file = (folder or Path()) / fields.text("file", "name of its MJCF file beside the scene")
    fields.finish()
    still, material = np.zeros(3), material._replace(fracture=None)
    return file, tuple(
        SceneBody(link.name, link.shape, material, True, link.position, link.orientation, 0.0, still, still)
        for link in links_of(file)
    )


def _robot_bodies(robot: RobotPlan, material: Material) -> tuple[SceneBody, ...]:
    """The robot's collision shapes as bodies, at the start."""
    return tuple(
        SceneBody(
            part.body, part.shape, material._replace(fracture=None), part.is_static, position, orientation, 0.0,
            np.zeros(3), np.zeros(3),
        )
        for part, (position, orientation) in zip(robot.shapes, robot.start_frames(), strict=True)
    )  # fmt: skip


def _body(
    fields: Fields, materials: Mapping[str, Material], made: dict[tuple, TetGeometry], folder: Path | None
) -> SceneBody:
    material = _material_of(fields, materials)
    is_static = fields.take("static", "whether it cannot move", False, "true or false")
    if not isinstance(is_static, bool):
        raise SceneError(f"{fields.name('static')}: needs true or false, got {quoted(is_static)}")
    shape = fields.mapping("shape", "one of the shapes below, by its name")
    body = SceneBody(
        name=fields.text("name", "of the body; each once"),
        shape=parse_shape(Fields(shape, fields.name("shape")), made, folder),
        material=material,
        is_static=is_static,
        position=fields.vector("position", "[m] of the body frame, in the world", 3, (0.0, 0.0, 0.0)),
        orientation=from_euler_angles(DEGREE * fields.vector("rotation", f"[degrees] {ROTATION}", 3, (0.0, 0.0, 0.0))),
        start_time=fields.number("start_time", "[s] when it enters the scene", 0.0, minimum=0.0),
        linear_velocity=fields.vector("linear_velocity", "[m/s] at its start", 3, (0.0, 0.0, 0.0)),
        angular_velocity=fields.vector("angular_velocity", "[rad/s] at its start, world axes", 3, (0.0, 0.0, 0.0)),
    )
    if body.shape.kind == "plane" and not body.is_static:
        raise SceneError(f"{fields.name('static')}: a plane cannot move")
    if body.is_static and (body.start_time or np.any(body.linear_velocity) or np.any(body.angular_velocity)):
        raise SceneError(f"{fields.name('static')}: a static body has no start time and no velocity")
    fields.finish()
    return body


PRIMITIVES = {"box": BOX, "cylinder": CYLINDER, "cone": CONE}  # with their sizes as dimensions


def collision_body(body_id: int, body: SceneBody) -> CollisionBody:
    """`body` as CollisionBody; its one fragment has the same number as the body."""
    shape, material = body.shape, body.material
    record = CollisionBody(
        body_id=body_id,
        fragment_id=body_id,
        name=body.name,
        is_static=body.is_static,
        density=material.density,
        friction=material.friction,
        restitution=material.restitution,
    )
    if shape.kind == "plane":
        return record._replace(plane=np.array(shape.plane))
    if shape.kind == "sphere":
        return record._replace(primitive=SolidPrimitive(SPHERE, (shape.radius,)))
    if shape.kind in PRIMITIVES:
        return record._replace(primitive=SolidPrimitive(PRIMITIVES[shape.kind], shape.size))
    if shape.surface is not None:
        vertices, triangles = shape.surface
        return record._replace(vertices=vertices, triangles=triangles)
    assert shape.mesh is not None  # as in every shape of another kind
    return record._replace(vertices=shape.mesh.vertices, tetrahedra=shape.mesh.tetrahedra.astype(np.uint32))

"""A MuJoCo model (MJCF) in a scene: its bodies with joints, actuators and sensors, as MujocoDynamics simulates them.

The geoms that may collide become bodies of the service, one each. Those that move are static there, too, which spares
the search of their pairs with each other and with what stands, but the states have their poses in each step.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.extras import need

need("mujoco", "a scene with a MuJoCo model")

import mujoco  # noqa: E402

from fracture_collision.geometry.round_solids import capsule, cylinder  # noqa: E402
from fracture_collision.simulation.config.scene_fields import SceneError  # noqa: E402
from fracture_collision.simulation.config.shapes import Shape  # noqa: E402

_GEOM = mujoco.mjtGeom


class Link(NamedTuple):
    """A geom that may collide, at the start."""

    name: str
    shape: Shape
    position: np.ndarray  # (3,) [m] in the world
    orientation: np.ndarray  # (4,) quaternion x y z w
    moves: bool


def read_spec(file: Path) -> mujoco.MjSpec:
    """The model of an MJCF file, whose own collisions are off; raises SceneError."""
    try:
        spec = mujoco.MjSpec.from_file(str(file))
        spec.compile()
    except (ValueError, OSError) as error:
        raise SceneError(f"model.file: MuJoCo cannot read {file}: {error}") from error
    return spec


def links_of(file: Path) -> list[Link]:
    """The geoms of an MJCF file that may collide; raises SceneError for one of a shape that the service has not."""
    model = read_spec(file).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return [
        Link(
            name_of(model, k), _shape_of(model, k), data.geom_xpos[k].copy(), quaternion_of(data.geom_xmat[k]),
            bool(model.body_weldid[model.geom_bodyid[k]]),
        )
        for k in colliding(model)
    ]  # fmt: skip


def colliding(model: mujoco.MjModel) -> list[int]:
    """The geoms of a model that may collide."""
    return np.flatnonzero((model.geom_contype != 0) | (model.geom_conaffinity != 0)).tolist()


def name_of(model: mujoco.MjModel, geom: int) -> str:
    """Name of a geom as a body of the scene: BODY/GEOM, by their numbers where they have no names."""
    body = model.geom_bodyid[geom]
    return f"{model.body(body).name or body}/{model.geom(geom).name or geom}"


def quaternion_of(matrix: np.ndarray) -> np.ndarray:
    """The quaternion x y z w of a rotation matrix (9,)."""
    quaternion = np.empty(4)
    mujoco.mju_mat2Quat(quaternion, matrix)
    return quaternion[[1, 2, 3, 0]]


def _shape_of(model: mujoco.MjModel, geom: int) -> Shape:
    kind, size = model.geom_type[geom], [float(x) for x in model.geom_size[geom]]
    if kind == _GEOM.mjGEOM_PLANE:
        return Shape("plane", plane=(0.0, 0.0, 1.0, 0.0))
    if kind == _GEOM.mjGEOM_SPHERE:
        return Shape("sphere", radius=size[0])
    if kind == _GEOM.mjGEOM_BOX:
        return Shape("box", size=(2.0 * size[0], 2.0 * size[1], 2.0 * size[2]))
    if kind == _GEOM.mjGEOM_CYLINDER:
        return Shape("cylinder", size=(2.0 * size[1], size[0]), surface=cylinder(2.0 * size[1], size[0]))
    if kind == _GEOM.mjGEOM_CAPSULE:
        return Shape("capsule", size=(2.0 * size[1], size[0]), surface=capsule(2.0 * size[1], size[0]))
    if kind == _GEOM.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first, count = model.mesh_vertadr[mesh], model.mesh_vertnum[mesh]
        return Shape("hull", surface=_hull(model.mesh_vert[first : first + count].astype(np.float64)))
    raise SceneError(
        f"model.file: geom {name_of(model, geom)} is a {_GEOM(kind).name.removeprefix('mjGEOM_').lower()}; planes,"
        " spheres, boxes, cylinders, capsules and meshes collide"
    )


def _hull(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The convex hull of points (n, 3): vertices (m, 3), triangles (t, 3) seen counter-clockwise from outside."""
    from scipy.spatial import ConvexHull  # late: half a second

    hull = ConvexHull(points)
    vertices, triangles = points[hull.vertices], np.searchsorted(hull.vertices, hull.simplices)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    inwards = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    triangles[inwards] = triangles[inwards][:, [0, 2, 1]]
    return vertices, triangles.astype(np.uint32)


def state_of(data: mujoco.MjData, dofs: int, positions: int) -> dict[str, Any]:
    """The first `positions` of qpos, `dofs` of qvel, and what actuators and time have, to be put back."""
    return {
        "qpos": data.qpos[:positions].copy(), "qvel": data.qvel[:dofs].copy(), "act": data.act.copy(),
        "ctrl": data.ctrl.copy(), "time": data.time, "qacc_warmstart": data.qacc_warmstart[:dofs].copy(),
    }  # fmt: skip


def put_state(data: mujoco.MjData, state: dict[str, Any]) -> None:
    """Put back a state_of."""
    for name, value in state.items():
        if name == "time":
            data.time = value
        else:
            getattr(data, name)[: len(value)] = value

"""Elementary scenes in MuJoCo, with its own collision detection.

Its defaults, but for these:
 - contacts are stiffer: a time constant of two steps, the least that it takes, instead of 20 ms, and impedances of 0.95
   to 0.99 instead of 0.9 to 0.95. With its defaults what falls sinks in by centimetres;
 - every pair of bodies has its own coefficients: the geometric mean of frictions, as ours; MuJoCo would take the larger
   one. Pairs without friction have contacts with no tangents (condim 1), those with a rolling arm also torques (6);
 - elliptic friction cones with impratio 10, against slip, and implicitfast;
 - it has no restitution: pairs that bounce have a spring instead (negative solref), of BOUNCE_STEPS steps a bounce, and
   damped so that an impact keeps its share of the speed;
 - bodies have the masses of our service; the width of impedances and the tolerance of collisions, lengths, are scaled
   with the scene.
Of the settings tried these make the most scenes right at 2.5 ms. Others: time constants of 10 and 20 ms, impedances as
usual and of 0.99 to 0.999, RK4 (it alone makes the free spin right), Euler, pyramidal cones with impratio 1, iterations
against slip, bounces of 4 and 16 steps.

Boxes, spheres and planes are primitives, other bodies convex hulls or several of them, with several contacts a pair
(multiccd, on by default).
"""

from __future__ import annotations

import itertools
import math

import mujoco
import numpy as np

from benchmarks.elementary.peer import Motion, Solid, parts_of, solids_of, traced
from benchmarks.elementary.scenes import Trace, turned_back
from fracture_collision.simulation.rotations import rotation_matrices
from fracture_collision.simulation.scene.scene import Material, Scene, SceneBody

DAMPING = 1.0  # ratio, MuJoCo's default
IMPEDANCE = 0.95, 0.99, 0.001, 0.5, 2.0  # solimp, its last three as MuJoCo's; the third is a width [m], at scale 1
FRICTION_IMPEDANCE = 10.0
BOUNCE_STEPS = 8


def run(scene: Scene, scale: float = 1.0, turn: float = 0.0) -> Trace:
    """Run a scene to its end; `turn` [degrees] as in Setting."""
    solids = solids_of(scene)
    return turned_back(traced(Mujoco(scene, solids, scale), solids, scene, scale), turn)


class Mujoco:
    """An `Engine`."""

    def __init__(self, scene: Scene, solids: dict[str, Solid], scale: float) -> None:
        spec = mujoco.MjSpec()
        option = spec.option
        option.timestep, option.gravity = scene.time_step, scene.gravity
        option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, FRICTION_IMPEDANCE
        option.ccd_tolerance *= scale
        # Otherwise it starts anew, without a word, from what is not finite.
        option.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
        geoms = {body.name: _add(spec, body, solids.get(body.name)) for body in scene.bodies}
        for a, b in itertools.combinations(scene.bodies, 2):
            if not (a.is_static and b.is_static):
                for names in itertools.product(geoms[a.name], geoms[b.name]):
                    _add_pair(spec, names, (a.material, b.material), scene.time_step, scale)
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        for solid, velocity in zip(solids.values(), self._data.qvel.reshape(-1, 6), strict=True):
            turn = rotation_matrices(solid.body.orientation[None])[0]
            velocity[:3], velocity[3:] = solid.linear, turn.T @ solid.body.angular_velocity

    def step(self) -> None:
        mujoco.mj_step(self._model, self._data)

    def motion(self) -> Motion:
        """Free joints have angular velocities in body axes."""
        places, speeds = self._data.qpos.reshape(-1, 7).copy(), self._data.qvel.reshape(-1, 6).copy()
        turns = places[:, [4, 5, 6, 3]]
        return Motion(
            places[:, :3], turns, speeds[:, :3], np.einsum("nij,nj->ni", rotation_matrices(turns), speeds[:, 3:])
        )

    def deepest(self) -> float:
        return float(np.min(self._data.contact.dist, initial=0.0))


def _add(spec: mujoco.MjSpec, body: SceneBody, solid: Solid | None) -> list[str]:
    """Adds a body; returns the names of its geoms."""
    added = spec.worldbody.add_body()
    x, y, z, w = body.orientation
    added.pos, added.quat = body.position if solid is None else solid.center, [w, x, y, z]
    if solid is not None:
        added.add_freejoint()
        added.explicitinertial, added.mass, added.ipos = True, solid.mass, np.zeros(3)
        added.fullinertia = solid.inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    if body.shape.mesh is not None:
        return [
            _add_hull(spec, added, f"{body.name}.{k}", part)
            for k, part in enumerate(parts_of(body, np.zeros(3) if solid is None else solid.arm))
        ]
    geom = added.add_geom()
    geom.name = body.name
    geom.contype = geom.conaffinity = 0  # only the pairs below
    if body.shape.kind == "plane":
        *normal, offset = body.shape.plane
        geom.type = mujoco.mjtGeom.mjGEOM_PLANE
        geom.size = [0.0, 0.0, 1.0]  # infinite; the third is the grid spacing used for drawing
        geom.pos, geom.alt.zaxis = -offset * np.array(normal), normal
    elif body.shape.kind == "box":
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, 0.5 * np.array(body.shape.size)
    else:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [body.shape.radius, 0.0, 0.0]
    return [geom.name]


def _add_hull(spec: mujoco.MjSpec, added: mujoco.MjsBody, name: str, points: np.ndarray) -> str:
    mesh = spec.add_mesh()
    mesh.name, mesh.uservert = name, points.ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
    geom = added.add_geom()
    geom.type, geom.name, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, name, name
    geom.contype = geom.conaffinity = 0
    return name


def _add_pair(
    spec: mujoco.MjSpec, geoms: tuple[str, str], materials: tuple[Material, Material], time_step: float, scale: float
) -> None:
    a, b = materials
    friction, arm = math.sqrt(a.friction * b.friction), max(a.rolling_arm, b.rolling_arm)
    low, high, width, middle, power = IMPEDANCE
    pair = spec.add_pair()
    pair.geomname1, pair.geomname2 = geoms
    pair.condim = 1 if friction == 0.0 else 3 if arm == 0.0 else 6
    pair.friction = [friction, friction, arm, arm, arm]
    pair.solref = _reference(max(a.restitution, b.restitution), time_step)
    pair.solimp = [low, high, scale * width, middle, power]


def _reference(restitution: float, time_step: float) -> list[float]:
    """The solref of a pair: time constant [s] and damping ratio, or minus stiffness [1/s2] and minus damping [1/s]."""
    if restitution == 0.0:
        return [2.0 * time_step, DAMPING]
    frequency = math.pi / (BOUNCE_STEPS * time_step)
    loss = -math.log(restitution)
    ratio = loss / math.hypot(math.pi, loss)
    return [-frequency * frequency, -2.0 * ratio * frequency]

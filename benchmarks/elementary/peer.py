"""What the elementary scenes need of another engine, and how a run of it is recorded."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from typing import NamedTuple, Protocol

import coacd
import numpy as np
from scipy.spatial import ConvexHull

from benchmarks.elementary.scenes import Trace
from fracture_collision.geometry.tetrahedra import boundary_triangles, tetrahedron_volumes
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.rotations import rotation_matrices
from fracture_collision.simulation.scene.scene import Scene, SceneBody
from fracture_collision.world import Settings

QUIET = 0.01  # [R/s], [rad/s] at scale 1: bodies slower than this for the scene's sleep time count as asleep
CONVEX = 0.999  # share of their hull that convex bodies fill
CONCAVITY = 0.01  # CoACD's threshold, at its least; with its default, 0.05, a bowl's surface is off by 9 mm


class Solid(NamedTuple):
    """A movable body at its start; its frame has the axes of the scene's body, and the centre of mass as origin."""

    body: SceneBody
    mass: float  # [kg]
    arm: np.ndarray  # (3,) [m] centre of mass in the frame of the scene's body
    inertia: np.ndarray  # (3, 3) [kg m2], body axes
    center: np.ndarray  # (3,) [m] centre of mass, in the world
    linear: np.ndarray  # (3,) [m/s] of the centre of mass


class Motion(NamedTuple):
    """The n movable bodies at one time, in the scene's order."""

    centers: np.ndarray  # (n, 3) [m] centres of mass
    orientations: np.ndarray  # (n, 4) unit quaternions x y z w
    linear: np.ndarray  # (n, 3) [m/s]
    angular: np.ndarray  # (n, 3) [rad/s], world axes


class Engine(Protocol):
    """A scene in another engine."""

    def step(self) -> None: ...

    def motion(self) -> Motion: ...

    def deepest(self) -> float:
        """Least gap [m] of the contacts of the last step; 0 if none is negative."""


def solids_of(scene: Scene) -> dict[str, Solid]:
    """The movable bodies by name, with the masses that our service gives them. ValueError for unknown features."""
    if scene.hand or scene.robot or any(body.start_time or body.material.fracture for body in scene.bodies):
        raise ValueError(f"{scene.name}: hands, robots, late bodies and fracture are not known to other engines here")
    with Lockstep(scene, Settings(threads=1)) as running:
        registry = running.world.fragments()
    rows = {number: row for row, number in enumerate(registry.fragment_ids.tolist())}
    solids = {}
    for number, body in enumerate(scene.bodies, start=1):
        if body.is_static:
            continue
        row = rows[number]
        xx, xy, xz, yy, yz, zz = registry.inertias[row]
        arm = registry.centers_of_mass[row]
        turned = rotation_matrices(body.orientation[None])[0] @ arm
        solids[body.name] = Solid(
            body, float(registry.masses[row]), arm, np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]),
            body.position + turned, body.linear_velocity + np.cross(body.angular_velocity, turned),
        )  # fmt: skip
    return solids


def is_convex(body: SceneBody) -> bool:
    """Whether the hull of a body's mesh is the body."""
    assert body.shape.mesh is not None
    vertices, tetrahedra = body.shape.mesh
    return bool(tetrahedron_volumes(vertices, tetrahedra).sum() > CONVEX * ConvexHull(vertices).volume)


def parts_of(body: SceneBody, arm: np.ndarray) -> list[np.ndarray]:
    """Vertices (n, 3) [m] of convex parts of a body's mesh, from the point `arm` (3,) [m] of its frame.

    A convex body is one part; others are decomposed, as users of engines with hulls do.
    """
    assert body.shape.mesh is not None
    vertices, tetrahedra = body.shape.mesh
    if is_convex(body):
        return [vertices[np.unique(tetrahedra)] - arm]
    size = body.shape.half_length()
    of_one_size = np.round(vertices / size, 9)  # the same at all scales
    parts = _decomposed(of_one_size.tobytes(), boundary_triangles(tetrahedra).astype(np.int32).tobytes())
    return [size * part - arm for part in parts]


@functools.cache
def _decomposed(vertices: bytes, triangles: bytes) -> list[np.ndarray]:
    """CoACD's parts of a surface, as exact as it makes them: a minute for a bowl."""
    coacd.set_log_level("error")
    surface = np.frombuffer(vertices).reshape(-1, 3), np.frombuffer(triangles, np.int32).reshape(-1, 3)
    parts = coacd.run_coacd(coacd.Mesh(*surface), threshold=CONCAVITY)
    return [np.asarray(points, float) for points, _ in parts]


def traced(engine: Engine, solids: Mapping[str, Solid], scene: Scene, scale: float) -> Trace:
    """The scene's course in this engine. FloatingPointError where states are not finite any more."""
    root = math.sqrt(scale)
    masses = np.array([solid.mass for solid in solids.values()])
    inertias = np.array([solid.inertia for solid in solids.values()])
    rows, moving = [], []
    for step in range(scene.step_count):
        engine.step()
        now = engine.motion()
        if not all(np.isfinite(column).all() for column in now):
            raise FloatingPointError(f"not finite after {step + 1} steps")
        spins = np.einsum("nji,nj->ni", rotation_matrices(now.orientations), now.angular)  # body axes
        kinetic = 0.5 * (masses @ (now.linear**2).sum(axis=1) + np.einsum("ni,nij,nj->", spins, inertias, spins))
        potential = -float(masses @ (now.centers @ scene.gravity))
        moving.append((now.linear / root, now.angular * root))
        rows.append((now.centers / scale, kinetic, kinetic + potential, engine.deepest() / scale))
    places, kinetics, energies, depths = map(np.array, zip(*rows, strict=True))
    linear, angular = map(np.array, zip(*moving, strict=True))
    sizes = np.array([solid.body.shape.half_length() for solid in solids.values()]) / scale
    last = slice(-math.ceil(scene.solver.sleep_time / scene.time_step), None)
    is_slow = np.linalg.norm(linear[last], axis=2) < QUIET * sizes
    is_slow &= np.linalg.norm(angular[last], axis=2) < QUIET
    kinetics /= max(kinetics[0], 1e-300)
    return Trace(places, linear, angular, kinetics, energies, depths, is_slow.all(axis=0))

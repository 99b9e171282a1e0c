"""Elementary scenes in Rapier, with its own collision detection.

Its defaults, but for these:
 - friction of a pair is the geometric mean and restitution the larger one, as ours; bodies have the masses of our
   service, continuous collision detection and gyroscopic forces;
 - 8 iterations a step instead of 4, and contact springs stiffer by the share that the step is of 1/60 s, for which its
   frequencies are meant: heaps sink less;
 - contacts are not recycled: recycled ones keep old gaps, and a small sphere loses its energy at seams;
 - a plane is the upper side of a large cuboid: hulls of many vertices sink into its half-spaces;
 - its length unit is the scene's scale; sleep and least substep, which it does not derive from that, are scaled alike.
Of the settings tried these make the most scenes right at 2.5 ms. Others: its usual springs, twice these, 4, 16 and 32
iterations, a length unit of 0.1, a smaller allowed error, its more accurate friction model, no sleep, contact skins.

Boxes and spheres are primitives, other bodies convex hulls or compounds of them; concave ones that are static are
triangle meshes.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import rapier3d
from scipy.spatial.transform import Rotation

from benchmarks.elementary.peer import Motion, Solid, is_convex, parts_of, solids_of, traced
from benchmarks.elementary.scenes import Trace, turned_back
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.simulation.scene.scene import Scene, SceneBody

USUAL_STEP = 1.0 / 60.0  # [s], for which the defaults are meant
ITERATIONS = 8
GROUND = 5.0  # [m] half the edge of the cuboid that stands for a plane, at scale 1


def run(scene: Scene, scale: float = 1.0, turn: float = 0.0) -> Trace:
    """Run a scene to its end; `turn` [degrees] as in Setting."""
    solids = solids_of(scene)
    return turned_back(traced(Rapier(scene, solids, scale), solids, scene, scale), turn)


class Rapier:
    """An `Engine`."""

    def __init__(self, scene: Scene, solids: dict[str, Solid], scale: float) -> None:
        self._world = rapier3d.PhysicsWorld(gravity=tuple(scene.gravity.tolist()))
        self._world.auto_update_query = False
        self._world.set_num_threads(1)
        _set(self._world.integration_parameters, scene.time_step, scale)
        self._bodies = []
        for body in scene.bodies:
            solid = solids.get(body.name)
            handle = self._world.add_body(
                _fixed(body) if solid is None else _dynamic(solid),
                colliders=_colliders(body, np.zeros(3) if solid is None else solid.arm, scale),
            )
            if solid is not None:
                self._bodies.append(self._world.rigid_bodies[handle])
                _set_sleep(self._bodies[-1], scale)

    def step(self) -> None:
        self._world.step()
        if self._world.quarantine.bodies:
            raise FloatingPointError("rapier takes out bodies whose states are not finite")

    def motion(self) -> Motion:
        rows = [(_numbers(b.translation), _numbers(b.linvel), _numbers(b.angvel)) for b in self._bodies]
        centers, linear, angular = map(np.array, zip(*rows, strict=True))
        turns = np.array([[b.rotation.i, b.rotation.j, b.rotation.k, b.rotation.w] for b in self._bodies])
        return Motion(centers, turns / np.linalg.norm(turns, axis=1)[:, None], linear, angular)

    def deepest(self) -> float:
        return min(
            (
                point.dist
                for pair in self._world.narrow_phase.contact_pairs()
                for manifold in pair.manifolds
                for point in manifold.points
                if point.dist < 0.0
            ),
            default=0.0,
        )


def _numbers(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _set(parameters: rapier3d.IntegrationParameters, time_step: float, scale: float) -> None:
    """Lengths of the parameters are in units of `length_unit`, but times in s."""
    root = math.sqrt(scale)
    parameters.dt, parameters.length_unit = time_step, scale
    parameters.contact_recycling, parameters.num_solver_iterations = False, ITERATIONS
    parameters.min_ccd_dt *= root
    parameters.normalized_max_corrective_velocity /= root
    parameters.normalized_max_linear_velocity /= root
    for name in ("contact_softness", "static_contact_softness"):
        spring = getattr(parameters, name)
        frequency = spring.natural_frequency * USUAL_STEP / time_step
        setattr(parameters, name, rapier3d.SpringCoefficients(frequency, spring.damping_ratio))


def _set_sleep(body: rapier3d.RigidBody, scale: float) -> None:
    """The linear limit is in length units a second."""
    root, limits = math.sqrt(scale), body.activation
    limits.linear_threshold /= root
    limits.angular_threshold /= root
    limits.time_until_sleep *= root
    body.activation = limits


def _fixed(body: SceneBody) -> rapier3d.RigidBodyBuilder:
    return rapier3d.RigidBody.fixed().position(_pose(body.position, body.orientation))


def _dynamic(solid: Solid) -> rapier3d.RigidBodyBuilder:
    principal, axes = np.linalg.eigh(solid.inertia)
    axes[:, 2] *= np.linalg.det(axes)  # no mirror
    frame = _turn(Rotation.from_matrix(axes).as_quat())
    properties = rapier3d.MassProperties((0.0, 0.0, 0.0), solid.mass, tuple(principal.tolist()), frame)
    return (
        rapier3d.RigidBody.dynamic()
        .position(_pose(solid.center, solid.body.orientation))
        .linvel(tuple(solid.linear.tolist()))
        .angvel(tuple(solid.body.angular_velocity.tolist()))
        .additional_mass_properties(properties)
        .ccd_enabled(True)
        .gyroscopic_forces(True)
    )


def _pose(position: np.ndarray, orientation: np.ndarray) -> rapier3d.Isometry3:
    return rapier3d.Isometry3(tuple(position.tolist()), _turn(orientation))


def _turn(quaternion: np.ndarray) -> rapier3d.Rotation3:
    x, y, z, w = quaternion.tolist()
    return rapier3d.Rotation3.from_quaternion(w, x, y, z)


def _colliders(body: SceneBody, arm: np.ndarray, scale: float) -> list[Any]:
    material = body.material
    return [
        collider.density(0.0)  # the body has its mass
        .friction(material.friction)
        .friction_combine_rule(rapier3d.CoefficientCombineRule.GEOMETRIC_MEAN)
        .restitution(material.restitution)
        .restitution_combine_rule(rapier3d.CoefficientCombineRule.MAX)
        for collider in _shapes(body, arm, scale)
    ]


def _shapes(body: SceneBody, arm: np.ndarray, scale: float) -> list[Any]:
    shape = body.shape
    if shape.kind == "plane":
        return [_ground(np.array(shape.plane[:3]), shape.plane[3], GROUND * scale)]
    if shape.kind == "box":
        return [rapier3d.Collider.cuboid(*(0.5 * side for side in shape.size))]
    if shape.kind == "sphere":
        return [rapier3d.Collider.ball(shape.radius)]
    if body.is_static and not is_convex(body):
        assert shape.mesh is not None
        triangles = boundary_triangles(shape.mesh.tetrahedra).astype(np.uint32)
        flags = rapier3d.TriMeshFlags.FIX_INTERNAL_EDGES
        return [rapier3d.Collider.trimesh(shape.mesh.vertices.astype(np.float32), triangles, flags=flags)]
    return [_hull(points.astype(np.float32)) for points in parts_of(body, arm)]


def _ground(up: np.ndarray, offset: float, half: float) -> rapier3d.ColliderBuilder:
    """A cube of edge 2 `half` [m] whose upper side lies in the plane up . x + offset = 0."""
    turn, _ = Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])
    return rapier3d.Collider.cuboid(half, half, half).position(_pose(-(offset + half) * up, turn.as_quat()))


def _hull(points: np.ndarray) -> rapier3d.ColliderBuilder:
    try:
        return rapier3d.Collider.convex_hull(points)
    except rapier3d.MeshConversionError:  # parry fails on one hull in a hundred; reordering the points helps
        return rapier3d.Collider.convex_hull(np.ascontiguousarray(points[::-1]))

"""MuJoCo's collision step over the states of a scene: convex hulls for fragments; boxes, balls, planes as they are."""

from __future__ import annotations

from time import perf_counter

import mujoco
import numpy as np

from benchmarks.frames.peer import Peer, Shape, is_fixed, normal_and_point, points_of, radius_of, shape_of
from benchmarks.peers.libraries.mujoco_shapes import MEMORY, listed_contacts
from benchmarks.peers.method import Contacts
from benchmarks.peers.worlds import Frame
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld, Settings


class MujocoHulls(Peer):
    """A compiled model cannot be extended, so it is recompiled whenever the set of fragments changes.

    Its margins make it list gaps as wide as ours does: without them it takes a quarter less time on scenes at rest,
    where bodies rest slightly apart.
    """

    last_registry_only, lists_contacts = True, True

    def __init__(self) -> None:
        super().__init__()
        self._ids: list[int] = []
        self._model = self._data = None
        self._joints: dict[int, int] = {}  # free joints, by fragment
        self._frames: dict[int, int] = {}  # poses of static bodies (MuJoCo's mocap bodies), by fragment

    def follow(self, world: CollisionWorld, ids: list[int]) -> float:
        if ids == self._ids:
            return 0.0
        points, margins = {i: points_of(world, i) for i in ids}, self._margins(world)
        started = perf_counter()
        spec = mujoco.MjSpec()
        spec.memory = MEMORY
        self._ids, self._joints, self._frames = ids, {}, {}
        for i in ids:
            whole = self._whole.get(i)
            body = spec.worldbody.add_body()
            if is_fixed(whole):
                body.mocap = True
                self._frames[i] = len(self._frames)
            else:
                body.add_freejoint()
                self._joints[i] = len(self._joints)
            geom = body.add_geom()
            geom.margin = margins[i]
            _shape(spec, geom, i, whole, points[i])
        self._model = spec.compile()
        self._data = mujoco.MjData(self._model)
        return perf_counter() - started

    def step(self, states: FragmentStates) -> float:
        """Time [s] of mj_kinematics and mj_collision on the calling thread.

        Writing the body poses is not included; computing the world poses of hulls is, as our step and rapier's compute
        those too. mj_collision reads nothing that mj_comPos writes, so mj_comPos is left out.
        """
        positions, turns = states.positions.reshape(-1, 3), states.orientations.reshape(-1, 4)[:, [3, 0, 1, 2]]
        joints = self._data.qpos.reshape(-1, 7)
        for i, position, turn in zip(states.fragment_ids.tolist(), positions, turns, strict=True):
            k = self._joints.get(i)
            if k is None:
                k = self._frames[i]
                self._data.mocap_pos[k], self._data.mocap_quat[k] = position, turn
            else:
                joints[k, :3], joints[k, 3:] = position, turn
        started = perf_counter()
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_collision(self._model, self._data)
        return perf_counter() - started

    def contacts(self, ids: np.ndarray, frame: Frame) -> Contacts:
        # bodies were added in ascending order of id, after the world
        numbers = np.searchsorted(ids, [0, *self._ids])
        return listed_contacts(self._model, self._data, numbers)

    def _margins(self, world: CollisionWorld) -> dict[int, float]:
        """Margin [m] by fragment.

        MuJoCo adds the two margins of a pair; ours lists gaps up to `detection_tolerance` times the smaller R of a
        pair, so static bodies get the largest margin of the moving ones.
        """
        half = 0.5 * Settings().detection_tolerance
        of_bodies = {whole.body_id: half * radius_of(whole) for whole in self._whole.values() if not whole.is_static}
        largest = max(of_bodies.values(), default=0.0)
        registry = world.fragments()
        pairs = zip(registry.fragment_ids.tolist(), registry.body_ids.tolist(), strict=True)
        return {fragment: of_bodies.get(body, largest) for fragment, body in pairs}


def _shape(spec, geom, fragment_id: int, whole: CollisionBody | None, points: np.ndarray) -> None:
    match shape_of(whole):
        case Shape.BOX:
            geom.type = mujoco.mjtGeom.mjGEOM_BOX
            geom.size = [0.5 * side for side in whole.primitive.dimensions]
        case Shape.BALL:
            geom.type = mujoco.mjtGeom.mjGEOM_SPHERE
            geom.size = [whole.primitive.dimensions[0], 0.0, 0.0]
        case Shape.PLANE:
            normal, at = normal_and_point(whole)
            geom.type = mujoco.mjtGeom.mjGEOM_PLANE
            geom.size = [0.0, 0.0, 1.0]  # infinite; the third is the grid spacing used for drawing
            geom.pos, geom.alt.zaxis = at, normal
        case Shape.SURFACE:
            raise ValueError(f"{whole.name}: MuJoCo would collide with the hull of this surface")
        case Shape.HULL:
            mesh = spec.add_mesh()
            mesh.name = str(fragment_id)
            mesh.uservert = np.asarray(points, float).ravel()
            mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            geom.type, geom.meshname = mujoco.mjtGeom.mjGEOM_MESH, mesh.name

"""MuJoCo: hulls, decompositions into hulls (V-HACD, CoACD), signed distances in octrees."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

import mujoco
import numpy as np

from benchmarks.peers.method import Contacts, Method, about_middle, no_contacts
from benchmarks.peers.worlds import Frame, Surface, World

MEMORY = 512 << 20  # [bytes] of MuJoCo's arena: contacts of decompositions need more than its default
HULLS, VOXELS = 8, 20_000  # per fragment in V-HACD; its defaults, 64 and 400,000, take seven times as long
CONCAVITY = 0.2  # CoACD's threshold; its default, 0.05, takes three times as long

Parts = Callable[[Surface], list[Surface]]


class _State(NamedTuple):
    model: mujoco.MjModel
    data: mujoco.MjData


class MuJoCo(Method):
    def __init__(self, name: str, is_quick: bool, parts: Parts | None = None, distances: bool = False) -> None:
        self.name, self.is_quick = name, is_quick
        self._parts, self._distances = parts or (lambda surface: [surface]), distances

    def update(self, world: World, before) -> _State:
        spec = mujoco.MjSpec()
        spec.memory = MEMORY
        for i, fragment in enumerate(world.fragments):
            body = spec.worldbody.add_body()
            body.pos = fragment.centre
            body.add_freejoint()
            for k, part in enumerate(self._parts(fragment.mesh)):
                mesh = spec.add_mesh()
                mesh.name = f"{i}.{k}"
                mesh.uservert, mesh.userface = part.vertices.ravel(), part.triangles.ravel().astype(np.int32)
                mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
                mesh.needsdf = self._distances
                geom = body.add_geom()
                geom.type = mujoco.mjtGeom.mjGEOM_SDF if self._distances else mujoco.mjtGeom.mjGEOM_MESH
                geom.meshname = mesh.name
        model = spec.compile()
        return _State(model, mujoco.MjData(model))

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        model, data = state
        # the compiler moves geoms to their own centre and records that in the model: poses are those of bodies
        data.qpos[:] = np.hstack([frame.positions, frame.quaternions[:, [3, 0, 1, 2]]]).ravel()
        started = perf_counter()
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        native = perf_counter() - started
        return listed_contacts(model, data, np.arange(-1, len(world.fragments)), native)


def listed_contacts(
    model: mujoco.MjModel, data: mujoco.MjData, numbers: np.ndarray, native: float = np.nan
) -> Contacts:  # fmt: skip
    """`numbers`: fragments by MuJoCo body; the first body is the world."""
    if not data.ncon:
        return no_contacts(native)
    contact = data.contact
    fragments = numbers[model.geom_bodyid[contact.geom]]
    return about_middle(
        fragments[:, 0], fragments[:, 1], contact.pos.copy(), contact.frame[:, :3].copy(), -contact.dist, native
    )  # fmt: skip


def v_hacd(surface: Surface) -> list[Surface]:
    import vhacdx

    parts = vhacdx.compute_vhacd(
        surface.vertices, surface.triangles.astype(np.uint32), maxConvexHulls=HULLS, resolution=VOXELS, asyncACD=False
    )  # fmt: skip
    return [Surface(np.asarray(v, float), np.asarray(t).reshape(-1, 3)) for v, t in parts]


def co_acd(surface: Surface) -> list[Surface]:
    import coacd

    coacd.set_log_level("error")
    parts = coacd.run_coacd(coacd.Mesh(surface.vertices, surface.triangles), threshold=CONCAVITY)
    return [Surface(np.asarray(v, float), np.asarray(t).reshape(-1, 3)) for v, t in parts]


def methods() -> list[Method]:
    return [
        MuJoCo("mujoco hull", True),
        MuJoCo("mujoco v-hacd", False, v_hacd),
        MuJoCo("mujoco coacd", False, co_acd),
        MuJoCo("mujoco sdf", False, distances=True),
    ]

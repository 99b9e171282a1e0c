"""Exact distances at vertices by Warp's mesh queries on the CPU, the sign from fast winding numbers."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np
import warp

from benchmarks.peers.boxes import Vertices, all_vertices, candidates
from benchmarks.peers.method import Contacts, Method, contacts_of
from benchmarks.peers.worlds import Frame, World

FAR = 0.5  # [m] deeper than any vertex

warp.config.log_level = warp.LOG_ERROR  # no banner among the tables, no warning about the missing GPU
warp.init()


@warp.kernel
def _ask(
    meshes: warp.array(dtype=warp.uint64),
    other: warp.array(dtype=warp.int32),
    points: warp.array(dtype=warp.vec3),
    far: warp.float32,
    depths: warp.array(dtype=warp.float32),
    closest: warp.array(dtype=warp.vec3),
):
    i = warp.tid()
    mesh = meshes[other[i]]
    found = warp.mesh_query_point_sign_winding_number(mesh, points[i], far)
    depths[i] = -1.0
    if found.result and found.sign < 0.0:
        closest[i] = warp.mesh_eval_position(mesh, found.face, found.u, found.v)
        depths[i] = warp.length(closest[i] - points[i])


class _State(NamedTuple):
    vertices: Vertices
    meshes: list
    ids: warp.array


def _array(values: np.ndarray, dtype) -> warp.array:
    return warp.array(values, dtype=dtype, device="cpu")


class Warp(Method):
    name = "exact vertices (warp)"

    def update(self, world: World, before) -> _State:
        surfaces = [f.mesh for f in world.fragments]
        meshes = [
            warp.Mesh(
                _array(s.vertices.astype(np.float32), warp.vec3),
                _array(s.triangles.ravel().astype(np.int32), warp.int32),
                support_winding_number=True,
            )
            for s in surfaces
        ]
        ids = _array(np.array([m.id for m in meshes]), warp.uint64)
        return _State(all_vertices([s.vertices for s in surfaces]), meshes, ids)

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        near = candidates(state.vertices, frame)
        started = perf_counter()
        depths = warp.empty(len(near.own), dtype=warp.float32, device="cpu")
        closest = warp.empty(len(near.own), dtype=warp.vec3, device="cpu")
        other = _array(near.other.astype(np.int32), warp.int32)
        points = _array(near.local.astype(np.float32), warp.vec3)
        warp.launch(_ask, len(near.own), [state.ids, other, points, FAR, depths, closest], device="cpu")
        depths, closest = depths.numpy(), closest.numpy()
        native = perf_counter() - started
        inside = depths > 0.0
        own, other, points = near.own[inside], near.other[inside], near.world[inside]
        exits = np.einsum("nij,nj->ni", frame.rotations[other], closest[inside]) + frame.positions[other]
        depths = depths[inside].astype(np.float64)
        return contacts_of(own, other, points, exits, (points - exits) / depths[:, None], depths, native)


def methods() -> list[Method]:
    return [Warp()]

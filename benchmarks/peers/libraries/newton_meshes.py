"""Newton's collision pipeline on the CPU: triangle meshes."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import newton
import numpy as np
import warp

from benchmarks.peers.method import Contacts, Method, contacts_of, no_contacts
from benchmarks.peers.worlds import Frame, World

MOST_CONTACTS = 200_000  # per frame


class _State(NamedTuple):
    pipeline: newton.CollisionPipeline
    state: newton.State
    contacts: newton.Contacts


class Newton(Method):
    name = "newton mesh"
    is_quick = False

    def update(self, world: World, before) -> _State:
        builder = newton.ModelBuilder()
        builder.rigid_gap = 0.0
        shape = newton.ModelBuilder.ShapeConfig(density=0.0, gap=0.0)
        for fragment in world.fragments:
            body = builder.add_body(xform=warp.transform(fragment.centre.tolist(), (0.0, 0.0, 0.0, 1.0)), mass=1.0)
            vertices, triangles = fragment.mesh.vertices.astype(np.float32), fragment.mesh.triangles.ravel()
            mesh = newton.Mesh(vertices, triangles.astype(np.int32), compute_inertia=False)
            builder.add_shape_mesh(body, mesh=mesh, cfg=shape)
        model = builder.finalize(device="cpu")
        pipeline = newton.CollisionPipeline(model, broad_phase="sap", rigid_contact_max=MOST_CONTACTS)
        return _State(pipeline, model.state(), pipeline.contacts())

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        state.state.body_q.numpy()[:] = np.hstack([frame.positions, frame.quaternions])
        started = perf_counter()
        state.pipeline.collide(state.state, state.contacts)
        native = perf_counter() - started
        count = int(state.contacts.rigid_contact_count.numpy()[0])
        if not count:
            return no_contacts(native)
        found = state.contacts
        names = ("shape0", "shape1", "point0", "point1", "normal")
        arrays = (getattr(found, f"rigid_contact_{name}").numpy()[:count] for name in names)
        first, second, own, other, normals = arrays
        own = np.einsum("nij,nj->ni", frame.rotations[first], own) + frame.positions[first]
        other = np.einsum("nij,nj->ni", frame.rotations[second], other) + frame.positions[second]
        return contacts_of(first, second, own, other, normals, -np.sum((other - own) * normals, axis=1), native)


def methods() -> list[Method]:
    return [Newton()]

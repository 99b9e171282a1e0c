"""A brute-force stand-in for the collision service: boxes and balls on planes and on each other, in closed form.

Boxes are sampled at points on their surface (corners among them) against planes, boxes and spheres; no tree, no field.
A tetrahedral body's mass is that of its nodes, so that the parts of a body add up exactly.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.geometry.tetrahedra import tetrahedron_volumes
from fracture_collision.records import ContactConstraintArray, FragmentRegistry

REACH = 0.002  # [m] contacts with a gap up to this are listed


class Oracle:
    def __init__(self, bodies):
        self.bodies = {body.fragment_id: body for body in bodies}
        self.fragments = {body.fragment_id: (body, None) for body in bodies}
        self.parents = {body.fragment_id: body.fragment_id for body in bodies}
        self.sequence = 0

    def add_fracture(self, event):
        self.sequence += 1
        assert event.sequence == self.sequence
        body, _ = self.fragments.pop(event.fragment_id)
        for i, fragment_id in enumerate(event.new_fragment_ids):
            nodes = event.nodes[event.node_fragments == i]
            assert len(nodes)
            self.fragments[int(fragment_id)] = (body, nodes)
            self.parents[int(fragment_id)] = event.fragment_id

    def registry(self):
        ids = sorted(self.fragments)
        parts = [_mass_properties(*self.fragments[i]) for i in ids]
        return FragmentRegistry(
            self.sequence, np.array(ids, np.uint32),
            np.array([self.fragments[i][0].body_id for i in ids], np.uint32),
            np.array([self.parents[i] for i in ids], np.uint32),
            np.array([p[0] for p in parts]), np.array([p[1] for p in parts]),
            np.array([p[2][[0, 0, 0, 1, 1, 2], [0, 1, 2, 1, 2, 2]] for p in parts]),
            np.zeros(len(ids)), "",
        )  # fmt: skip

    def contacts(self, states):
        poses = {i: (np.zeros(3), np.eye(3)) for i, b in self.bodies.items() if b.is_static}
        for row, i in enumerate(states.fragment_ids):
            rotation = Rotation.from_quat(states.orientations[row]).as_matrix()
            poses[int(i)] = (states.positions[row], rotation)
        pairs = []
        ids = sorted(poses)
        for k, a in enumerate(ids):
            for b in ids[k + 1 :]:
                body_a, body_b = self.fragments[a][0], self.fragments[b][0]
                if body_a.is_static and body_b.is_static:
                    continue
                found = _samples_in(body_a, poses[a], body_b, poses[b], 0)
                found += [(pb, pa, -n, g, c) for pa, pb, n, g, c in _samples_in(body_b, poses[b], body_a, poses[a], 1)]
                if found:
                    pairs.append((a, b, found))
        return _array(states, pairs, self.fragments)


def _array(states, pairs, fragments):
    flat = [contact for _, _, found in pairs for contact in found]
    combined = [(fragments[a][0], fragments[b][0]) for a, b, _ in pairs]

    def column(k):
        return np.array([c[k] for c in flat]) if flat else np.zeros((0, 3)[: 1 + (k < 3)])

    return ContactConstraintArray(
        states.step, states.fracture_sequence, 0,
        np.array([p[0] for p in pairs], np.uint32), np.array([p[1] for p in pairs], np.uint32),
        np.cumsum([0] + [len(p[2]) for p in pairs]).astype(np.uint32), np.zeros(len(pairs)),
        np.array([np.sqrt(a.friction * b.friction) for a, b in combined]),
        np.array([max(a.restitution, b.restitution) for a, b in combined]),
        column(0), column(1), column(2), column(3), np.array([c[4] for c in flat], np.uint64),
    )  # fmt: skip


def _mass_properties(body, nodes):
    if body.is_static:
        return 0.0, np.zeros(3), np.zeros((3, 3))
    size = body.primitive.dimensions
    if body.primitive.type == 1:
        mass = body.density * np.prod(size)
        x, y, z = np.square(size)
        return mass, np.zeros(3), np.diag([y + z, x + z, x + y]) * mass / 12.0
    if body.primitive.type == 2:
        mass = body.density * 4.0 / 3.0 * np.pi * size[0] ** 3
        return mass, np.zeros(3), np.eye(3) * 0.4 * mass * size[0] ** 2
    vertices = body.vertices.reshape(-1, 3)
    tetrahedra = body.tetrahedra.reshape(-1, 4).astype(np.int64)
    weights = np.zeros(len(vertices))
    np.add.at(weights, tetrahedra, (0.25 * body.density * tetrahedron_volumes(vertices, tetrahedra))[:, None])
    if nodes is not None:
        vertices, weights = vertices[nodes], weights[nodes]
    mass = weights.sum()
    center = weights @ vertices / mass
    arms = vertices - center
    second = np.einsum("n,ni,nj->ij", weights, arms, arms)
    # A point mass has no spin inertia; a millimetre of size keeps lone nodes from being singular.
    return mass, center, np.trace(second) * np.eye(3) - second + 1e-6 * mass * np.eye(3)


def _samples(body):
    if body.primitive.type == 1:
        grid = np.stack(np.meshgrid(*[np.linspace(-0.5, 0.5, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        return grid[np.abs(grid).max(axis=1) == 0.5] * np.array(body.primitive.dimensions)
    return np.zeros((0, 3))


def _samples_in(body_a, pose_a, body_b, pose_b, side):
    """Samples of a within REACH of b: (point on a, point on b, normal a to b, gap, id)."""
    if body_b.primitive.type == 1 and body_a.primitive.type == 2:
        return []
    if body_a.primitive.type == 2:  # A ball against a plane or a ball has one sample, its deepest point.
        if np.any(body_b.plane):
            samples = pose_a[0] - body_a.primitive.dimensions[0] * body_b.plane[None, :3]
        elif side == 0:
            away = pose_b[0] - pose_a[0]
            samples = pose_a[0] + body_a.primitive.dimensions[0] * away[None] / np.linalg.norm(away)
        else:
            return []
    else:
        samples = _samples(body_a) @ pose_a[1].T + pose_a[0]
    if not len(samples):
        return []
    if np.any(body_b.plane):
        distance = samples @ body_b.plane[:3] + body_b.plane[3]
        outward = np.broadcast_to(body_b.plane[:3], samples.shape)
    elif body_b.primitive.type == 2:
        away = samples - pose_b[0]
        length = np.linalg.norm(away, axis=1)
        distance, outward = length - body_b.primitive.dimensions[0], away / length[:, None]
    elif body_b.primitive.type == 1:
        distance, outward = _box_distance((samples - pose_b[0]) @ pose_b[1], np.array(body_b.primitive.dimensions))
        outward = outward @ pose_b[1].T
    else:
        return []
    return [
        (samples[i], samples[i] - distance[i] * outward[i], -outward[i], distance[i], 2 * int(i) + side)
        for i in np.flatnonzero(distance < REACH)
    ]


def _box_distance(points, size):
    """Signed distance to the nearest face, and that face's outward normal; large outside the face's extent."""
    over = np.abs(points) - 0.5 * size
    axis = over.argmax(axis=1)
    rows = np.arange(len(points))
    others = over.copy()
    others[rows, axis] = -np.inf
    distance = np.where(others.max(axis=1) <= 0.0, over[rows, axis], np.inf)
    normals = np.zeros_like(points)
    normals[rows, axis] = np.sign(points[rows, axis])
    return distance, normals

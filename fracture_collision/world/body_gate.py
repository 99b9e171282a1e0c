"""The gate for bodies: CollisionBody in, a checked body with its prepared geometry out."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from fracture_collision.core.collision_geometry import PreparedMesh, prepare_mesh
from fracture_collision.core.tet_mesh import build_tet_mesh
from fracture_collision.geometry.tetrahedra import boundary_triangles, connected_pieces, tetrahedron_volumes, unique_edges
from fracture_collision.records import BOX, SPHERE, CollisionBody
from fracture_collision.world.checks import floats, identifier, indices, number, refuse

# A tetrahedron flatter than this (volume against its longest edge cubed) has no usable barycentric coordinates.
FLAT_TETRAHEDRON = 1e-9
MAX_NAME = 256
DIMENSIONS = {BOX: 3, SPHERE: 1}


class CheckedBody(NamedTuple):
    body_id: int
    fragment_id: int
    is_static: bool
    density: float  # [kg/m3]
    friction: float
    restitution: float
    sphere: float  # [m] radius, 0: none
    box: np.ndarray | None  # (3,) [m] half edges
    plane: np.ndarray | None  # (4,) unit normal, offset: n.x = offset, solid where less
    mesh: PreparedMesh | None
    digest: bytes  # SHA-256 of the message's content


class MeshStore:
    """Prepared meshes by content, so that equal geometries are prepared once in a run."""

    def __init__(self) -> None:
        self._known: dict[bytes, PreparedMesh] = {}

    def prepared(self, key: bytes, vertices: np.ndarray, tetrahedra: np.ndarray) -> PreparedMesh:
        if key not in self._known:
            self._known[key] = prepare_mesh(build_tet_mesh(vertices, tetrahedra))
        return self._known[key]


def check_body(body: CollisionBody, store: MeshStore, room_for_nodes: int) -> CheckedBody:
    """Raise InvalidMessage unless `body` keeps the rules of CollisionBody.msg."""
    body_id, fragment_id = identifier("body_id", body.body_id), identifier("fragment_id", body.fragment_id)
    if len(body.name) > MAX_NAME:
        refuse("limit_exceeded", f"name: longer than {MAX_NAME} characters")
    density = number("density", body.density, 0.0, open_low=True)
    friction, restitution = number("friction", body.friction, 0.0), number("restitution", body.restitution, 0.0, 1.0)
    vertices = floats("vertices", body.vertices, 3)
    tetrahedra = indices("tetrahedra", body.tetrahedra, 4, len(vertices), "vertices")
    triangles = indices("triangles", body.triangles, 3, len(vertices), "vertices")
    plane = floats("plane", body.plane)
    if len(plane) != 4:
        refuse("size_mismatch", f"plane: {len(plane)} coefficients, not 4")
    dimensions = floats("primitive.dimensions", body.primitive.dimensions)
    kind = identifier("primitive.type", body.primitive.type)
    given = [kind != 0, bool(plane.any()), bool(len(vertices) or len(tetrahedra) or len(triangles))]
    if sum(given) != 1:
        refuse("no_shape", "a body needs exactly one of primitive, plane, and vertices with tetrahedra or triangles")
    sphere, box, half_space, mesh = 0.0, None, None, None
    if given[0]:
        sphere, box = _primitive(kind, dimensions)
    elif given[1]:
        length = float(np.linalg.norm(plane[:3]))
        if length == 0.0:
            refuse("out_of_range", "plane: the normal (a, b, c) is zero")
        half_space = np.append(plane[:3], -plane[3]) / length
        if not body.is_static:
            refuse("out_of_range", "is_static: a plane has no mass and must be static")
    else:
        if len(vertices) > room_for_nodes:
            refuse("limit_exceeded", f"vertices: {len(vertices)} more than the limit on nodes allows ({room_for_nodes} left)")
        mesh = _mesh(vertices, tetrahedra, triangles, store)
    content = (
        np.array([body_id, fragment_id, bool(body.is_static), kind], np.uint64).tobytes(),
        np.array([density, friction, restitution]).tobytes(), plane.tobytes(), dimensions.tobytes(),
        vertices.tobytes(), tetrahedra.tobytes(), triangles.tobytes(),
    )  # fmt: skip
    digest = hashlib.sha256(b"".join(len(c).to_bytes(8, "little") + c for c in content)).digest()
    return CheckedBody(
        body_id, fragment_id, bool(body.is_static), density, friction, restitution, sphere, box, half_space, mesh, digest
    )


def _primitive(kind: int, dimensions: np.ndarray) -> tuple[float, np.ndarray | None]:
    if kind not in DIMENSIONS:
        refuse("out_of_range", f"primitive.type: {kind} is neither BOX (1) nor SPHERE (2)")
    if len(dimensions) != DIMENSIONS[kind]:
        refuse("size_mismatch", f"primitive.dimensions: {len(dimensions)} numbers, not {DIMENSIONS[kind]}")
    if (dimensions <= 0.0).any():
        refuse("out_of_range", f"primitive.dimensions: {dimensions.min()} is not positive")
    return (float(dimensions[0]), None) if kind == SPHERE else (0.0, dimensions / 2.0)


def _mesh(vertices: np.ndarray, tetrahedra: np.ndarray, triangles: np.ndarray, store: MeshStore) -> PreparedMesh:
    if not len(tetrahedra):
        if not len(triangles):
            refuse("no_shape", "vertices without tetrahedra or triangles")
        refuse("unsupported", "triangles: a rigid body of triangles alone is not supported yet; give tetrahedra")
    key = hashlib.sha256(vertices.tobytes() + b"/" + tetrahedra.tobytes()).digest()
    unused = np.flatnonzero(np.bincount(tetrahedra.ravel(), minlength=len(vertices)) == 0)
    if len(unused):
        refuse("bad_mesh", f"vertices: vertex {unused[0]} belongs to no tetrahedron")
    volumes = tetrahedron_volumes(vertices, tetrahedra)
    corners = vertices[tetrahedra]
    longest = np.max([((corners[:, i] - corners[:, j]) ** 2).sum(axis=1) for i in range(4) for j in range(i)], axis=0)
    bad = np.flatnonzero(volumes <= FLAT_TETRAHEDRON * longest**1.5)
    if len(bad):
        what = "inverted" if volumes[bad[0]] < 0 else "flat"
        refuse("bad_mesh", f"tetrahedra: tetrahedron {bad[0]} is {what} (volume {volumes[bad[0]]:.3g} m3)")
    faces = np.sort(tetrahedra[:, [[1, 2, 3], [0, 2, 3], [0, 1, 3], [0, 1, 2]]].reshape(-1, 3), axis=1)
    _, uses = np.unique(faces, axis=0, return_counts=True)
    if uses.max() > 2:
        refuse("bad_mesh", f"tetrahedra: a face belongs to {uses.max()} tetrahedra")
    pieces = connected_pieces(unique_edges(tetrahedra), np.zeros(len(vertices), np.int64))
    if pieces.max() > 0:
        refuse("bad_mesh", f"tetrahedra: the mesh falls into {pieces.max() + 1} pieces; each needs a body of its own")
    if len(triangles):
        boundary = np.sort(boundary_triangles(tetrahedra), axis=1)
        mine, theirs = (np.unique(np.sort(t, axis=1), axis=0) for t in (boundary, triangles))
        if not np.array_equal(mine, theirs):
            refuse("bad_mesh", "triangles: not the boundary of the tetrahedra; leave them empty to use it")
    return store.prepared(key, vertices, tetrahedra)

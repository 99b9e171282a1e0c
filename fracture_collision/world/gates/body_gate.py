"""Validation of bodies: CollisionBody in, fields read one by one, a checked body with its prepared geometry out."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from fracture_collision.core.bodies.prepared import (
    PreparedMesh,
    PreparedSurface,
    prepare_mesh,
    prepare_surface,
)
from fracture_collision.core.mesh.connected_pieces import connected_pieces
from fracture_collision.core.mesh.tet_mesh import build_tet_mesh
from fracture_collision.geometry.round_solids import BY_PRIMITIVE
from fracture_collision.geometry.tetrahedra import (
    FACE_VERTICES,
    boundary_triangles,
    tetrahedron_volumes,
    unique_edges,
)
from fracture_collision.portable_math import lengths
from fracture_collision.records import BOX, CONE, CYLINDER, SPHERE, CollisionBody
from fracture_collision.world.gates.checks import (
    LARGEST_LENGTH,
    SMALLEST_LENGTH,
    UINT64_MAX,
    floats,
    identifier,
    indices,
    number,
    refuse,
)
from fracture_collision.world.gates.surface_gate import check_surface

# A tetrahedron flatter than this (volume against its longest edge cubed) has no usable barycentric coordinates.
FLAT_TETRAHEDRON = 1e-9
MAX_NAME = 256
MAX_DENSITY = 1e9  # [kg/m3] beyond all matter on Earth; keeps masses finite
MAX_FRICTION = 1e6
# Of a primitive.
DIMENSIONS = {
    BOX: (3, "the lengths of the edges"), SPHERE: (1, "the radius"), CYLINDER: (2, "the height and the radius"),
    CONE: (2, "the height and the radius"),
}  # fmt: skip
SHAPE_FIELDS = "primitive, plane, vertices"


class CheckedBody(NamedTuple):
    """A valid body. Exactly one of sphere, box, plane, mesh and surface is its shape."""

    body_id: int
    fragment_id: int
    is_static: bool
    density: float  # [kg/m3]
    friction: float
    restitution: float
    sphere: float  # [m] radius, 0: none
    box: np.ndarray | None  # (3,) [m] half edges
    plane: np.ndarray | None  # (4,) unit normal, offset: n.x = offset, solid below
    mesh: PreparedMesh | None
    digest: bytes  # SHA-256 of the message's content
    surface: PreparedSurface | None = None  # of a rigid body with triangles only
    sequence: int = 0  # of the message among those of bodies; 0: not numbered


class BodyFields(NamedTuple):
    """A message whose fields are valid one by one; their combination is not checked yet."""

    body_id: int
    fragment_id: int
    is_static: bool
    density: float
    friction: float
    restitution: float
    primitive: int
    dimensions: np.ndarray
    plane: np.ndarray
    vertices: np.ndarray  # (n, 3)
    tetrahedra: np.ndarray  # (m, 4)
    triangles: np.ndarray  # (t, 3)
    digest: bytes  # of all but the sequence
    sequence: int


class MeshStore:
    """Prepared meshes by content: equal geometries are prepared once. Counts the bodies that use each."""

    def __init__(self) -> None:
        self._known: dict[bytes, PreparedMesh | PreparedSurface] = {}
        self._uses: dict[int, tuple[bytes, int]] = {}  # id() of a prepared mesh -> its key, number of its bodies

    def prepared(self, key: bytes, prepare: Callable[[], PreparedMesh | PreparedSurface]):
        """The shape of `key` for one more body, prepared on first use."""
        if key not in self._known:
            self._known[key] = prepare()
        shape = self._known[key]
        self._uses[id(shape)] = key, self._uses.get(id(shape), (key, 0))[1] + 1
        return shape

    def release(self, shape: PreparedMesh | PreparedSurface | None) -> None:
        """One body less uses the shape; it is dropped with the last."""
        if shape is None:
            return
        key, uses = self._uses.pop(id(shape))
        if uses > 1:
            self._uses[id(shape)] = key, uses - 1
        else:
            del self._known[key]


def read_body(body: CollisionBody) -> BodyFields:
    """Raise InvalidMessage unless each field by itself obeys the rules of CollisionBody.msg."""
    body_id, fragment_id = identifier("body_id", body.body_id), identifier("fragment_id", body.fragment_id)
    if not isinstance(body.name, str):
        refuse("wrong_type", f"name: {type(body.name).__name__} instead of a string")
    if len(body.name) > MAX_NAME:
        refuse("limit_exceeded", f"name: {len(body.name)} characters, more than {MAX_NAME}")
    if not isinstance(body.is_static, bool | np.bool_):
        refuse("wrong_type", f"is_static: {type(body.is_static).__name__} instead of true or false")
    density = number("density", body.density, 0.0, MAX_DENSITY, open_low=True)
    friction = number("friction", body.friction, 0.0, MAX_FRICTION)
    restitution = number("restitution", body.restitution, 0.0, 1.0)
    vertices = floats("vertices", body.vertices, 3, LARGEST_LENGTH)
    tetrahedra = indices("tetrahedra", body.tetrahedra, 4, len(vertices), "vertices")
    triangles = indices("triangles", body.triangles, 3, len(vertices), "vertices")
    plane = floats("plane", body.plane, limit=LARGEST_LENGTH)
    if len(plane) != 4:
        refuse("size_mismatch", f"plane: {len(plane)} coefficients, not 4: a, b, c, d of a x + b y + c z + d = 0")
    dimensions = floats("primitive.dimensions", getattr(body.primitive, "dimensions", None), limit=LARGEST_LENGTH)
    kind = identifier("primitive.type", getattr(body.primitive, "type", None))
    content = (
        np.array([body_id, fragment_id, bool(body.is_static), kind], np.uint64).tobytes(),
        np.array([density, friction, restitution]).tobytes(), plane.tobytes(), dimensions.tobytes(),
        vertices.tobytes(), tetrahedra.tobytes(), triangles.tobytes(),
    )  # fmt: skip
    digest = hashlib.sha256(b"".join(len(c).to_bytes(8, "little") + c for c in content)).digest()
    return BodyFields(
        body_id, fragment_id, bool(body.is_static), density, friction, restitution, kind, dimensions, plane,
        vertices, tetrahedra, triangles, digest, identifier("sequence", body.sequence, UINT64_MAX),
    )  # fmt: skip


def check_body(fields: BodyFields, store: MeshStore, room_for_nodes: int) -> CheckedBody:
    """Raise InvalidMessage unless the fields together form a body; prepare its geometry."""
    has_mesh = bool(len(fields.vertices) or len(fields.tetrahedra) or len(fields.triangles))
    if (fields.primitive != 0) + bool(fields.plane.any()) + has_mesh != 1:
        given = [name for name, is_given in (
            ("primitive", fields.primitive != 0), ("plane", fields.plane.any()), ("vertices", has_mesh)
        ) if is_given]  # fmt: skip
        refuse(
            "no_shape",
            f"{SHAPE_FIELDS}: a body needs exactly one of these, vertices with tetrahedra or triangles; this one has "
            + (" and ".join(given) or "none"),
        )
    sphere, box, half_space, mesh, surface = 0.0, None, None, None, None
    if fields.primitive:
        size = _dimensions(fields.primitive, fields.dimensions)
        if fields.primitive == SPHERE:
            sphere = float(size[0])
        elif fields.primitive == BOX:
            box = size / 2.0
        else:
            surface = store.prepared(
                _key(b"primitive %d" % fields.primitive, size),
                lambda: prepare_surface(*BY_PRIMITIVE[fields.primitive](*size.tolist())),
            )
    elif not has_mesh:
        half_space = _half_space(fields.plane)
        if not fields.is_static:
            refuse("out_of_range", "is_static: a plane has no mass and must be static")
    else:
        vertices, tetrahedra, triangles = fields.vertices, fields.tetrahedra, fields.triangles
        if len(vertices) > room_for_nodes:
            refuse("limit_exceeded", f"vertices: {len(vertices)}, but max_nodes leaves room for {room_for_nodes}")
        if not len(tetrahedra) and not len(triangles):
            refuse("no_shape", "tetrahedra, triangles: both are empty, but there are vertices; pass one of them")
        if float(np.ptp(vertices, axis=0).max(initial=0.0)) < SMALLEST_LENGTH:
            refuse("out_of_range", f"vertices: the body is smaller than {SMALLEST_LENGTH:g} m; lengths are in metres")
        if len(tetrahedra):
            _check_tetrahedra(vertices, tetrahedra, triangles)
            mesh = store.prepared(
                _key(b"tetrahedra", vertices, tetrahedra), lambda: prepare_mesh(build_tet_mesh(vertices, tetrahedra))
            )
        else:
            check_surface(vertices, triangles)
            surface = store.prepared(
                _key(b"triangles", vertices, triangles), lambda: prepare_surface(vertices, triangles)
            )
    return CheckedBody(
        fields.body_id, fields.fragment_id, fields.is_static, fields.density, fields.friction, fields.restitution,
        sphere, box, half_space, mesh, fields.digest, surface, fields.sequence,
    )  # fmt: skip


def _key(*content: bytes | np.ndarray) -> bytes:
    return hashlib.sha256(b"/".join(c.tobytes() if isinstance(c, np.ndarray) else c for c in content)).digest()


def _half_space(plane: np.ndarray) -> np.ndarray:
    """Unit normal and offset; divided by the largest coefficient first, so that no square underflows."""
    largest = float(np.abs(plane[:3]).max())
    if largest == 0.0:
        refuse("out_of_range", "plane: the normal (a, b, c) is zero")
    normal = plane[:3] / largest
    length = float(lengths(normal))
    if abs(plane[3]) > LARGEST_LENGTH * largest:
        refuse("out_of_range", f"plane: farther than {LARGEST_LENGTH:g} m from the origin")
    return np.append(normal / length, -plane[3] / largest / length)


def _dimensions(kind: int, dimensions: np.ndarray) -> np.ndarray:
    if kind not in DIMENSIONS:
        refuse("out_of_range", f"primitive.type: {kind} is none of BOX (1), SPHERE (2), CYLINDER (3) and CONE (4)")
    count, words = DIMENSIONS[kind]
    if len(dimensions) != count:
        refuse("size_mismatch", f"primitive.dimensions: {len(dimensions)} numbers, not {count}, {words}")
    if (dimensions < SMALLEST_LENGTH).any():
        refuse("out_of_range", f"primitive.dimensions: {dimensions.min()} is less than {SMALLEST_LENGTH:g} m")
    return dimensions


def _check_faces(tetrahedra: np.ndarray) -> None:
    """Raise InvalidMessage unless each face belongs to one tetrahedron, or to two on either side; volumes > 0."""
    faces = tetrahedra[:, FACE_VERTICES].reshape(-1, 3)  # counter-clockwise from outside
    kinds, place, uses = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True, return_counts=True)
    place = place.ravel()
    if uses.max() > 2:
        face = "-".join(map(str, kinds[uses.argmax()]))
        refuse("bad_mesh", f"tetrahedra: the face {face} belongs to {uses.max()} tetrahedra, not 1 or 2; some overlap")
    first, second, third = faces.T
    turn = np.where((first < second) ^ (second < third) ^ (third < first), 1, -1)
    folded = np.flatnonzero(np.abs(np.bincount(place, turn)) > 1)
    if len(folded):
        face = "-".join(map(str, kinds[folded[0]]))
        one, other = np.flatnonzero(place == folded[0]) // 4
        refuse(
            "bad_mesh",
            f"tetrahedra: tetrahedra {one} and {other} lie on the same side of their face {face}, so they overlap "
            f"({len(folded)} of {len(kinds)} faces are folded); move a vertex across, or mesh the body again",
        )


def _check_tetrahedra(vertices: np.ndarray, tetrahedra: np.ndarray, triangles: np.ndarray) -> None:
    unused = np.flatnonzero(np.bincount(tetrahedra.ravel(), minlength=len(vertices)) == 0)
    if len(unused):
        refuse(
            "bad_mesh",
            f"vertices: vertex {unused[0]} belongs to no tetrahedron ({len(unused)} of {len(vertices)} do not); leave "
            "out unused vertices and renumber the others, as by numpy.unique(tetrahedra, return_inverse=True)",
        )
    volumes = tetrahedron_volumes(vertices, tetrahedra)
    corners = vertices[tetrahedra]
    longest = np.max([lengths(corners[:, i] - corners[:, j]) for i in range(4) for j in range(i)], axis=0)
    bad = np.flatnonzero(volumes <= FLAT_TETRAHEDRON * longest * longest * longest)
    if len(bad):
        inverted = int((volumes < 0.0).sum())
        if volumes[bad[0]] < 0.0:
            what, advice = "inverted", f"{inverted} of {len(volumes)} are; exchange two corners of each"
        else:
            what, advice = "flat", "leave it out, or mesh the body again"
        refuse("bad_mesh", f"tetrahedra: tetrahedron {bad[0]} is {what} (volume {volumes[bad[0]]:.3g} m3); {advice}")
    _check_faces(tetrahedra)
    pieces = connected_pieces(unique_edges(tetrahedra), np.zeros(len(vertices), np.int64))
    if pieces.max() > 0:
        refuse("bad_mesh", f"tetrahedra: the mesh falls into {pieces.max() + 1} pieces; each needs a body of its own")
    if len(triangles):
        boundary = np.sort(boundary_triangles(tetrahedra), axis=1)
        mine, theirs = (np.unique(np.sort(t, axis=1), axis=0) for t in (boundary, triangles))
        if not np.array_equal(mine, theirs):
            refuse("bad_mesh", "triangles: not the boundary of the tetrahedra; leave them empty to use it")

"""The messages of msg/*.msg as plain numpy records: what all folders exchange, with or without ROS.

Fields are named as in the messages (SI units, frames and signs as written there), less `header` and `run_id`. Arrays of
vectors have a row each, see WIDTHS; in the messages they are flat. Nothing is validated here: `world/gates` does that.
`documented` serves other records, too.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple, TypeVar

import numpy as np

from fracture_collision.extras import need

ADD = 0
REMOVE = 1
BUDGET_EXHAUSTED = 1
INVALID_STATES = 2

# Numbers in a row of the fields that are arrays of vectors.
WIDTHS = {
    "vertices": 3, "triangles": 3, "tetrahedra": 4, "cut_edges": 2, "cut_planes": 4, "positions": 3, "orientations": 4,
    "linear_velocities": 3, "angular_velocities": 3, "points_a": 3, "points_b": 3, "normals": 3, "centers_of_mass": 3,
    "inertias": 6,
}  # fmt: skip

_Record = TypeVar("_Record")
_ENTRY = re.compile(r" *(\w+): (.*)")


def documented(record: type[_Record]) -> type[_Record]:
    """Class decorator: the docstring's section `Fields:` becomes the documentation of each field.

    An entry is `name: text`, its further lines are indented more; the section ends with the docstring. A field without
    an entry, or an entry without a field, is a TypeError when the class is made.
    """
    text = record.__doc__
    if text is None or "Fields:\n" not in text:  # python -OO
        return record
    names = record._fields  # type: ignore[attr-defined]
    entries: dict[str, str] = {}
    name = ""
    for line in text.split("Fields:\n", 1)[1].rstrip().splitlines():
        entry = _ENTRY.fullmatch(line)
        if entry is not None and entry[1] in names:
            name = entry[1]
            entries[name] = entry[2]
        elif name:
            entries[name] += " " + line.strip()
    if tuple(entries) != names:
        missing = sorted(set(names) ^ set(entries)) or "in another order"
        raise TypeError(f"{record.__name__}: fields and their documentation differ: {missing}")
    for name, entry_text in entries.items():
        record.__dict__[name].__doc__ = entry_text
    return record


def _floats(*shape: int) -> np.ndarray:
    return _read_only(np.zeros(shape, dtype=np.float64))


def _indices(*shape: int) -> np.ndarray:
    return _read_only(np.zeros(shape, dtype=np.uint32))


def _read_only(default: np.ndarray) -> np.ndarray:
    """All records of a class share a default: who writes to it would change the others."""
    default.setflags(write=False)
    return default


@documented
class SolidPrimitive(NamedTuple):
    """A solid about the origin of the body frame, its axis along z (shape_msgs/SolidPrimitive).

    Cylinders and cones are searched as polyhedra that differ from them by less than 0.04 % of the radius
    (geometry/round_solids.py).

    Fields:
      type: BOX (1), SPHERE (2), CYLINDER (3), CONE (4), or 0: none
      dimensions: [m] of a BOX its edge lengths (x, y, z), of a SPHERE its (radius,), of a CYLINDER or CONE its
        (height, radius); the tip of a cone is up, its origin half-way
    """

    type: int = 0
    dimensions: tuple[float, ...] = ()


BOX = 1
SPHERE = 2
CYLINDER = 3
CONE = 4


@documented
class CollisionBody(NamedTuple):
    """One body before any fracture (CollisionBody.msg).

    A body has exactly one shape: a primitive, a plane, tetrahedra, or triangles alone. Arrays may be lists, or flat,
    and of any numeric type; integers where indices are asked for.

    Fields:
      body_id: uint32, unique in a run
      fragment_id: uint32, the one fragment it is before the first fracture; fragment ids are unique in a run and never
        used again
      operation: ADD (0), or REMOVE (1): a promise that no later states name the body
      name: up to 256 characters, for viewers and logs
      primitive: a box, sphere, cylinder or cone; type 0: none
      plane: (4,) float64 a, b, c, d: the half-space a x + b y + c z + d < 0 [m] is solid; all 0: none. The body must be
        static
      vertices: (n, 3) float64 [m], body frame; each is used by a tetrahedron or triangle
      triangles: (t, 3) uint32, indices of vertices from 0; closed, counter-clockwise seen from outside. Beside
        tetrahedra leave them empty, or pass their boundary
      tetrahedra: (m, 4) uint32, indices of vertices from 0; positive volume: seen from the fourth, the first
        three run counter-clockwise. Empty: rigid, cannot break
      is_static: it does not move; states may leave it out, its body frame is then the world
      density: [kg/m3], above 0
      friction: Coulomb coefficient, at least 0; a pair has the geometric mean
      restitution: 0 to 1; a pair has the larger one
      sequence: uint64 1, 2, 3 ... over all bodies added and removed in a run, without gaps; 0: not numbered
    """

    body_id: int
    fragment_id: int
    operation: int = ADD
    name: str = ""
    primitive: SolidPrimitive = SolidPrimitive()
    plane: np.ndarray = _floats(4)
    vertices: np.ndarray = _floats(0, 3)
    triangles: np.ndarray = _indices(0, 3)
    tetrahedra: np.ndarray = _indices(0, 4)
    is_static: bool = False
    density: float = 1000.0
    friction: float = 0.5
    restitution: float = 0.0
    sequence: int = 0


@documented
class FractureEvent(NamedTuple):
    """The instantaneous fracture of one fragment, in the body frame (FractureEvent.msg).

    `fracture_collision.fracture` makes valid ones.

    Fields:
      sequence: uint64 1, 2, 3 ... over all bodies of a run, without gaps
      body_id: uint32
      fragment_id: uint32, the fragment that breaks; its id is not used again
      new_fragment_ids: (k,) uint32, at least 2, never used before
      nodes: (n,) uint32, every vertex of the tetrahedral mesh that the breaking fragment owns, once
      node_fragments: (n,) uint32, for each of nodes an index into new_fragment_ids; the nodes of each new fragment are
        connected by mesh edges between them
      cut_edges: (c, 2) uint32, the two nodes of every mesh edge that joins two of the new fragments
      cut_planes: (c, 4) float64, the plane that cuts each of them: unit normal, from the first node to the
        second, and offset [m] with normal . x = offset; it crosses its edge
    """

    sequence: int
    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray
    nodes: np.ndarray
    node_fragments: np.ndarray
    cut_edges: np.ndarray
    cut_planes: np.ndarray


@documented
class FragmentStates(NamedTuple):
    """Poses and velocities of the fragments at one step (FragmentStates.msg).

    Fields:
      step: uint64, strictly increasing within a run; a replay may go back
      fracture_sequence: uint64, how many fracture events have happened
      fragment_ids: (n,) uint32, each once: the living fragments that take part; static ones may be left out
      positions: (n, 3) float64 [m], of the origin of each body frame (not the centre of mass), in the world
      orientations: (n, 4) float64, unit quaternions x y z w, from the body frame to the world
      linear_velocities: (n, 3) float64 [m/s] of that origin, world axes; empty: zero. Used by lookahead alone
      angular_velocities: (n, 3) float64 [rad/s], world axes; empty: zero. Used by lookahead alone
      body_sequence: uint64, how many bodies were added or removed before these states: the static ones among them take
        part; 0: unknown, all static bodies that have arrived take part
    """

    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray
    positions: np.ndarray
    orientations: np.ndarray
    linear_velocities: np.ndarray = _floats(0, 3)
    angular_velocities: np.ndarray = _floats(0, 3)
    body_sequence: int = 0


@documented
class ContactPair(NamedTuple):
    """Two fragments and the n contacts between them; see ContactConstraintArray.

    Fields:
      a: id of the fragment with the smaller one
      b: id of the other
      points_a: (n, 3) float64 [m], world: witness point on a
      points_b: (n, 3) float64 [m], world: witness point on b
      normals: (n, 3) float64, unit, world axes, from a to b
      gaps: (n,) float64 [m], negative: penetration
      contact_ids: (n,) uint64
      friction: of the two
      restitution: of the two
      missed_depth_bound: [m]
    """

    a: int
    b: int
    points_a: np.ndarray
    points_b: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    contact_ids: np.ndarray
    friction: float
    restitution: float
    missed_depth_bound: float


@documented
class ContactConstraintArray(NamedTuple):
    """The answer to one FragmentStates (ContactConstraintArray.msg): p pairs with N contacts.

    Row i of the pairs has the contacts pair_begin[i] .. pair_begin[i + 1] - 1. Listed are pairs with a contact, or with
    a missed_depth_bound above the penetration tolerance.

    Fields:
      step: uint64, that of the states
      fracture_sequence: uint64, that of the states
      status: bits: BUDGET_EXHAUSTED (1), a limit cut the search short, as missed_depth_bound says; INVALID_STATES (2)
      fragment_a: (p,) uint32, ascending by (a, b), a < b
      fragment_b: (p,) uint32
      pair_begin: (p + 1,) uint32, where the contacts of each pair begin
      missed_depth_bound: (p,) float64 [m], no point of either surface is deeper in the other than the larger of this
        and the deepest contact; with `method: glondu2014`, no surface sample
      friction: (p,) float64, geometric mean of the two coefficients
      restitution: (p,) float64, the larger of the two
      points_a: (N, 3) float64 [m], world: witness point on a
      points_b: (N, 3) float64 [m], world: witness point on b
      normals: (N, 3) float64, unit, world axes, from a to b: an impulse along it pushes b, its opposite a
      gaps: (N,) float64 [m], normal . (point_b - point_a); negative: penetration; with lookahead also large ones,
        touches to come
      contact_ids: (N,) uint64, the same number in every step for the same sample of the same fragment against the same
        other; with it impulses are carried over (warm starting)
      lookahead: float64 [s], the service's setting: contacts that will come about within this time are listed too; 0:
        only those that are near now, or an answer recorded before there was this field
    """

    step: int
    fracture_sequence: int
    status: int
    fragment_a: np.ndarray
    fragment_b: np.ndarray
    pair_begin: np.ndarray
    missed_depth_bound: np.ndarray
    friction: np.ndarray
    restitution: np.ndarray
    points_a: np.ndarray
    points_b: np.ndarray
    normals: np.ndarray
    gaps: np.ndarray
    contact_ids: np.ndarray
    lookahead: float = 0.0

    def __len__(self) -> int:
        """The number of contacts: a record without any is false."""
        return len(self.gaps)

    def pairs(self) -> Iterator[ContactPair]:
        """The pairs one by one, each with its contacts, by ascending ids; arrays are views."""
        for p, (begin, end) in enumerate(itertools.pairwise(self.pair_begin.tolist())):
            yield ContactPair(
                int(self.fragment_a[p]), int(self.fragment_b[p]), self.points_a[begin:end], self.points_b[begin:end],
                self.normals[begin:end], self.gaps[begin:end], self.contact_ids[begin:end], float(self.friction[p]),
                float(self.restitution[p]), float(self.missed_depth_bound[p]),
            )  # fmt: skip


def _made_of_fields(fields: Iterable[Any]) -> ContactConstraintArray:
    """As a NamedTuple's own, which counts the fields by len()."""
    return ContactConstraintArray(*fields)


ContactConstraintArray._make = staticmethod(_made_of_fields)  # type: ignore[method-assign, assignment]


def refusal_of(states: FragmentStates, lookahead: float) -> ContactConstraintArray:
    """The answer to invalid states: no contacts, and the status INVALID_STATES. `lookahead` [s]: the service's."""
    floats, places, ids = np.zeros(0), np.zeros((0, 3)), np.zeros(0, np.uint32)
    return ContactConstraintArray(
        step=states.step, fracture_sequence=states.fracture_sequence, status=INVALID_STATES,
        fragment_a=ids, fragment_b=ids, pair_begin=np.zeros(1, np.uint32), missed_depth_bound=floats,
        friction=floats, restitution=floats, points_a=places, points_b=places, normals=places, gaps=floats,
        contact_ids=np.zeros(0, dtype=np.uint64), lookahead=lookahead,
    )  # fmt: skip


@documented
class FragmentRegistry(NamedTuple):
    """All living fragments after `fracture_sequence` events (FragmentRegistry.msg): n of them.

    Fields:
      fracture_sequence: uint64, how many events it includes
      fragment_ids: (n,) uint32, ascending
      body_ids: (n,) uint32, the body that each belongs to
      parent_ids: (n,) uint32, the fragment it broke from; itself if none
      masses: (n,) float64 [kg]; 0 for planes
      centers_of_mass: (n, 3) float64 [m], body frame
      inertias: (n, 6) float64 [kg m2], about the centre of mass, body axes: xx xy xz yy yz zz
      sampling_gaps: (n,) float64 [m], no point of the fragment's surface is farther than this from a sample
      digest: SHA-256, hex, chained over the bodies and events the registry was built from
      settings: the service's settings that contacts depend on, one line of JSON, an object with the fields of Settings
        that are not limits of messages, threads or caches; "": recorded before there was this field
    """

    fracture_sequence: int
    fragment_ids: np.ndarray
    body_ids: np.ndarray
    parent_ids: np.ndarray
    masses: np.ndarray
    centers_of_mass: np.ndarray
    inertias: np.ndarray
    sampling_gaps: np.ndarray
    digest: str
    settings: str = ""


@documented
class FragmentMesh(NamedTuple):
    """One fragment's surface for viewers (FragmentMesh.msg), closed unless it is an unbounded plane.

    Fields:
      fragment_id: uint32
      vertices: (n, 3) float32 [m], body frame
      triangles: (t, 3) uint32, counter-clockwise from outside
      is_crack: (t,) bool, whether each triangle lies on a crack
    """

    fragment_id: int
    vertices: np.ndarray
    triangles: np.ndarray
    is_crack: np.ndarray

    def to_trimesh(self) -> Any:
        """The same as a trimesh.Trimesh, which writes files and shows itself; needs the extra `meshing`."""
        need("meshing", "FragmentMesh.to_trimesh")
        import trimesh

        attributes: dict[str, Any] = {"is_crack": self.is_crack.astype(np.uint8)}  # .ply has no bool
        return trimesh.Trimesh(self.vertices, self.triangles, face_attributes=attributes, process=False)

"""Every rule of the protocol broken once: the message, the kind of rejection, and a pattern of its text.

The messages fit the world of gate_world. campaigns.bad_input breaks each rule in each field.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.records import BOX, REMOVE, SPHERE, CollisionBody, SolidPrimitive
from worlds.gate_world import (
    BRICK,
    EARLIER,
    EDGES,
    IDS,
    POSITIONS,
    REFERENCE,
    SECOND,
    TET,
    TRI,
    TURNS,
    X,
    box,
    crack,
    plane,
    rigid,
    sphere,
    tetrahedral,
    with_entry,
)
from worlds.rigid_shapes import RigidShape, cube, hollow_box, together

NAN = np.nan

FLAT_BRICK = with_entry(BRICK.vertices.ravel(), slice(2, None, 3), 0.0)
TWO_BRICKS = TET._replace(
    vertices=np.append(TET.vertices, TET.vertices + 5.0),
    tetrahedra=np.append(TET.tetrahedra, TET.tetrahedra + len(BRICK.vertices)),
)
CUBE = cube()
OPEN_CUBE = TRI._replace(triangles=TRI.triangles[3:])
HOLLOW = hollow_box()


def corner_to_corner() -> RigidShape:
    """Two cubes that share one vertex."""
    apart = together(CUBE, CUBE._replace(vertices=CUBE.vertices + 1.0))
    shared = int(np.argmin(np.abs(apart.vertices[8:] - 0.5).sum(axis=1))) + 8
    mine = int(np.argmin(np.abs(apart.vertices[:8] - 0.5).sum(axis=1)))
    triangles = np.where(apart.triangles == shared, mine, apart.triangles)
    triangles = np.where(triangles > shared, triangles - 1, triangles)
    return RigidShape(np.delete(apart.vertices, shared, axis=0), triangles)


BODIES = {
    "operation": (TET._replace(operation=2), "out_of_range", r"operation: 2 is neither ADD \(0\) nor REMOVE \(1\)"),
    "body id too large": (TET._replace(body_id=2**32), "out_of_range", "body_id: 4294967296 is not in 0 "),
    "body id no integer": (TET._replace(body_id=1.5), "wrong_type", "body_id: float instead of an integer"),
    "body redelivered with other content": (tetrahedral(1, friction=0.4), "doubled", "body_id"),
    "fragment id taken": (
        TET._replace(fragment_id=3), "doubled", "fragment_id: fragment 3 already exists .* those above 11 are free"
    ),
    "fragment id retired": (TET._replace(fragment_id=1), "doubled", "fragment_id"),
    "name too long": (TET._replace(name="x" * 257), "limit_exceeded", "name"),
    "name no string": (TET._replace(name=None), "wrong_type", "name: NoneType instead of a string"),
    "static no boolean": (TET._replace(is_static=1), "wrong_type", "is_static: int instead of true or false"),
    "vertices transposed": (
        TET._replace(vertices=BRICK.vertices.T), "size_mismatch",
        r"vertices: shape \(3, 45\); pass shape \(n, 3\), or the same numbers flat",
    ),
    "nothing": (CollisionBody(20, 20), "no_shape", "primitive, plane, vertices: .* this one has none"),
    "two shapes": (
        TET._replace(plane=(0, 0, 1, 0), is_static=True), "no_shape",
        "primitive, plane, vertices: .* this one has plane and vertices",
    ),
    "vertices alone": (CollisionBody(20, 20, vertices=np.arange(9.0)), "no_shape", "tetrahedra, triangles: "),
    "primitive type": (sphere(20, primitive=SolidPrimitive(5, (1.0,))), "out_of_range", "primitive.type"),
    "sphere of no size": (sphere(20, primitive=SolidPrimitive(SPHERE, (0.0,))), "out_of_range", "primitive.dimensions"),
    "box of two": (
        box(20, primitive=SolidPrimitive(BOX, (1.0, 1.0))), "size_mismatch",
        "primitive.dimensions: 2 numbers, not 3, the lengths of the edges",
    ),
    "plane of three": (plane(20, plane=np.ones(3)), "size_mismatch", "plane"),
    "plane without normal": (plane(20, plane=np.array([0.0, 0.0, 0.0, 1.0])), "out_of_range", "plane"),
    "plane out of sight": (plane(20, plane=np.array([0.0, 0.0, 1e-9, 10.0])), "out_of_range", "plane"),
    "plane that moves": (plane(20, is_static=False), "out_of_range", "is_static"),
    "density zero": (TET._replace(density=0.0), "out_of_range", "density"),
    "density nan": (TET._replace(density=NAN), "not_finite", "density"),
    "density no number": (TET._replace(density="heavy"), "wrong_type", "density: str instead of a number"),
    "vertices not in threes": (
        TET._replace(vertices=TET.vertices[:-1]), "size_mismatch", "vertices: 134 numbers are not a multiple of 3"
    ),
    "vertices nan": (TET._replace(vertices=with_entry(TET.vertices, 4, NAN)), "not_finite", "vertices: entry 4"),
    "vertices too far": (TET._replace(vertices=with_entry(TET.vertices, 4, 2e9)), "out_of_range", "vertices: entry 4"),
    "vertices none": (
        TET._replace(vertices=None), "wrong_type", "vertices: object instead of numbers; pass an array of float64"
    ),
    "vertices ragged": (
        TET._replace(vertices=[[0.0, 1.0], [2.0]]), "wrong_type",
        "vertices: not an array of numbers; pass a numpy array, or a list without gaps",
    ),
    "body tiny": (
        TET._replace(vertices=1e-8 * TET.vertices), "out_of_range",
        "vertices: the body is smaller than 1e-06 m; lengths are in metres",
    ),
    "vertex unused": (
        TET._replace(vertices=np.append(TET.vertices, [9.0, 9.0, 9.0])), "bad_mesh",
        r"vertices: vertex 45 belongs to no tetrahedron \(1 of 46 do not\); leave out unused .*numpy.unique",
    ),
    "tetrahedra counted from 1": (
        TET._replace(tetrahedra=TET.tetrahedra + 1), "out_of_range",
        "tetrahedra: index 45 .* is not below 45 vertices; the indices seem to start at 1: subtract 1",
    ),
    "tetrahedra negative": (
        TET._replace(tetrahedra=with_entry(TET.tetrahedra, 5, -1)), "out_of_range",
        r"tetrahedra: index -1 \(entry 5\) is negative$",
    ),
    "tetrahedra of floats": (
        TET._replace(tetrahedra=TET.tetrahedra * 1.0), "wrong_type",
        r"tetrahedra: float64 instead of integers; convert it, as by .astype\(numpy.uint32\)",
    ),
    "tetrahedra flat": (
        TET._replace(vertices=FLAT_BRICK), "bad_mesh",
        r"tetrahedra: tetrahedron \d+ is flat .*; leave it out, or mesh the body again",
    ),
    "tetrahedra inverted": (
        TET._replace(tetrahedra=TET.tetrahedra.reshape(-1, 4)[:, [1, 0, 2, 3]]), "bad_mesh",
        "tetrahedra: tetrahedron 0 is inverted .*; 96 of 96 are; exchange two corners of each",
    ),
    "tetrahedron twice": (
        TET._replace(tetrahedra=np.append(TET.tetrahedra, TET.tetrahedra[:4])), "bad_mesh",
        r"tetrahedra: the face \d+-\d+-\d+ belongs to 3 tetrahedra, not 1 or 2; some overlap",
    ),
    "tetrahedra folded over a face": (
        CollisionBody(20, 20, vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.5]]),
                      tetrahedra=np.array([[0, 1, 2, 3], [0, 1, 2, 4]])),
        "bad_mesh", "tetrahedra 0 and 1 lie on the same side of their face 0-1-2, so they overlap .*move a vertex",
    ),
    "tetrahedra in two pieces": (TWO_BRICKS, "bad_mesh", "tetrahedra: the mesh falls into 2"),
    "triangles of another mesh": (TET._replace(triangles=np.array([0, 1, 2])), "bad_mesh", "triangles"),
    "open surface": (OPEN_CUBE, "bad_mesh", "belongs to one triangle"),
    "edge of three triangles": (
        TRI._replace(
            vertices=np.append(TRI.vertices, [3.0, 3.0, 3.0]),
            triangles=np.append(TRI.triangles, [TRI.triangles[0], TRI.triangles[1], 8]),
        ), "bad_mesh", "belongs to 3 triangles",
    ),
    "triangle turned over": (
        TRI._replace(triangles=with_entry(TRI.triangles, slice(0, 2), TRI.triangles[1::-1])), "bad_mesh", "the same way"
    ),
    "inside out": (rigid(20, CUBE._replace(triangles=CUBE.triangles[:, ::-1])), "bad_mesh", "inside out"),
    "triangle without area": (
        TRI._replace(vertices=with_entry(TRI.vertices, slice(0, 3), TRI.vertices[3:6])), "bad_mesh", "has no area"
    ),
    "surface vertex unused": (TRI._replace(vertices=np.append(TRI.vertices, [2.0, 2.0, 2.0])), "bad_mesh", "vertices"),
    "two solids": (rigid(20, together(CUBE, CUBE._replace(vertices=CUBE.vertices + 3.0))), "bad_mesh", "separate"),
    "solids that share a vertex": (rigid(20, corner_to_corner()), "bad_mesh", "touches itself in vertex"),
    "cavity outside": (
        rigid(20, together(CUBE, RigidShape(0.5 * CUBE.vertices + 3.0, CUBE.triangles[:, ::-1]))),
        "bad_mesh",
        "no cavity",
    ),
    "remove unknown": (CollisionBody(99, 99, operation=REMOVE), "unknown_id", "body_id"),
}  # fmt: skip


def plane_along(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """A plane (4,) through both points."""
    normal = np.cross(end - start, [0.6, 0.8, 0.1])
    normal /= np.linalg.norm(normal)
    return np.append(normal, normal @ start)


CUTS, PLANES = SECOND.cut_edges.reshape(-1, 2), SECOND.cut_planes.reshape(-1, 4)
OUTERMOST = crack(2, 11, (12, 13), 0.4, above=0.1)  # the layer of nodes at x = 0.5
UNCUT = EDGES[np.flatnonzero((X[EDGES] > 0.3).all(axis=1))[0]]
NO_EDGE = np.array([int(np.argmax(X)), int(np.argmin(X))])
STRANGER = int(np.argmin(X))  # a node of fragment 10
# the middle layer is one piece, so that the layers beside it are one label in two places
MIDDLE_LAYER = (BRICK.vertices[SECOND.nodes, 1] == 0.0).astype(np.int64)

ALONG = plane_along(*BRICK.vertices[CUTS[0]])

EVENTS = {
    "sequence gap": (SECOND._replace(sequence=3), "sequence_gap", "sequence: event 3 does not follow event 1"),
    "event repeated with another plane": (crack(1, 1, (10, 11), 0.11), "sequence_repeat", "event 1 already"),
    "body unknown": (SECOND._replace(body_id=9), "unknown_id", "body_id"),
    "body cannot break": (SECOND._replace(body_id=4, fragment_id=4), "rigid_body", "body_id"),
    "fragment unknown": (SECOND._replace(fragment_id=77), "unknown_id", "fragment_id"),
    "fragment retired": (SECOND._replace(fragment_id=1), "retired_id", "fragment_id"),
    "one piece": (
        SECOND._replace(new_fragment_ids=np.array([12])), "size_mismatch",
        "new_fragment_ids: 1 of them; a fracture makes at least 2",
    ),
    "new id twice": (
        SECOND._replace(new_fragment_ids=np.array([12, 12])), "doubled",
        "new_fragment_ids: 12 occurs more than once; list each once",
    ),
    "new id taken": (
        SECOND._replace(new_fragment_ids=np.array([12, 3])), "doubled",
        "new_fragment_ids: fragment 3 already exists .* those above 11 are free",
    ),
    "more pieces than a run may have": (
        SECOND._replace(new_fragment_ids=np.arange(1000, 102_000)), "limit_exceeded", "new_fragment_ids"
    ),
    "node missing": (
        SECOND._replace(nodes=SECOND.nodes[1:], node_fragments=SECOND.node_fragments[1:]), "wrong_nodes",
        "nodes: 17 of the 18 nodes of fragment 11; list all",
    ),
    "node of another fragment": (
        SECOND._replace(nodes=with_entry(SECOND.nodes, 0, STRANGER)), "wrong_nodes", f"nodes: node {STRANGER}"
    ),
    "label missing": (SECOND._replace(node_fragments=SECOND.node_fragments[1:]), "size_mismatch", "node_fragments"),
    "piece without node": (
        SECOND._replace(node_fragments=np.zeros(len(SECOND.nodes), int)), "empty_fragment",
        "node_fragments: fragment 13 has no node: index 1 of new_fragment_ids does not occur",
    ),
    "piece in two": (
        SECOND._replace(node_fragments=MIDDLE_LAYER), "disconnected",
        "node_fragments: fragment 12 falls into pieces .*make each a fragment, as fracture_collision.fracture",
    ),
    "cut edge no edge": (SECOND._replace(cut_edges=np.append(NO_EDGE, CUTS[1:])), "no_edge", "cut_edges"),
    "cut edge within a piece": (SECOND._replace(cut_edges=np.append(UNCUT, CUTS[1:])), "wrong_cut", "cut_edges"),
    "cut edge twice": (SECOND._replace(cut_edges=np.append(CUTS[1], CUTS[1:])), "doubled", "cut_edges"),
    "cut edge left out": (
        SECOND._replace(cut_edges=CUTS[1:], cut_planes=PLANES[1:]), "wrong_cut",
        r"cut_edges: \d+-\d+ joins two of the new fragments but is not cut; list it",
    ),
    "planes transposed": (
        SECOND._replace(cut_planes=PLANES.T), "size_mismatch", r"cut_planes: shape \(4, \d+\); pass shape \(n, 4\)"
    ),
    "plane not unit": (
        SECOND._replace(cut_planes=2.0 * SECOND.cut_planes), "not_unit",
        "cut_planes: the normal of entry 0 is of length 2, not 1; divide the four numbers by it",
    ),
    "plane huge": (SECOND._replace(cut_planes=1e300 * SECOND.cut_planes), "not_unit", "cut_planes"),
    "plane from second to first": (
        SECOND._replace(cut_planes=-SECOND.cut_planes), "missed_edge",
        r"cut_planes: entry 0 does not cross .* is -?\S+ m at node \d+ \(needed: at most 0\) and \S+ m at node",
    ),
    "plane along its edge": (
        SECOND._replace(cut_planes=np.append(ALONG, PLANES[1:])), "missed_edge", "cut_planes: entry 0"
    ),
    "piece without volume": (
        OUTERMOST._replace(cut_planes=(OUTERMOST.cut_planes.reshape(-1, 4) * [1.0, 1.0, 1.0, 1.25]).ravel()),
        "no_volume", "cut_planes: fragment 13",
    ),
}  # fmt: skip


STATES = {
    "event to come": (REFERENCE._replace(fracture_sequence=2), "sequence_gap", "fracture_sequence: 2"),
    "body to come": (REFERENCE._replace(body_sequence=9), "sequence_gap", "body_sequence: 9, but body message"),
    "fragment to come": (
        REFERENCE._replace(fragment_ids=with_entry(IDS, 0, 50)), "unknown_id", "fragment_ids: no fragment 50"
    ),
    "fragment to come, other registry": (
        EARLIER._replace(fragment_ids=np.array([1, 50])), "unknown_id", "fragment_ids: no fragment 50"
    ),
    "fragment retired": (
        REFERENCE._replace(fragment_ids=with_entry(IDS, 0, 1)), "retired_id", "fragment_ids: fragment 1"
    ),
    "fragment not born": (
        EARLIER._replace(fragment_ids=np.array([1, 10])), "retired_id", "fragment_ids: fragment 10"
    ),
    "position missing": (
        REFERENCE._replace(positions=POSITIONS[3:]), "size_mismatch", "positions: 3 entries for 4 fragment_ids"
    ),
    "orientation of length 2": (
        REFERENCE._replace(orientations=with_entry(TURNS, 7, 2.0)), "not_unit",
        "orientations: the quaternion of fragment 4 has length 2, not 1; divide it by that, and order it x y z w",
    ),
    "orientation a little off": (
        REFERENCE._replace(orientations=with_entry(TURNS, 3, 1.00001)), "not_unit", "orientations"
    ),
    "spin infinite": (
        REFERENCE._replace(angular_velocities=np.full(12, np.inf)), "not_finite", "angular_velocities"
    ),
}  # fmt: skip


AHEAD = {"body to come", "event to come", "fragment to come", "fragment to come, other registry"}

"""Every rule of the protocol broken once: the message, the kind of rejection, and a required part of its text.

The messages fit the world of gate_world.
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

NAN, INF = np.nan, np.inf

FLAT_BRICK = with_entry(BRICK.vertices.ravel(), slice(2, None, 3), 0.0)
INVERTED = with_entry(TET.tetrahedra, slice(0, 2), TET.tetrahedra[1::-1])
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
    "operation": (TET._replace(operation=2), "out_of_range", "operation"),
    "body id negative": (TET._replace(body_id=-1), "out_of_range", "body_id"),
    "body id too large": (TET._replace(body_id=2**32), "out_of_range", "body_id"),
    "body id no integer": (TET._replace(body_id=1.5), "wrong_type", "body_id"),
    "body id taken": (TET._replace(body_id=1), "doubled", "body_id"),
    "body redelivered with other content": (tetrahedral(1, friction=0.4), "doubled", "body_id"),
    "fragment id taken": (TET._replace(fragment_id=3), "doubled", "fragment_id"),
    "fragment id retired": (TET._replace(fragment_id=1), "doubled", "fragment_id"),
    "fragment id of a piece": (TET._replace(fragment_id=11), "doubled", "fragment_id"),
    "fragment id no integer": (TET._replace(fragment_id=True), "wrong_type", "fragment_id"),
    "name too long": (TET._replace(name="x" * 257), "limit_exceeded", "name"),
    "name no string": (TET._replace(name=None), "wrong_type", "name"),
    "static no boolean": (TET._replace(is_static="yes"), "wrong_type", "is_static"),
    "vertices transposed": (TET._replace(vertices=BRICK.vertices.T), "size_mismatch", "vertices: shape (3, "),
    "nothing": (CollisionBody(20, 20), "no_shape", "primitive, plane, vertices: "),
    "two shapes": (sphere(20, plane=plane(2).plane, is_static=True), "no_shape", "primitive, plane, vertices: "),
    "mesh and primitive": (TET._replace(primitive=sphere(1).primitive), "no_shape", "primitive, plane, vertices: "),
    "vertices alone": (CollisionBody(20, 20, vertices=np.arange(9.0)), "no_shape", "tetrahedra, triangles: "),
    "no vertices": (TET._replace(vertices=np.zeros(0)), "out_of_range", "tetrahedra"),
    "primitive type": (sphere(20, primitive=SolidPrimitive(5, (1.0,))), "out_of_range", "primitive.type"),
    "primitive missing": (sphere(20, primitive=None), "wrong_type", "primitive"),
    "sphere of no size": (sphere(20, primitive=SolidPrimitive(SPHERE, (0.0,))), "out_of_range", "primitive.dimensions"),
    "sphere of three": (sphere(20, primitive=SolidPrimitive(SPHERE, (1.0, 1.0, 1.0))), "size_mismatch", "dimensions"),
    "box of two": (box(20, primitive=SolidPrimitive(BOX, (1.0, 1.0))), "size_mismatch", "primitive.dimensions"),
    "box negative": (box(20, primitive=SolidPrimitive(BOX, (1.0, -1.0, 1.0))), "out_of_range", "primitive.dimensions"),
    "box nan": (box(20, primitive=SolidPrimitive(BOX, (1.0, NAN, 1.0))), "not_finite", "primitive.dimensions"),
    "box too large": (box(20, primitive=SolidPrimitive(BOX, (1e10, 1.0, 1.0))), "out_of_range", "dimensions"),
    "plane of three": (plane(20, plane=np.ones(3)), "size_mismatch", "plane"),
    "plane without normal": (plane(20, plane=np.array([0.0, 0.0, 0.0, 1.0])), "out_of_range", "plane"),
    "plane infinite": (plane(20, plane=np.array([0.0, 0.0, INF, 1.0])), "not_finite", "plane"),
    "plane out of sight": (plane(20, plane=np.array([0.0, 0.0, 1e-9, 10.0])), "out_of_range", "plane"),
    "plane that moves": (plane(20, is_static=False), "out_of_range", "is_static"),
    "density zero": (TET._replace(density=0.0), "out_of_range", "density"),
    "density nan": (TET._replace(density=NAN), "not_finite", "density"),
    "density huge": (TET._replace(density=1e300), "out_of_range", "density"),
    "density no number": (TET._replace(density="heavy"), "wrong_type", "density"),
    "friction negative": (TET._replace(friction=-0.1), "out_of_range", "friction"),
    "friction infinite": (TET._replace(friction=INF), "not_finite", "friction"),
    "restitution above one": (TET._replace(restitution=1.01), "out_of_range", "restitution"),
    "vertices not in threes": (TET._replace(vertices=TET.vertices[:-1]), "size_mismatch", "vertices"),
    "vertices nan": (TET._replace(vertices=with_entry(TET.vertices, 4, NAN)), "not_finite", "vertices: entry 4"),
    "vertices too far": (TET._replace(vertices=with_entry(TET.vertices, 4, 2e9)), "out_of_range", "vertices: entry 4"),
    "vertices text": (TET._replace(vertices=["a", "b", "c"]), "wrong_type", "vertices"),
    "vertices ragged": (TET._replace(vertices=[[0.0, 1.0], [2.0]]), "wrong_type", "vertices"),
    "body tiny": (TET._replace(vertices=1e-8 * TET.vertices), "out_of_range", "vertices"),
    "vertex unused": (TET._replace(vertices=np.append(TET.vertices, [9.0, 9.0, 9.0])), "bad_mesh", "vertices: vertex"),
    "tetrahedra not in fours": (TET._replace(tetrahedra=TET.tetrahedra[:-1]), "size_mismatch", "tetrahedra"),
    "tetrahedra out of range": (
        TET._replace(tetrahedra=with_entry(TET.tetrahedra, 5, len(BRICK.vertices))), "out_of_range", "tetrahedra: index"
    ),
    "tetrahedra negative": (TET._replace(tetrahedra=with_entry(TET.tetrahedra, 5, -1)), "out_of_range", "tetrahedra"),
    "tetrahedra of floats": (TET._replace(tetrahedra=TET.tetrahedra * 1.0), "wrong_type", "tetrahedra"),
    "tetrahedra flat": (TET._replace(vertices=FLAT_BRICK), "bad_mesh", "tetrahedron 0 is flat"),
    "tetrahedron inverted": (TET._replace(tetrahedra=INVERTED), "bad_mesh", "tetrahedron 0 is inverted"),
    "tetrahedron twice": (
        TET._replace(tetrahedra=np.append(TET.tetrahedra, [TET.tetrahedra[:4]] * 2)), "bad_mesh", "tetrahedra: the face"
    ),
    "tetrahedra folded over a face": (
        CollisionBody(20, 20, vertices=np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.2, 0.2, 0.5]]),
                      tetrahedra=np.array([[0, 1, 2, 3], [0, 1, 2, 4]])),
        "bad_mesh", "tetrahedra 0 and 1 lie on the same side of their face 0-1-2",
    ),
    "tetrahedra in two pieces": (TWO_BRICKS, "bad_mesh", "tetrahedra: the mesh falls into 2"),
    "triangles of another mesh": (TET._replace(triangles=np.array([0, 1, 2])), "bad_mesh", "triangles"),
    "triangles out of range": (TRI._replace(triangles=with_entry(TRI.triangles, 0, 8)), "out_of_range", "triangles"),
    "triangles not in threes": (TRI._replace(triangles=TRI.triangles[:-1]), "size_mismatch", "triangles"),
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
    "sequence negative": (TET._replace(sequence=-1), "out_of_range", "sequence"),
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
TURNED = np.concatenate([CUTS[:1, ::-1], CUTS[1:]]).ravel()
# the middle layer is one piece, so that the layers beside it are one label in two places
MIDDLE_LAYER = (BRICK.vertices[SECOND.nodes, 1] == 0.0).astype(np.int64)

ALONG = plane_along(*BRICK.vertices[CUTS[0]])

EVENTS = {
    "sequence gap": (SECOND._replace(sequence=3), "sequence_gap", "sequence: event 3 does not follow event 1"),
    "sequence zero": (SECOND._replace(sequence=0), "sequence_gap", "sequence"),
    "sequence no integer": (SECOND._replace(sequence=2.0), "wrong_type", "sequence"),
    "sequence repeated": (SECOND._replace(sequence=1), "sequence_repeat", "event 1 already"),
    "event repeated with another plane": (crack(1, 1, (10, 11), 0.11), "sequence_repeat", "event 1 already"),
    "body unknown": (SECOND._replace(body_id=9), "unknown_id", "body_id"),
    "body cannot break": (SECOND._replace(body_id=4, fragment_id=4), "rigid_body", "body_id"),
    "plane cannot break": (SECOND._replace(body_id=2, fragment_id=2), "rigid_body", "body_id"),
    "fragment unknown": (SECOND._replace(fragment_id=77), "unknown_id", "fragment_id"),
    "fragment of another body": (SECOND._replace(fragment_id=3), "unknown_id", "fragment_id"),
    "fragment retired": (SECOND._replace(fragment_id=1), "retired_id", "fragment_id"),
    "one piece": (SECOND._replace(new_fragment_ids=np.array([12])), "size_mismatch", "new_fragment_ids"),
    "no pieces": (SECOND._replace(new_fragment_ids=np.zeros(0, np.uint32)), "size_mismatch", "new_fragment_ids"),
    "new id twice": (SECOND._replace(new_fragment_ids=np.array([12, 12])), "doubled", "new_fragment_ids"),
    "new id taken": (SECOND._replace(new_fragment_ids=np.array([12, 3])), "doubled", "new_fragment_ids"),
    "new id retired": (SECOND._replace(new_fragment_ids=np.array([12, 1])), "doubled", "new_fragment_ids"),
    "new id too large": (SECOND._replace(new_fragment_ids=np.array([12, 2**32])), "out_of_range", "new_fragment_ids"),
    "more pieces than a run may have": (
        SECOND._replace(new_fragment_ids=np.arange(1000, 102_000)), "limit_exceeded", "new_fragment_ids"
    ),
    "node missing": (
        SECOND._replace(nodes=SECOND.nodes[1:], node_fragments=SECOND.node_fragments[1:]), "wrong_nodes", "nodes"
    ),
    "node twice": (SECOND._replace(nodes=with_entry(SECOND.nodes, 0, SECOND.nodes[1])), "doubled", "nodes"),
    "node of another fragment": (
        SECOND._replace(nodes=with_entry(SECOND.nodes, 0, STRANGER)), "wrong_nodes", f"nodes: node {STRANGER}"
    ),
    "node out of range": (
        SECOND._replace(nodes=with_entry(SECOND.nodes, 0, len(X))), "out_of_range", "nodes: index"
    ),
    "no nodes": (
        SECOND._replace(nodes=np.zeros(0, int), node_fragments=np.zeros(0, int)), "wrong_nodes", "nodes: 0 of"
    ),
    "label missing": (SECOND._replace(node_fragments=SECOND.node_fragments[1:]), "size_mismatch", "node_fragments"),
    "label out of range": (
        SECOND._replace(node_fragments=with_entry(SECOND.node_fragments, 0, 2)), "out_of_range", "node_fragments"
    ),
    "piece without node": (
        SECOND._replace(node_fragments=np.zeros(len(SECOND.nodes), int)), "empty_fragment", "node_fragments"
    ),
    "third piece without node": (
        SECOND._replace(new_fragment_ids=np.array([12, 13, 14])), "empty_fragment", "fragment 14"
    ),
    "piece in two": (SECOND._replace(node_fragments=MIDDLE_LAYER), "disconnected", "node_fragments: fragment 12"),
    "cut edges odd": (SECOND._replace(cut_edges=SECOND.cut_edges[1:]), "size_mismatch", "cut_edges"),
    "cut edge no edge": (SECOND._replace(cut_edges=np.append(NO_EDGE, CUTS[1:])), "no_edge", "cut_edges"),
    "cut edge to itself": (SECOND._replace(cut_edges=np.append([5, 5], CUTS[1:])), "no_edge", "cut_edges: 5-5"),
    "cut edge out of range": (
        SECOND._replace(cut_edges=with_entry(SECOND.cut_edges, 0, len(X))), "out_of_range", "cut_edges"
    ),
    "cut edge within a piece": (SECOND._replace(cut_edges=np.append(UNCUT, CUTS[1:])), "wrong_cut", "cut_edges"),
    "cut edge twice": (SECOND._replace(cut_edges=np.append(CUTS[1], CUTS[1:])), "doubled", "cut_edges"),
    "cut edge left out": (
        SECOND._replace(cut_edges=CUTS[1:].ravel(), cut_planes=PLANES[1:].ravel()), "wrong_cut", "is not cut"
    ),
    "no cut edges": (SECOND._replace(cut_edges=np.zeros(0, int), cut_planes=np.zeros(0)), "wrong_cut", "cut_edges"),
    "plane left out": (SECOND._replace(cut_planes=PLANES[1:].ravel()), "size_mismatch", "cut_planes"),
    "planes not in fours": (SECOND._replace(cut_planes=SECOND.cut_planes[1:]), "size_mismatch", "cut_planes"),
    "plane nan": (SECOND._replace(cut_planes=with_entry(SECOND.cut_planes, 3, NAN)), "not_finite", "cut_planes"),
    "plane not unit": (SECOND._replace(cut_planes=1.001 * SECOND.cut_planes), "not_unit", "cut_planes"),
    "plane of zeros": (SECOND._replace(cut_planes=0.0 * SECOND.cut_planes), "not_unit", "cut_planes"),
    "plane huge": (SECOND._replace(cut_planes=1e300 * SECOND.cut_planes), "not_unit", "cut_planes"),
    "plane beside its edge": (SECOND._replace(cut_planes=(PLANES * [1, 1, 1, 9]).ravel()), "missed_edge", "cut_planes"),
    "plane from second to first": (SECOND._replace(cut_planes=-SECOND.cut_planes), "missed_edge", "cut_planes"),
    "edge turned round": (SECOND._replace(cut_edges=TURNED), "missed_edge", "cut_planes"),
    "plane along its edge": (
        SECOND._replace(cut_planes=np.append(ALONG, PLANES[1:])), "missed_edge", "cut_planes: entry 0"
    ),
    "piece without volume": (
        OUTERMOST._replace(cut_planes=(OUTERMOST.cut_planes.reshape(-1, 4) * [1.0, 1.0, 1.0, 1.25]).ravel()),
        "no_volume", "cut_planes: fragment 13",
    ),
}  # fmt: skip


STATES = {
    "step negative": (REFERENCE._replace(step=-1), "out_of_range", "step"),
    "step too large": (REFERENCE._replace(step=2**64), "out_of_range", "step"),
    "sequence no integer": (REFERENCE._replace(fracture_sequence="1"), "wrong_type", "fracture_sequence"),
    "event to come": (REFERENCE._replace(fracture_sequence=2), "sequence_gap", "fracture_sequence: 2"),
    "bodies no integer": (REFERENCE._replace(body_sequence=1.0), "wrong_type", "body_sequence"),
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
    "fragment twice": (REFERENCE._replace(fragment_ids=with_entry(IDS, 0, 4)), "doubled", "fragment_ids"),
    "fragment ids of floats": (REFERENCE._replace(fragment_ids=IDS * 1.0), "wrong_type", "fragment_ids"),
    "fragment id too large": (
        REFERENCE._replace(fragment_ids=with_entry(IDS, 0, 2**32)), "out_of_range", "fragment_ids"
    ),
    "position missing": (REFERENCE._replace(positions=POSITIONS[3:]), "size_mismatch", "positions"),
    "positions not in threes": (REFERENCE._replace(positions=POSITIONS[1:]), "size_mismatch", "positions"),
    "position nan": (
        REFERENCE._replace(positions=with_entry(POSITIONS, 5, NAN)), "not_finite", "positions: entry 5"
    ),
    "position infinite": (
        REFERENCE._replace(positions=with_entry(POSITIONS, 5, -INF)), "not_finite", "positions: entry 5"
    ),
    "position out of the world": (
        REFERENCE._replace(positions=with_entry(POSITIONS, 5, 1e300)), "out_of_range", "positions: entry 5"
    ),
    "orientation missing": (REFERENCE._replace(orientations=TURNS[4:]), "size_mismatch", "orientations"),
    "orientation nan": (
        REFERENCE._replace(orientations=with_entry(TURNS, 0, NAN)), "not_finite", "orientations"
    ),
    "orientation of length 0": (
        REFERENCE._replace(orientations=with_entry(TURNS, 3, 0.0)), "not_unit", "fragment 3 has length 0"
    ),
    "orientation of length 2": (
        REFERENCE._replace(orientations=with_entry(TURNS, 7, 2.0)), "not_unit", "fragment 4 has length 2"
    ),
    "orientation huge": (
        REFERENCE._replace(orientations=with_entry(TURNS, 7, 1e200)), "not_unit", "orientations"
    ),
    "orientation a little off": (
        REFERENCE._replace(orientations=with_entry(TURNS, 3, 1.00001)), "not_unit", "orientations"
    ),
    "velocities of others": (
        REFERENCE._replace(linear_velocities=np.zeros(9)), "size_mismatch", "linear_velocities"
    ),
    "velocity nan": (
        REFERENCE._replace(linear_velocities=np.full(12, NAN)), "not_finite", "linear_velocities"
    ),
    "spins of others": (
        REFERENCE._replace(angular_velocities=np.zeros(15)), "size_mismatch", "angular_velocities"
    ),
    "spin infinite": (
        REFERENCE._replace(angular_velocities=np.full(12, INF)), "not_finite", "angular_velocities"
    ),
}  # fmt: skip


AHEAD = {"body to come", "event to come", "fragment to come", "fragment to come, other registry"}

"""What users of the Python face pass first: rows instead of flat arrays, other types, and faults with a remedy."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.gate_world import record_bytes

from fracture_collision import fracture
from fracture_collision.geometry.generators import brick
from fracture_collision.records import CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, InvalidMessage

MESH = brick((0.2, 0.1, 0.06), 0.05)
V, T = MESH.vertices, MESH.tetrahedra
BODY = CollisionBody(1, 1, vertices=V.ravel(), tetrahedra=T.astype(np.uint32).ravel())
EVENT = fracture.planes(BODY, (1.0, 0.0, 0.0), 0.01)
POSES = [[0.0, 0.0, 0.0], [0.0005, 0.0, 0.0]], [[0.0, 0.0, 0.0, 1.0]] * 2
FLOOR = CollisionBody(9, 90, plane=[0.0, 0.0, 1.0, 0.03], is_static=True)


def answer_and_digest(body: CollisionBody, event: FractureEvent, states: FragmentStates):
    world = CollisionWorld()
    for each in (body, FLOOR):
        world.add_body(each)
    world.add_fracture(event)
    answer = world.contacts(states)
    return record_bytes(answer), world.fragments().digest


def test_rows_lists_and_other_types_are_the_same_messages() -> None:
    positions, orientations = map(np.array, POSES)
    flat = answer_and_digest(
        BODY, EVENT, FragmentStates(1, 1, np.array([2, 3], np.uint32), positions.ravel(), orientations.ravel())
    )
    in_rows = EVENT._replace(cut_edges=EVENT.cut_edges.reshape(-1, 2), cut_planes=EVENT.cut_planes.reshape(-1, 4))
    as_lists = FractureEvent._make(v.tolist() if isinstance(v, np.ndarray) else v for v in in_rows)
    rows = BODY._replace(vertices=V, tetrahedra=T)
    lists = BODY._replace(vertices=V.tolist(), tetrahedra=T.tolist())
    fortran = BODY._replace(vertices=np.asfortranarray(V), tetrahedra=np.asfortranarray(T.astype(np.int64)))
    for body in (rows, lists, fortran):
        for event in (in_rows, as_lists):
            assert answer_and_digest(body, event, FragmentStates(1, 1, [2, 3], *POSES)) == flat
    single = BODY._replace(vertices=V.astype(np.float32).astype(np.float64))
    in_single = rows._replace(vertices=V.astype(np.float32))
    states = FragmentStates(1, 1, [2, 3], *POSES)
    assert answer_and_digest(in_single, EVENT, states) == answer_and_digest(single, EVENT, states)
    assert flat[0] and len(flat[1]) == 64


SPLIT = EVENT._replace(node_fragments=1 * (np.abs(V[:, 0]) > 0.06))
TURNED = EVENT._replace(cut_planes=-EVENT.cut_planes)
LONG = EVENT._replace(cut_planes=2.0 * EVENT.cut_planes)
BODIES = {
    r"vertices: shape \(3, 30\); pass shape \(n, 3\), or the same numbers flat": {"vertices": V.T},
    r"tetrahedra: shape \(4, 48\); pass shape \(n, 4\)": {"tetrahedra": T.T},
    r"vertices: shape \(10, 3, 3\); pass": {"vertices": V.reshape(10, 3, 3)},
    r"vertices: 89 numbers are not a multiple of 3": {"vertices": V.ravel()[:-1]},
    r"vertices: not an array of numbers; pass a numpy array, or a list without gaps": {"vertices": [[0, 1], [2]]},
    r"vertices: object instead of numbers; pass an array of float64": {"vertices": None},
    r"tetrahedra: float64 instead of integers; convert it, as by .astype\(numpy.uint32\)": {
        "tetrahedra": T.astype(float)
    },
    r"tetrahedra: index 30 .* is not below 30 vertices; the indices seem to start at 1: subtract 1": {
        "tetrahedra": T + 1
    },
    r"tetrahedra: index -1 \(entry 0\) is negative$": {"tetrahedra": np.where(T[0, 0] == T, -1, T)},
    r"tetrahedra: tetrahedron 0 is inverted .*; 48 of 48 are; exchange two corners of each": {
        "tetrahedra": T[:, [1, 0, 2, 3]]
    },
    r"vertices: vertex 30 belongs to no tetrahedron \(1 of 31 do not\); leave out unused .*numpy.unique": {
        "vertices": np.vstack((V, [(0.0, 0.0, 9.0)]))
    },
    r"tetrahedra: tetrahedron \d+ is flat .*; leave it out, or mesh the body again": {"vertices": V * (1, 1, 0)},
    r"tetrahedra: the face 0-\d+-\d+ belongs to 3 tetrahedra, not 1 or 2; some overlap": {
        "tetrahedra": np.vstack((T, T[:1]))
    },
    r"tetrahedra: tetrahedra 0 and 1 lie on the same side of their face 0-1-2, so they overlap .*move a vertex": {
        "vertices": [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.1, 0.1, 1.0), (0.3, 0.3, 0.5)],
        "tetrahedra": [(0, 1, 2, 3), (0, 1, 2, 4)],
    },
    r"vertices: the body is smaller than 1e-06 m; lengths are in metres": {"vertices": V * 1e-9},
    r"primitive, plane, vertices: .* this one has plane and vertices": {"plane": (0, 0, 1, 0), "is_static": True},
    r"primitive.dimensions: 2 numbers, not 3, the lengths of the edges": {
        "primitive": SolidPrimitive(1, (1.0, 1.0)), "vertices": [], "tetrahedra": [],
    },
    r"density: str instead of a number": {"density": "heavy"},
    r"body_id: float instead of an integer": {"body_id": 1.0},
    r"name: NoneType instead of a string": {"name": None},
    r"is_static: int instead of true or false": {"is_static": 1},
}  # fmt: skip
EVENTS = {
    r"node_fragments: fragment \d falls into pieces .*make each a fragment, as fracture_collision.fracture": SPLIT,
    r"cut_planes: entry 0 does not cross .* is -?\S+ m at node \d+ \(needed: at most 0\) and \S+ m at node": TURNED,
    r"cut_planes: the normal of entry 0 is of length 2, not 1; divide the four numbers by it": LONG,
    r"cut_edges: \d+-\d+ joins two of the new fragments but is not cut; list it": EVENT._replace(
        cut_edges=EVENT.cut_edges[1:], cut_planes=EVENT.cut_planes[1:]
    ),
    r"new_fragment_ids: fragment 1 already exists .* those above 1 are free": EVENT._replace(new_fragment_ids=[1, 2]),
    r"new_fragment_ids: 5 occurs more than once; list each once": EVENT._replace(new_fragment_ids=[5, 5]),
    r"new_fragment_ids: 1 of them; a fracture makes at least 2": EVENT._replace(new_fragment_ids=[2]),
    r"node_fragments: fragment 4 has no node: index 2 of new_fragment_ids does not occur": EVENT._replace(
        new_fragment_ids=[2, 3, 4]
    ),
    r"sequence: event 0 does not follow event 0": EVENT._replace(sequence=0),
    r"cut_planes: shape \(4, \d+\); pass shape \(n, 4\)": EVENT._replace(cut_planes=EVENT.cut_planes.reshape(-1, 4).T),
}
STATES = {
    r"orientations: the quaternion of fragment 1 has length 2, not 1; divide it by that, and order it x y z w": (
        [0, 0, 0], [2, 0, 0, 0],
    ),
    r"positions: 2 entries for 1 fragment_ids": ([[0, 0, 0]] * 2, [0, 0, 0, 1]),
    r"positions: shape \(3, 2\); pass shape \(n, 3\)": ([[0, 0], [0, 0], [0, 0]], [0, 0, 0, 1]),
}  # fmt: skip


@pytest.mark.parametrize("words", BODIES)
def test_rejected_bodies_say_what_to_pass(words: str) -> None:
    with pytest.raises(InvalidMessage, match="^" + words):
        CollisionWorld().add_body(BODY._replace(**BODIES[words]))


@pytest.mark.parametrize("words", EVENTS)
def test_rejected_events_say_what_to_pass(words: str) -> None:
    world = CollisionWorld()
    world.add_body(BODY)
    with pytest.raises(InvalidMessage, match="^" + words):
        world.add_fracture(EVENTS[words])


@pytest.mark.parametrize("words", STATES)
def test_rejected_states_say_what_to_pass(words: str) -> None:
    world = CollisionWorld()
    world.add_body(BODY)
    with pytest.raises(InvalidMessage, match="^" + words):
        world.contacts(FragmentStates(1, 0, [1], *STATES[words]))

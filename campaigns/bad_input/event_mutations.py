"""Possible faults of a FractureEvent."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds.gate_world import BRICK, EDGES, FIRST, SECOND, X, crack

from campaigns.bad_input.clean_scene import REMOVED
from campaigns.bad_input.mutations import (
    FINE,
    Mutation,
    Pick,
    Rules,
    float_mutations,
    identifier_type_mutations,
    index_mutations,
    mutation,
    one_of,
    value_mutations,
)

OUTERMOST = crack(2, 11, (12, 13), 0.4, above=0.1)
CUTS = ("cut_edges", "cut_planes")
LABELS = ("nodes", "node_fragments")
WRONG_CUTS = "wrong_cut no_edge doubled missed_edge size_mismatch out_of_range"


def _planes(record: Any) -> np.ndarray:
    return np.array(record.cut_planes).reshape(-1, 4)


def _labels(record: Any, pick: Pick) -> Any:
    """Random other labels, with the edges they cut, each at its middle."""
    count = len(record.new_fragment_ids)
    parts = np.array([pick(count) for _ in record.nodes])
    label = np.full(len(X), -1)
    label[record.nodes] = parts
    edges = EDGES[(label[EDGES] >= 0).all(axis=1) & (label[EDGES[:, 0]] != label[EDGES[:, 1]])]
    ends = BRICK.vertices[edges]
    normals = ends[:, 1] - ends[:, 0]
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    planes = np.column_stack([normals, (normals * ends.mean(axis=1)).sum(axis=1)])
    return record._replace(node_fragments=parts, cut_edges=edges.ravel(), cut_planes=planes.ravel())


def _label_turned(record: Any, pick: Pick) -> Any:
    parts = np.array(record.node_fragments)
    i = pick(len(parts))
    parts[i] = 1 - parts[i]
    return record._replace(node_fragments=parts)


def _without_node(record: Any, pick: Pick) -> Any:
    i = pick(len(record.nodes))
    return record._replace(nodes=np.delete(record.nodes, i), node_fragments=np.delete(record.node_fragments, i))


def _with_stranger(record: Any, pick: Pick) -> Any:
    strangers = np.setdiff1d(np.arange(len(X)), record.nodes)
    nodes = np.array(record.nodes)
    nodes[pick(len(nodes))] = strangers[pick(len(strangers))]
    return record._replace(nodes=nodes)


def _edges_by(record: Any, change) -> Any:
    edges = np.array(record.cut_edges).reshape(-1, 2)
    return record._replace(cut_edges=np.asarray(change(edges)).ravel())


def _not_an_edge(record: Any, pick: Pick) -> Any:
    known = set(map(tuple, EDGES.tolist()))
    while True:
        a, b = sorted((pick(len(X)), pick(len(X))))
        if (a, b) not in known:
            break
        pick = _next(pick)
    edges = np.array(record.cut_edges).reshape(-1, 2)
    edges[pick(len(edges))] = a, b
    return record._replace(cut_edges=edges.ravel())


def _next(pick: Pick) -> Pick:
    """Continues at random where a fuzzer's decisions are used up and all alike."""
    generator = np.random.default_rng(pick(2**32))
    return lambda below: int(generator.integers(below))


def _an_uncut_edge(record: Any, pick: Pick) -> Any:
    edges = np.array(record.cut_edges).reshape(-1, 2)
    uncut = EDGES[(X[EDGES] > 0.3).all(axis=1)]
    edges[pick(len(edges))] = uncut[pick(len(uncut))]
    return record._replace(cut_edges=edges.ravel())


def _an_edge_left_out(record: Any, pick: Pick) -> Any:
    edges, planes = np.array(record.cut_edges).reshape(-1, 2), _planes(record)
    i = pick(len(edges))
    return record._replace(cut_edges=np.delete(edges, i, 0).ravel(), cut_planes=np.delete(planes, i, 0).ravel())


def _an_edge_twice(record: Any, pick: Pick) -> Any:
    edges, planes = np.array(record.cut_edges).reshape(-1, 2), _planes(record)
    i = pick(len(edges))
    edges, planes = np.append(edges, edges[i : i + 1], 0), np.append(planes, planes[i : i + 1], 0)
    return record._replace(cut_edges=edges.ravel(), cut_planes=planes.ravel())


def _an_edge_turned(record: Any, pick: Pick) -> Any:
    i = pick(len(record.cut_edges) // 2)
    return _edges_by(record, lambda edges: np.concatenate([edges[:i], edges[i : i + 1, ::-1], edges[i + 1 :]]))


def _turned_with_its_plane(record: Any, pick: Pick) -> Any:
    i, planes = pick(len(record.cut_edges) // 2), _planes(record)
    planes[i] *= -1.0
    return _an_edge_turned(record, lambda _: i)._replace(cut_planes=planes.ravel())


def _plane(change):
    """`change` maps (plane (4,), its edge's ends (2, 3), pick) to another plane."""

    def of_record(record: Any, pick: Pick) -> Any:
        planes, edges = _planes(record), np.array(record.cut_edges).reshape(-1, 2)
        i = pick(len(planes))
        planes[i] = change(planes[i], BRICK.vertices[edges[i]], pick)
        return record._replace(cut_planes=planes.ravel())

    return of_record


def _beyond(plane: np.ndarray, ends: np.ndarray, pick: Pick) -> np.ndarray:
    at = (ends @ plane[:3])[pick(2)]
    side = 1.0 if at > plane[3] else -1.0
    return np.append(plane[:3], at + side * one_of((1e-6, 1e-3, 1.0, 1e300), pick))


def _along(plane: np.ndarray, ends: np.ndarray, pick: Pick) -> np.ndarray:
    """Rounding may make it cross: then both nodes count as pinched, and the crossing is one of the edge's points."""
    normal = np.cross(ends[1] - ends[0], [0.6, 0.8, 0.1])
    normal /= np.linalg.norm(normal)
    return np.append(normal, normal @ ends[0])


def _through_a_node(plane: np.ndarray, ends: np.ndarray, pick: Pick) -> np.ndarray:
    return np.append(plane[:3], (ends @ plane[:3])[pick(2)])


def _tilted(plane: np.ndarray, ends: np.ndarray, pick: Pick) -> np.ndarray:
    """Through a point of its edge, with a normal that is nearly parallel or nearly perpendicular to the edge."""
    along = (ends[1] - ends[0]) / np.linalg.norm(ends[1] - ends[0])
    across = np.cross(along, [0.6, 0.8, 0.1])
    normal = along * one_of((1e-12, 1e-6, 0.1, 1.0), pick) + across / np.linalg.norm(across)
    normal /= np.linalg.norm(normal)
    share = one_of((0.0, 1e-12, 0.5, 1.0 - 1e-12, 1.0), pick)
    return np.append(normal, normal @ (ends[0] + share * (ends[1] - ends[0])))


def _longer(*factors: float):
    return _plane(lambda plane, ends, pick: plane * one_of(factors, pick))


def _moved(record: Any, at: float) -> Any:
    planes = _planes(record)
    planes[:, 3] = planes[:, 0] * at
    return record._replace(cut_planes=planes.ravel())


def _of_body(*numbers: int):
    """A body that has one fragment, with the same number."""

    def change(record: Any, pick: Pick) -> Any:
        number = one_of(numbers, pick)
        return record._replace(body_id=number, fragment_id=number)

    return change


def _three_parts(record: Any, pick: Pick) -> Any:
    return record._replace(new_fragment_ids=np.append(record.new_fragment_ids, 14 + pick(20)))


EVENT_MUTATIONS: list[tuple[Any, Mutation]] = [(SECOND, each) for each in (
    *value_mutations("sequence", (0, 3, 4, 2**32, 2**63, 2**64 - 1), "sequence_gap", what="leaves a gap"),
    *value_mutations("sequence", (1,), "sequence_repeat", what="is another's"),
    *identifier_type_mutations("sequence", 64),
    *value_mutations("body_id", (0, 9, 20, 2**32 - 1), "unknown_id", what="is unknown"),
    *value_mutations("body_id", (2, 3, 4), "unknown_id", ("fragment_id",), what="is another's"),
    *value_mutations("body_id", (REMOVED,), "unknown_id", ("fragment_id",), what="was removed"),
    *identifier_type_mutations("body_id", 32),
    *value_mutations("fragment_id", (0, 77, 12, 2, 4, 2**32 - 1), "unknown_id", what="is unknown"),
    *value_mutations("fragment_id", (1,), "retired_id", what="broke before"),
    *value_mutations("fragment_id", (10,), "wrong_nodes", LABELS, what="is the neighbour's"),
    *identifier_type_mutations("fragment_id", 32),
    mutation("body_id", "of a body that cannot break", _of_body(2, 3, 4), "rigid_body"),
    mutation("body_id", "of a body that was removed", _of_body(REMOVED), FINE),
    *index_mutations("new_fragment_ids", Rules(1, "empty_fragment limit_exceeded doubled out_of_range size_mismatch",
                                               "", "doubled", names=("node_fragments",))),
    mutation("new_fragment_ids", "one exists", lambda r, p: r._replace(new_fragment_ids=np.array(
        [12, one_of((1, 2, 3, 4, REMOVED, 10, 11), p)])), "doubled"),
    mutation("new_fragment_ids", "one only", lambda r, p: r._replace(new_fragment_ids=np.array([12])), "size_mismatch"),
    mutation("new_fragment_ids", "more than the run may have", lambda r, p: r._replace(
        new_fragment_ids=np.arange(100, 134 + p(100))), "limit_exceeded"),
    mutation("new_fragment_ids", "one without a node", _three_parts, "empty_fragment", ("node_fragments",)),
    *index_mutations("nodes", Rules(1, "size_mismatch wrong_nodes doubled disconnected wrong_cut missed_edge",
                                    "out_of_range", "doubled wrong_nodes", names=("node_fragments", *CUTS))),
    *index_mutations("node_fragments", Rules(1, "size_mismatch disconnected empty_fragment wrong_cut missed_edge",
                                             "out_of_range", "empty_fragment disconnected wrong_cut missed_edge",
                                             names=CUTS)),
    *index_mutations("cut_edges", Rules(2, WRONG_CUTS, "out_of_range", WRONG_CUTS, names=CUTS)),
    *float_mutations("cut_planes", Rules(4, WRONG_CUTS, "not_unit missed_edge", "not_unit missed_edge", names=CUTS)),
    mutation("nodes", "one missing, with its label", _without_node, "wrong_nodes"),
    mutation("nodes", "one of another fragment", _with_stranger, "wrong_nodes"),
    mutation("nodes", "none at all", lambda r, p: r._replace(nodes=r.nodes[:0], node_fragments=r.nodes[:0]),
             "wrong_nodes"),
    mutation("node_fragments", "one the other way round", _label_turned, "disconnected wrong_cut", CUTS),
    mutation("node_fragments", "all one fragment's", lambda r, p: r._replace(
        node_fragments=np.full(len(r.nodes), p(2))), "empty_fragment"),
    mutation("node_fragments", "any, edges and planes to them", _labels,
             "disconnected empty_fragment no_volume", CUTS, True),
    mutation("cut_edges", "one that is none", _not_an_edge, "no_edge"),
    mutation("cut_edges", "one that is not cut", _an_uncut_edge, "wrong_cut doubled"),
    mutation("cut_edges", "one left out", _an_edge_left_out, "wrong_cut"),
    mutation("cut_edges", "one twice", _an_edge_twice, "doubled"),
    mutation("cut_edges", "one turned round", _an_edge_turned, "missed_edge", CUTS),
    mutation("cut_edges", "one turned round with its plane", _turned_with_its_plane, FINE),
    mutation("cut_edges", "none", lambda r, p: r._replace(cut_edges=r.cut_edges[:0], cut_planes=r.cut_planes[:0]),
             "wrong_cut"),
    mutation("cut_planes", "one beside its edge", _plane(_beyond), "missed_edge"),
    mutation("cut_planes", "one along its edge", _plane(_along), "missed_edge", may_pass=True),
    mutation("cut_planes", "one through a node", _plane(_through_a_node), FINE),
    mutation("cut_planes", "one tilted", _plane(_tilted), "missed_edge", may_pass=True),
    mutation("cut_planes", "one turned over", _longer(-1.0), "missed_edge"),
    mutation("cut_planes", "a normal not of unit length",
             _longer(0.0, 2.0, 1.0 + 1e-8, 1.0 - 1e-8, 1e-320, 1e150, 1e300), "not_unit"),
    mutation("cut_planes", "a normal of unit length but for rounding", _longer(1.0 + 1e-10, 1.0 - 1e-10), FINE),
    mutation("sequence", "the last one again", lambda r, p: FIRST, FINE),
    mutation("sequence", "the last one again, a bit of a plane flipped", lambda r, p: _moved(
        FIRST, np.nextafter(0.1, p(2))), "sequence_repeat"),
)] + [
    (OUTERMOST, mutation("cut_planes", "through all nodes of a fragment", lambda r, p: _moved(r, 0.5), "no_volume")),
    (OUTERMOST, mutation("cut_planes", "nearly through all nodes", lambda r, p: _moved(
        r, 0.5 - one_of((1e-3, 1e-9, 1e-11, 1e-16), p)), "no_volume", may_pass=True)),
]  # fmt: skip

"""Validation of fracture events: the fields one by one, then against the mesh and the labels of its nodes."""

from __future__ import annotations

import hashlib
from typing import NamedTuple, NoReturn

import numpy as np

from fracture_collision.core.bodies.collision_geometry import CollisionGeometry
from fracture_collision.core.mesh.tet_mesh import TetMesh
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import FractureEvent
from fracture_collision.world.gates.checks import (
    UINT64_MAX,
    each_once,
    floats,
    identifier,
    indices,
    refuse,
    same_length,
)
from fracture_collision.world.gates.fracture_match import (
    DOUBLED,
    EXTRA,
    FINE,
    MISSED,
    MISSING,
    NO_EDGE,
    first_crooked,
    first_split,
    match_cuts,
)

UNIT_TOLERANCE = 1e-9
# How far beyond an edge's end its plane may pass, as a share of the edge: rounding of a crack through a node.
CROSSING_TOLERANCE = 1e-9


class CheckedFracture(NamedTuple):
    """A valid fracture that fits its mesh."""

    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray  # (k,) int64
    nodes: np.ndarray  # (n,) int32, ascending
    parts: np.ndarray  # (n,) int32, index into new_fragment_ids
    edges: np.ndarray  # (e,) int32 mesh edges, ascending
    planes: np.ndarray  # (e, 4) float64, unit normal from the edge's smaller node to its larger, offset [m]
    digest: bytes


class FractureFields(NamedTuple):
    """A message whose fields are valid one by one."""

    sequence: int
    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray  # (k,) int64
    nodes: np.ndarray  # (n,) int64
    parts: np.ndarray  # (n,) int64, below k
    cut_edges: np.ndarray  # (e, 2) int64
    cut_planes: np.ndarray  # (e, 4)
    digest: bytes  # SHA-256 of the content, in message order


def read_fracture(event: FractureEvent) -> FractureFields:
    """Raise InvalidMessage unless each field by itself obeys the rules of FractureEvent.msg."""
    sequence = identifier("sequence", event.sequence, UINT64_MAX)
    body_id, fragment_id = identifier("body_id", event.body_id), identifier("fragment_id", event.fragment_id)
    new_ids = indices("new_fragment_ids", event.new_fragment_ids)
    if len(new_ids) < 2:
        refuse("size_mismatch", f"new_fragment_ids: {len(new_ids)} of them; a fracture makes at least 2 fragments")
    each_once("new_fragment_ids", new_ids)
    nodes = indices("nodes", event.nodes)
    parts = indices("node_fragments", event.node_fragments, 0, len(new_ids), "new fragments")
    same_length("node_fragments", parts, "nodes", len(nodes))
    each_once("nodes", nodes)
    edges = indices("cut_edges", event.cut_edges, 2)
    planes = floats("cut_planes", event.cut_planes, 4)
    same_length("cut_planes", planes, "cut edges", len(edges))
    crooked = first_crooked(planes, UNIT_TOLERANCE)
    if crooked >= 0:
        with np.errstate(over="ignore"):
            size = float(lengths(planes[crooked, :3]))
        refuse(
            "not_unit",
            f"cut_planes: the normal of entry {crooked} is of length {size:.9g}, not 1; divide the four numbers by it",
        )
    digest = hashlib.sha256()
    ids = np.array([sequence, body_id, fragment_id], np.uint64)
    for content in (ids, new_ids, nodes, parts, edges, planes):
        digest.update(len(content).to_bytes(8, "little"))
        digest.update(content.data)
    return FractureFields(
        sequence, body_id, fragment_id, new_ids, nodes, parts, edges, planes, digest.digest()
    )  # fmt: skip


def check_fracture(
    fields: FractureFields, mesh: TetMesh, node_fragment: np.ndarray, pinched: np.ndarray
) -> tuple[CheckedFracture, np.ndarray, np.ndarray]:
    """The checked fracture, the nodes pinched now, and the new fragments that may have no volume.

    Raises InvalidMessage unless the fields fit the mesh.

    node_fragment (n,): fragment id of each mesh node now; pinched (n,) uint8: the nodes that planes of earlier
    fractures pass through. The caller, which has the whole run, checks ids and the sequence.

    The space next to a node that no plane passes through belongs to the node's fragment. A fragment without such a node
    (indices into new_fragment_ids) has all its volume elsewhere, or none.
    """
    part_of_node = _labels(fields, mesh, node_fragment)
    between = _connected(fields, mesh, part_of_node)
    edges, planes, pinched_now = _cuts(fields, mesh, part_of_node, between)
    nodes = np.flatnonzero(part_of_node >= 0).astype(np.int32)
    checked = CheckedFracture(
        fields.body_id, fields.fragment_id, fields.new_fragment_ids, nodes, part_of_node[nodes], edges, planes,
        fields.digest,
    )  # fmt: skip
    pinched_now |= pinched
    free = np.bincount(checked.parts[pinched_now[nodes] == 0], minlength=len(fields.new_fragment_ids))
    return checked, pinched_now, np.flatnonzero(free == 0)


def refuse_without_volume(fragment_id: int) -> NoReturn:
    """Raise InvalidMessage: the planes of a fracture leave a new fragment no volume."""
    refuse("no_volume", f"cut_planes: fragment {fragment_id} has no volume: the planes pass through its nodes")


def apply_fracture(geometry: CollisionGeometry, row: int, event: CheckedFracture) -> int:
    """Break fragment `row`; returns the row of the first new one."""
    return geometry.apply_fracture(
        row, event.nodes, event.parts, event.edges, event.planes, len(event.new_fragment_ids)
    )


def fracture_of_removed_body(fields: FractureFields) -> CheckedFracture:
    """What the log keeps of an event whose body was removed: its place in the sequence, its ids, its digest."""
    none = np.zeros(0, np.int32)
    return CheckedFracture(
        fields.body_id, fields.fragment_id, fields.new_fragment_ids, none, none, none, np.zeros((0, 4)), fields.digest
    )


def without_content(event: CheckedFracture) -> CheckedFracture:
    """Likewise for an event that was accepted before its body was removed."""
    none = np.zeros(0, np.int32)
    return event._replace(nodes=none, parts=none, edges=none, planes=np.zeros((0, 4)))


def _labels(fields: FractureFields, mesh: TetMesh, node_fragment: np.ndarray) -> np.ndarray:
    """The part of each mesh node (n,) int32; -1: the node belongs to another fragment."""
    nodes = indices("nodes", fields.nodes, 0, len(mesh.nodes), "mesh nodes")
    fragment_id = fields.fragment_id
    strangers = np.flatnonzero(node_fragment[nodes] != fragment_id)
    if len(strangers):
        node = nodes[strangers[0]]
        refuse("wrong_nodes", f"nodes: node {node} belongs to fragment {node_fragment[node]}, not {fragment_id}")
    expected = int((node_fragment == fragment_id).sum())
    if len(nodes) != expected:
        refuse("wrong_nodes", f"nodes: {len(nodes)} of the {expected} nodes of fragment {fragment_id}; list all")
    part_of_node = np.full(len(mesh.nodes), -1, dtype=np.int32)
    part_of_node[nodes] = fields.parts
    return part_of_node


def _connected(fields: FractureFields, mesh: TetMesh, part_of_node: np.ndarray) -> int:
    """Number of mesh edges that join two new fragments; raises unless each new fragment is connected."""
    new_ids = fields.new_fragment_ids
    nodes_of = np.bincount(fields.parts, minlength=len(new_ids))
    if not nodes_of.all():
        empty = int(np.argmin(nodes_of))
        refuse(
            "empty_fragment",
            f"node_fragments: fragment {new_ids[empty]} has no node: index {empty} of new_fragment_ids does not occur",
        )
    split, between = first_split(mesh.edges, mesh.edges_begin, part_of_node, len(new_ids))
    if split >= 0:
        refuse(
            "disconnected",
            f"node_fragments: fragment {new_ids[split]} falls into pieces that no edge joins; make each a fragment, as "
            "fracture_collision.fracture.labels does",
        )
    return between


def _refuse_missed(plane: np.ndarray, edge: list[int], ends: np.ndarray, row: int) -> NoReturn:
    """Raise InvalidMessage: a plane (4,) does not cross its edge between two nodes at `ends` (2, 3)."""
    (a, b), (at_a, at_b) = edge, dots(ends, plane[:3]) - plane[3]
    refuse(
        "missed_edge",
        f"cut_planes: entry {row} does not cross its edge {a}-{b} from first to second: normal . x - offset is "
        f"{at_a:.6g} m at node {a} (needed: at most 0) and {at_b:.6g} m at node {b} (needed: more than 0)",
    )


def _cuts(
    fields: FractureFields, mesh: TetMesh, part_of_node: np.ndarray, between: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cut mesh edges, ascending (k,) int32, their planes (k, 4), and the nodes that these pinch (n,) uint8."""
    ends = indices("cut_edges", fields.cut_edges, 2, len(mesh.nodes), "mesh nodes")
    problem, row, found = match_cuts(mesh, part_of_node, between, ends, fields.cut_planes, CROSSING_TOLERANCE)
    if problem == MISSED:
        _refuse_missed(fields.cut_planes[row], ends[row].tolist(), mesh.nodes[ends[row]], row)
    if problem != FINE:
        a, b = ends[row] if problem == NO_EDGE else mesh.edges[row]
        kind, text = {
            NO_EDGE: ("no_edge", f"cut_edges: {a}-{b} (entry {row}) is not an edge of the mesh"),
            DOUBLED: ("doubled", f"cut_edges: {a}-{b} occurs more than once"),
            EXTRA: ("wrong_cut", f"cut_edges: {a}-{b} does not join two of the new fragments; leave it out"),
            MISSING: ("wrong_cut", f"cut_edges: {a}-{b} joins two of the new fragments but is not cut; list it"),
        }[problem]
        refuse(kind, text)
    return found.edges, found.planes, found.pinched

"""The gate for fracture events: the fields one by one, then against the mesh and the labels of its nodes."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from fracture_collision.core.tet_mesh import TetMesh
from fracture_collision.geometry.tetrahedra import connected_pieces
from fracture_collision.records import FractureEvent
from fracture_collision.world.checks import UINT64_MAX, each_once, floats, identifier, indices, refuse, same_length

UNIT_TOLERANCE = 1e-9
# How far beyond an edge's end, as a share of its length, its plane may pass: rounding of a crack through a node.
CROSSING_TOLERANCE = 1e-9


class CheckedFracture(NamedTuple):
    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray  # (k,) int64
    nodes: np.ndarray  # (n,) int32, ascending
    parts: np.ndarray  # (n,) int32, index into new_fragment_ids
    edges: np.ndarray  # (e,) int32 mesh edges, ascending
    planes: np.ndarray  # (e, 4) float64, unit normal from the edge's smaller node to its larger, offset [m]
    digest: bytes


class FractureFields(NamedTuple):
    """A message whose fields are in order one by one."""

    sequence: int
    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray  # (k,) int64
    nodes: np.ndarray  # (n,) int64
    parts: np.ndarray  # (n,) int64, below k
    cut_edges: np.ndarray  # (e, 2) int64
    cut_planes: np.ndarray  # (e, 4)
    digest: bytes  # SHA-256 of the content, in the order in which it came


def read_fracture(event: FractureEvent) -> FractureFields:
    """Raise InvalidMessage unless each field by itself keeps the rules of FractureEvent.msg."""
    ids = [identifier("sequence", event.sequence, UINT64_MAX)]
    ids += [identifier("body_id", event.body_id), identifier("fragment_id", event.fragment_id)]
    new_ids = indices("new_fragment_ids", event.new_fragment_ids)
    if len(new_ids) < 2:
        refuse("size_mismatch", f"new_fragment_ids: {len(new_ids)} fragments; a fracture makes at least 2")
    each_once("new_fragment_ids", new_ids)
    nodes = indices("nodes", event.nodes)
    parts = indices("node_fragments", event.node_fragments, 0, len(new_ids), "new fragments")
    same_length("node_fragments", parts, "nodes", len(nodes))
    each_once("nodes", nodes)
    edges = indices("cut_edges", event.cut_edges, 2)
    planes = floats("cut_planes", event.cut_planes, 4)
    same_length("cut_planes", planes, "cut edges", len(edges))
    length = np.linalg.norm(np.clip(planes[:, :3], -2.0, 2.0), axis=1)
    crooked = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)
    if len(crooked):
        refuse("not_unit", f"cut_planes: the normal of entry {crooked[0]} is not of length 1")
    digest = hashlib.sha256()
    for content in (np.array(ids, np.uint64), new_ids, nodes, parts, edges, planes):
        digest.update(len(content).to_bytes(8, "little") + content.tobytes())
    return FractureFields(*ids, new_ids, nodes, parts, edges, planes, digest.digest())


def check_fracture(fields: FractureFields, mesh: TetMesh, node_fragment: np.ndarray) -> CheckedFracture:
    """Raise InvalidMessage unless the fields fit the mesh; `node_fragment` (n,): fragment id of each mesh node now.

    Ids and the sequence are checked by the caller, who knows the whole run.
    """
    count = len(fields.new_fragment_ids)
    nodes, parts = _labels(fields, mesh, node_fragment)
    part_of_node = np.full(len(mesh.nodes), -1, dtype=np.int64)
    part_of_node[nodes] = parts
    _connected(mesh, part_of_node, count, fields.new_fragment_ids)
    edges, planes = _cuts(fields, mesh, part_of_node)
    return CheckedFracture(
        fields.body_id, fields.fragment_id, fields.new_fragment_ids,
        nodes.astype(np.int32), parts.astype(np.int32), edges.astype(np.int32), planes, fields.digest,
    )  # fmt: skip


def fracture_of_removed_body(fields: FractureFields) -> CheckedFracture:
    """What the log needs of an event whose body is gone: its place in the sequence, its ids, its digest."""
    none = np.zeros(0, np.int32)
    return CheckedFracture(
        fields.body_id, fields.fragment_id, fields.new_fragment_ids, none, none, none, np.zeros((0, 4)), fields.digest
    )


def _labels(fields: FractureFields, mesh: TetMesh, node_fragment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    nodes = indices("nodes", fields.nodes, 0, len(mesh.nodes), "mesh nodes")
    parts, fragment_id = fields.parts, fields.fragment_id
    strangers = np.flatnonzero(node_fragment[nodes] != fragment_id)
    if len(strangers):
        node = nodes[strangers[0]]
        refuse("wrong_nodes", f"nodes: node {node} belongs to fragment {node_fragment[node]}, not {fragment_id}")
    expected = int((node_fragment == fragment_id).sum())
    if len(nodes) != expected:
        refuse("wrong_nodes", f"nodes: {len(nodes)} of the {expected} nodes of fragment {fragment_id}")
    order = np.argsort(nodes, kind="stable")
    return nodes[order], parts[order]


def _connected(mesh: TetMesh, part_of_node: np.ndarray, count: int, new_ids: np.ndarray) -> None:
    empty = np.flatnonzero(np.bincount(part_of_node[part_of_node >= 0], minlength=count) == 0)
    if len(empty):
        refuse("empty_fragment", f"node_fragments: fragment {new_ids[empty[0]]} has no node")
    inside = part_of_node >= 0
    pieces = connected_pieces(mesh.edges, part_of_node)[inside]
    pairs = np.unique(np.stack([part_of_node[inside], pieces], axis=1), axis=0)
    split = np.flatnonzero(np.bincount(pairs[:, 0], minlength=count) > 1)
    if len(split):
        refuse("disconnected", f"node_fragments: fragment {new_ids[split[0]]} falls into pieces that no edge joins")


def _cuts(fields: FractureFields, mesh: TetMesh, part_of_node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ends = indices("cut_edges", fields.cut_edges, 2, len(mesh.nodes), "mesh nodes")
    planes = fields.cut_planes
    base = len(mesh.nodes)
    known = mesh.edges[:, 0].astype(np.int64) * base + mesh.edges[:, 1]
    keys = ends.min(axis=1) * base + ends.max(axis=1)
    edges = np.minimum(np.searchsorted(known, keys), len(known) - 1)
    stray = np.flatnonzero(known[edges] != keys)
    if len(stray):
        a, b = ends[stray[0]]
        refuse("no_edge", f"cut_edges: {a}-{b} (entry {stray[0]}) is no edge of the mesh")
    each_once("cut_edges", edges)
    parts = part_of_node[mesh.edges]
    must = np.flatnonzero((parts[:, 0] >= 0) & (parts[:, 1] >= 0) & (parts[:, 0] != parts[:, 1]))
    extra = np.setdiff1d(edges, must)
    if len(extra):
        a, b = mesh.edges[extra[0]]
        refuse("wrong_cut", f"cut_edges: {a}-{b} does not join two of the new fragments")
    if len(edges) != len(must):
        a, b = mesh.edges[np.setdiff1d(must, edges)[0]]
        refuse("wrong_cut", f"cut_edges: {a}-{b} joins two of the new fragments but is not cut")
    first, second = mesh.nodes[ends[:, 0]], mesh.nodes[ends[:, 1]]
    at_first = np.einsum("ij,ij->i", planes[:, :3], first) - planes[:, 3]
    at_second = np.einsum("ij,ij->i", planes[:, :3], second) - planes[:, 3]
    slack = CROSSING_TOLERANCE * np.linalg.norm(second - first, axis=1)
    missed = np.flatnonzero((at_first > slack) | (at_second < -slack) | (at_second - at_first <= 0.0))
    if len(missed):
        a, b = ends[missed[0]]
        refuse("missed_edge", f"cut_planes: entry {missed[0]} does not cross its edge {a}-{b} from first to second")
    _have_volume(fields, part_of_node, ends, np.stack([-at_first, at_second], axis=1) - slack[:, None])
    planes = np.where((ends[:, 0] > ends[:, 1])[:, None], -planes, planes)
    order = np.argsort(edges, kind="stable")
    return edges[order], np.ascontiguousarray(planes[order])


def _have_volume(fields: FractureFields, part_of_node: np.ndarray, ends: np.ndarray, room: np.ndarray) -> None:
    """A lone node with all planes through it has nothing of the body; room (k, 2) [m]: how far ends are from planes."""
    room_at = np.full(len(part_of_node), -np.inf)
    np.maximum.at(room_at, ends.ravel(), room.ravel())
    nodes_of = np.bincount(part_of_node[part_of_node >= 0], minlength=len(fields.new_fragment_ids))
    flat = np.flatnonzero((part_of_node >= 0) & (nodes_of[part_of_node] == 1) & (room_at <= 0.0))
    if len(flat):
        flat_id = fields.new_fragment_ids[part_of_node[flat[0]]]
        refuse("no_volume", f"cut_planes: fragment {flat_id} has no volume: all pass through its one node {flat[0]}")

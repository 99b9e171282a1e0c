"""The gate for fracture events, and the ledger of labels it checks them against."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

import numpy as np

from fracture_collision.core.tet_mesh import TetMesh
from fracture_collision.geometry.tetrahedra import connected_pieces
from fracture_collision.records import FractureEvent
from fracture_collision.world.checks import each_once, floats, identifier, indices, refuse, same_length

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


def check_fracture(event: FractureEvent, mesh: TetMesh, node_fragment: np.ndarray) -> CheckedFracture:
    """Raise InvalidMessage unless `event` keeps the rules; `node_fragment` (n,): fragment id of each mesh node now.

    Ids and the sequence are checked by the caller, who knows the whole run.
    """
    new_ids = indices("new_fragment_ids", event.new_fragment_ids)
    if len(new_ids) < 2:
        refuse("size_mismatch", f"new_fragment_ids: {len(new_ids)} fragments; a fracture makes at least 2")
    each_once("new_fragment_ids", new_ids)
    nodes, parts = _labels(event, mesh, node_fragment, len(new_ids))
    part_of_node = np.full(len(mesh.nodes), -1, dtype=np.int64)
    part_of_node[nodes] = parts
    _connected(mesh, part_of_node, len(new_ids), new_ids)
    edges, planes = _cuts(event, mesh, part_of_node)
    digest = hashlib.sha256()
    for content in (
        np.array([event.sequence, event.body_id, event.fragment_id], np.uint64), new_ids, nodes, parts, edges, planes,
    ):  # fmt: skip
        digest.update(len(content).to_bytes(8, "little") + content.tobytes())
    return CheckedFracture(
        int(event.body_id), int(event.fragment_id), new_ids,
        nodes.astype(np.int32), parts.astype(np.int32), edges.astype(np.int32), planes, digest.digest(),
    )  # fmt: skip


def _labels(
    event: FractureEvent, mesh: TetMesh, node_fragment: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    nodes = indices("nodes", event.nodes, 0, len(mesh.nodes), "mesh nodes")
    parts = indices("node_fragments", event.node_fragments, 0, count, "new fragments")
    same_length("node_fragments", parts, "nodes", len(nodes))
    each_once("nodes", nodes)
    fragment_id = identifier("fragment_id", event.fragment_id)
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


def _cuts(event: FractureEvent, mesh: TetMesh, part_of_node: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    ends = indices("cut_edges", event.cut_edges, 2, len(mesh.nodes), "mesh nodes")
    planes = floats("cut_planes", event.cut_planes, 4)
    same_length("cut_planes", planes, "cut edges", len(ends))
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
    length = np.linalg.norm(planes[:, :3], axis=1)
    crooked = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)
    if len(crooked):
        refuse("not_unit", f"cut_planes: the normal of entry {crooked[0]} has length {length[crooked[0]]:.12g}, not 1")
    first, second = mesh.nodes[ends[:, 0]], mesh.nodes[ends[:, 1]]
    at_first = np.einsum("ij,ij->i", planes[:, :3], first) - planes[:, 3]
    at_second = np.einsum("ij,ij->i", planes[:, :3], second) - planes[:, 3]
    slack = CROSSING_TOLERANCE * np.linalg.norm(second - first, axis=1)
    missed = np.flatnonzero((at_first > slack) | (at_second < -slack) | (at_second - at_first <= 0.0))
    if len(missed):
        a, b = ends[missed[0]]
        refuse("missed_edge", f"cut_planes: entry {missed[0]} does not cross its edge {a}-{b} from first node to second")
    planes = np.where((ends[:, 0] > ends[:, 1])[:, None], -planes, planes)
    order = np.argsort(edges, kind="stable")
    return edges[order], np.ascontiguousarray(planes[order])

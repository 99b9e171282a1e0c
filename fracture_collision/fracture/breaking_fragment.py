"""The fragment that is about to break: its part of the mesh, read from the body and the events before."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from fracture_collision.fracture.events import CrackedMesh, Naming, pinched_ends
from fracture_collision.fracture.pieces import inside_fragment
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.records import CollisionBody, FractureEvent

LARGEST_ID = 0xFFFFFFFF


class BreakingFragment(NamedTuple):
    """A living fragment of k nodes."""

    nodes: np.ndarray  # (k,) int64 mesh nodes, ascending
    points: np.ndarray  # (k, 3) float64 [m] their positions, body frame
    edges: np.ndarray  # (e, 2) int64 mesh edges with both ends in the fragment, which name its nodes 0 .. k - 1
    naming: Naming
    mesh: CrackedMesh  # of the whole body


def breaking_fragment(
    body: CollisionBody,
    fragment_id: int | None,
    after: FractureEvent | Iterable[FractureEvent],
    first_new_id: int | None,
) -> BreakingFragment:
    """The fragment `fragment_id` of `body` after the events `after`; raises ValueError that names the field."""
    points, tetrahedra = mesh_of(body)
    if not isinstance(after, Iterable):
        raise ValueError(f"after: {type(after).__name__} instead of the events so far; without any, leave it out")
    events = [after] if isinstance(after, FractureEvent) else list(after)
    owner = np.full(len(points), body.fragment_id, dtype=np.int64)
    for i, event in enumerate(events):
        if not isinstance(event, FractureEvent):
            raise ValueError(f"after[{i}]: {type(event).__name__} instead of a FractureEvent")
        if event.body_id == body.body_id:
            _apply(event, owner, f"after[{i}]")
    chosen = _chosen(fragment_id, owner, body.body_id)
    used = [body.fragment_id, *(int(np.max(event.new_fragment_ids)) for event in events)]
    first = max(used) + 1 if first_new_id is None else int(first_new_id)
    if first <= max(used) and first_new_id is not None:
        raise ValueError(f"first_new_id: {first} is not above {max(used)}, the largest fragment id so far")
    nodes, edges = inside_fragment(owner, unique_edges(tetrahedra), chosen)
    sequence = max((int(event.sequence) for event in events), default=0) + 1
    if first + len(nodes) > LARGEST_ID:
        raise ValueError(f"first_new_id: {first} leaves no room below {LARGEST_ID} for the new fragments")
    own_events = [event for event in events if event.body_id == body.body_id]
    pinched = [np.empty((0, 2), np.int64)]
    pinched += [pinched_ends(points, *_rows(event.cut_edges, event.cut_planes)) for event in own_events]
    mesh = CrackedMesh(points, tetrahedra, np.concatenate(pinched))
    return BreakingFragment(nodes, points[nodes], edges, Naming(sequence, body.body_id, chosen, first), mesh)


def _rows(cut_edges: np.ndarray, cut_planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return np.asarray(cut_edges, dtype=np.int64).reshape(-1, 2), np.asarray(cut_planes, np.float64).reshape(-1, 4)


def mesh_of(body: CollisionBody) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) float64 [m] and tetrahedra (m, 4) int64 of a body; raises ValueError that names the field."""
    if not isinstance(body, CollisionBody):
        raise ValueError(f"body: {type(body).__name__} instead of a CollisionBody")
    points, tetrahedra = np.asarray(body.vertices), np.asarray(body.tetrahedra)
    if not tetrahedra.size:
        raise ValueError("body: has no tetrahedra and cannot break; fracture_collision.meshing fills surfaces")
    for name, array, columns, kinds in (("vertices", points, 3, "fiu"), ("tetrahedra", tetrahedra, 4, "iu")):
        if array.dtype.kind not in kinds:
            raise ValueError(f"body.{name}: {array.dtype} instead of {'numbers' if 'f' in kinds else 'integers'}")
        if array.size % columns or (array.ndim != 1 and array.shape[1:] != (columns,)):
            raise ValueError(f"body.{name}: shape {array.shape}; needs (n, {columns}), or the same numbers flat")
    points = np.require(points, np.float64, ("C", "A", "W")).reshape(-1, 3)
    tetrahedra = np.require(tetrahedra, np.int64, ("C", "A", "W")).reshape(-1, 4)
    if not np.isfinite(points).all():
        raise ValueError("body.vertices: not all finite")
    if tetrahedra.min() < 0 or tetrahedra.max() >= len(points):
        worst = tetrahedra.min() if tetrahedra.min() < 0 else tetrahedra.max()
        raise ValueError(f"body.tetrahedra: index {worst} is not in 0 .. {len(points) - 1}; indices start at 0")
    return points, tetrahedra


def _apply(event: FractureEvent, owner: np.ndarray, name: str) -> None:
    nodes = np.asarray(event.nodes, dtype=np.int64)
    if len(nodes) and nodes.max() >= len(owner):
        raise ValueError(f"{name}.nodes: node {nodes.max()} is not in the body's mesh of {len(owner)} nodes")
    strangers = nodes[owner[nodes] != event.fragment_id]
    if len(strangers):
        raise ValueError(
            f"{name}.nodes: node {strangers[0]} belongs to fragment {owner[strangers[0]]}, not {event.fragment_id}; "
            "list all events of the body, in their order"
        )
    owner[nodes] = np.asarray(event.new_fragment_ids, dtype=np.int64)[np.asarray(event.node_fragments, dtype=np.int64)]


def _chosen(fragment_id: int | None, owner: np.ndarray, body_id: int) -> int:
    living = np.unique(owner)
    if fragment_id is None:
        if len(living) > 1:
            raise ValueError(f"fragment_id: body {body_id} has several fragments; choose one of {_listed(living)}")
        return int(living[0])
    if fragment_id not in living:
        raise ValueError(
            f"fragment_id: no living fragment {fragment_id} of body {body_id}; there are {_listed(living)}"
        )
    return int(fragment_id)


def _listed(ids: np.ndarray) -> str:
    return ", ".join(map(str, ids[:20].tolist())) + (", ..." if len(ids) > 20 else "")

"""The functions of `fracture_collision.fracture`: a body and a rule in, a FractureEvent out."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.fracture.pattern import (
    CROSSING_ROUNDING,
    CrackedMesh,
    Naming,
    Pattern,
    cells_of_seeds,
    draw_seeds,
    draw_warp,
    event_of,
    middle_planes,
    pinched_ends,
    without_flat_pieces,
)
from fracture_collision.fracture.pieces import connected_pieces, inside_fragment
from fracture_collision.geometry.tetrahedra import unique_edges
from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.portable_math import dots, lengths
from fracture_collision.records import CollisionBody, FractureEvent

CONCENTRATION = 1.0  # of random seeds around an impact: the density of seeds falls with this power of the distance
Events = FractureEvent | Iterable[FractureEvent]


def voronoi(
    body: CollisionBody,
    seeds: int | Sequence[Sequence[float]] | np.ndarray,
    random: int | np.random.Generator | None = None,
    curvature: float = 0.0,
    impact_point: Sequence[float] | np.ndarray | None = None,
    fragment_id: int | None = None,
    after: Events = (),
    first_new_id: int | None = None,
) -> FractureEvent:
    """Break a fragment into the Voronoi cells of `seeds`.

    body: a CollisionBody with tetrahedra. seeds: points (s, 3) [m] in the body frame, or their number; random ones lie
    near nodes of the mesh, denser around `impact_point` (3,) [m] if there is one. random: a number or a numpy
    Generator; needed where anything is random: seeds, or curved cracks. Equal arguments give equal events.

    curvature: 0 for flat cracks; 0.25 as in porcelain. It is the amplitude of the curves as a share of the distance
    between seeds, limited to about 0.25 by the fold of the crack.

    fragment_id: the fragment that breaks; by default the only one. after: the events of the run so far, in their order:
    the new event has the next `sequence`, and new fragments get the next ids, or are numbered from `first_new_id`. Pass
    it if other bodies of the world have fragment ids above that of this body.

    Raises ValueError that names the argument. A cell without a node has no effect, and a cell in several parts becomes
    several fragments, so the number of fragments may differ from that of the seeds.

    >>> from fracture_collision.fracture import voronoi
    >>> from fracture_collision.geometry.generators import brick
    >>> from fracture_collision.records import CollisionBody
    >>> mesh = brick((0.2, 0.1, 0.06), 0.02)
    >>> body = CollisionBody(body_id=1, fragment_id=1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    >>> halves = voronoi(body, seeds=[(-0.05, 0.0, 0.0), (0.05, 0.0, 0.0)])
    >>> halves.sequence, halves.fragment_id, halves.new_fragment_ids.tolist()
    (1, 1, [2, 3])
    >>> shards = voronoi(body, seeds=5, random=1, curvature=0.2, fragment_id=3, after=halves)
    >>> shards.sequence, shards.fragment_id, shards.new_fragment_ids.tolist()
    (2, 3, [4, 5, 6, 7, 8])
    """
    fragment = breaking_fragment(body, fragment_id, after, first_new_id)
    if not isinstance(curvature, int | float | np.number) or not 0.0 <= float(curvature) < np.inf:
        raise ValueError(f"curvature: {curvature!r} is not a number of at least 0")
    is_count = isinstance(seeds, int | np.integer) and not isinstance(seeds, bool)
    if random is None and (is_count or curvature > 0.0):
        what = "random seeds" if is_count else "curved cracks"
        raise ValueError(f"random: {what} need a number or a numpy Generator, for example random=1")
    try:
        generator = np.random.default_rng(random)
    except (TypeError, ValueError) as error:
        raise ValueError(f"random: {random!r} is neither a whole number >= 0 nor a numpy Generator") from error
    places = _random_seeds(fragment, seeds, impact_point, generator) if is_count else _rows("seeds", seeds, 3)
    if len(places) < 2:
        raise ValueError(f"seeds: {len(places)}; a fracture needs at least 2")
    warp = draw_warp(fragment.points, len(places), float(curvature), generator)
    pattern = cells_of_seeds(fragment.points, fragment.edges, places, warp, minimum_nodes=1)
    return _event(fragment, pattern, "seeds: all nodes of fragment {} lie in one cell; move the seeds, or add some")


def planes(
    body: CollisionBody,
    normals: Sequence[Any] | np.ndarray,
    offsets: float | Sequence[float] | np.ndarray,
    fragment_id: int | None = None,
    after: Events = (),
    first_new_id: int | None = None,
) -> FractureEvent:
    """Break a fragment along one plane or several: normal . x = offset in the body frame.

    normals: (3,) or (p, 3), of any length but 0; offsets: a number or (p,) [m] along the normal of unit length. A node
    on a plane belongs to the side that the normal points away from. `fragment_id`, `after` and `first_new_id` as in
    `voronoi`.

    Raises ValueError that names the argument, also if no plane separates nodes of the fragment. All planes are
    unbounded; to break only one of the pieces by the next plane, call again with its `fragment_id`.

    >>> from fracture_collision.fracture import planes
    >>> from fracture_collision.geometry.generators import brick
    >>> from fracture_collision.records import CollisionBody
    >>> mesh = brick((0.2, 0.1, 0.06), 0.02)
    >>> body = CollisionBody(body_id=1, fragment_id=1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    >>> planes(body, normals=(1.0, 0.0, 0.0), offsets=0.01).new_fragment_ids.tolist()
    [2, 3]
    >>> planes(body, normals=[(1, 0, 0), (1, 1, 0)], offsets=[-0.03, 0.03]).new_fragment_ids.tolist()
    [2, 3, 4]
    """
    fragment = breaking_fragment(body, fragment_id, after, first_new_id)
    directions = _rows("normals", normals, 3)
    distances = np.atleast_1d(_numbers("offsets", offsets))
    if distances.shape != (len(directions),):
        raise ValueError(f"offsets: shape {np.shape(offsets)} for {len(directions)} normals; needs one for each")
    length = lengths(directions)
    if (length == 0.0).any():
        raise ValueError(f"normals: row {int(np.argmin(length))} is (0, 0, 0) and has no direction")
    directions = directions / length[:, None]
    heights = dots(fragment.points[:, None], directions) - distances  # (k, p) above each plane
    rounding = CROSSING_ROUNDING * float(np.abs(fragment.points).max())
    heights = np.where(np.abs(heights) <= rounding, 0.0, heights)
    _, label = unique_rows(heights > 0.0)
    pieces, count, cut = connected_pieces(label, fragment.edges, 1)
    start, end = heights[cut[:, 0]], heights[cut[:, 1]]  # (c, p)
    # Where an edge crosses several planes, the crossing nearest to its middle counts.
    crosses = (start > 0.0) != (end > 0.0)
    beside = np.abs(start / np.where(crosses, start - end, 1.0) - 0.5)
    chosen = np.argmin(np.where(crosses, beside, np.inf), axis=1)
    upwards = np.where(np.take_along_axis(end, chosen[:, None], axis=1)[:, 0] > 0.0, 1.0, -1.0)
    cut_planes = upwards[:, None] * np.column_stack((directions, distances))[chosen]
    pattern = Pattern(pieces, count, cut, cut_planes) if count > 1 else None
    return _event(fragment, pattern, "offsets: no plane separates nodes of fragment {}")


def labels(
    body: CollisionBody,
    labels: Sequence[int] | np.ndarray,
    planes: Mapping[tuple[int, int], Sequence[float]] | None = None,
    fragment_id: int | None = None,
    after: Events = (),
    first_new_id: int | None = None,
) -> FractureEvent:
    """Break a fragment as `labels` say: an integer for each node of the body's mesh, (n,).

    Nodes of equal label that mesh edges connect are a fragment. Labels of nodes outside the breaking fragment have no
    effect. planes: for pairs of labels the plane between them, {(label, label): (nx, ny, nz, offset)} with
    n . x = offset [m] in the body frame, n of any length but 0 and either side. An edge that its pair's plane does not
    cross, or whose pair has no plane, is cut in its middle, at a right angle. `fragment_id`, `after` and `first_new_id`
    as in `voronoi`.

    Raises ValueError that names the argument, also if a plane crosses none of its pair's edges.

    >>> from fracture_collision.fracture import labels
    >>> from fracture_collision.geometry.generators import ball
    >>> from fracture_collision.records import CollisionBody
    >>> mesh = ball(0.1, 0.025)
    >>> body = CollisionBody(body_id=1, fragment_id=1, vertices=mesh.vertices, tetrahedra=mesh.tetrahedra)
    >>> event = labels(body, mesh.vertices[:, 2] > 0.03, planes={(0, 1): (0.0, 0.0, 1.0, 0.03)})
    >>> event.new_fragment_ids.tolist()
    [2, 3]
    """
    fragment = breaking_fragment(body, fragment_id, after, first_new_id)
    given = np.asarray(labels)
    node_count = np.asarray(body.vertices).size // 3
    if given.dtype.kind not in "iub" or given.shape != (node_count,):
        raise ValueError(
            f"labels: {given.dtype} of shape {given.shape}; needs an integer for each of the {node_count} nodes"
        )
    names, label = np.unique(given[fragment.nodes].astype(np.int64), return_inverse=True)
    pieces, count, cut = connected_pieces(label.ravel().astype(np.int64), fragment.edges, 1)
    if count < 2:
        return _event(fragment, None, "labels: the nodes of fragment {} have one label and are connected")
    start, end = fragment.points[cut[:, 0]], fragment.points[cut[:, 1]]
    cut_planes = middle_planes(start, end)
    ends = names[label.ravel()[cut]]  # (c, 2) labels
    for pair, plane in (planes or {}).items():
        _use_plane(pair, plane, (start, end, ends), cut_planes)
    return _event(fragment, Pattern(pieces, count, cut, cut_planes), "")


def _use_plane(pair: Any, plane: Any, edges: tuple[np.ndarray, ...], cut_planes: np.ndarray) -> None:
    """Write the plane of a pair of labels to the rows of `cut_planes` (c, 4) whose edges it crosses."""
    start, end, ends = edges
    if not isinstance(pair, tuple) or len(pair) != 2:
        raise ValueError(f"planes: {pair!r} is not a pair of labels, as in {{(0, 1): (nx, ny, nz, offset)}}")
    name = f"planes[{pair}]"
    (row,) = _rows(name, plane, 4)
    size = float(lengths(row[:3]))
    if size == 0.0:
        raise ValueError(f"{name}: the normal is (0, 0, 0) and has no direction")
    row = np.append(row[:3] / size, row[3] / size)
    between = ((ends == pair) | (ends == pair[::-1])).all(axis=1)
    low, high = dots(start, row[:3]) - row[3], dots(end, row[:3]) - row[3]
    upwards, downwards = between & (low <= 0.0) & (high > 0.0), between & (high <= 0.0) & (low > 0.0)
    if not (upwards | downwards).any():
        raise ValueError(f"{name}: crosses none of the {between.sum()} edges between nodes of these two labels")
    cut_planes[upwards], cut_planes[downwards] = row, -row


def _random_seeds(
    fragment: BreakingFragment, seeds: Any, impact_point: Any, generator: np.random.Generator
) -> np.ndarray:
    if seeds < 2:
        raise ValueError(f"seeds: {seeds}; a fracture needs at least 2")
    count = min(int(seeds), len(fragment.nodes))
    if impact_point is None:
        return draw_seeds(fragment.points, fragment.edges, np.zeros(3), count, 0.0, generator)
    (point,) = _rows("impact_point", impact_point, 3)
    return draw_seeds(fragment.points, fragment.edges, point, count, CONCENTRATION, generator)


def _event(fragment: BreakingFragment, pattern: Pattern | None, complaint: str) -> FractureEvent:
    """The event of a pattern whose pieces all have volume; ValueError with `complaint` if one piece is left."""
    if pattern is not None:
        pattern = without_flat_pieces(pattern, fragment.nodes, fragment.mesh)
        complaint = complaint or "labels: all pieces of fragment {} but one have no volume"
    if pattern is None or pattern.piece_count < 2:
        raise ValueError(complaint.format(fragment.naming.fragment_id))
    return event_of(pattern, fragment.nodes, fragment.naming)


def _rows(name: str, values: Any, columns: int) -> np.ndarray:
    """`values` as finite rows (n, columns); a single row may come flat."""
    array = _numbers(name, values)
    rows = array[None] if array.ndim == 1 else array
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise ValueError(f"{name}: shape {array.shape}; needs rows of {columns} numbers")
    return rows


def _numbers(name: str, values: Any) -> np.ndarray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}: not numbers: {error}") from None
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: not all finite")
    return array


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
    pinched += [pinched_ends(points, *_cut_rows(event.cut_edges, event.cut_planes)) for event in own_events]
    mesh = CrackedMesh(points, tetrahedra, np.concatenate(pinched))
    return BreakingFragment(nodes, points[nodes], edges, Naming(sequence, body.body_id, chosen, first), mesh)


def _cut_rows(cut_edges: np.ndarray, cut_planes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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

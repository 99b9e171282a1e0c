"""Voronoi fracture of one fragment of a tetrahedral mesh around an impact, and patterns as fracture events.

Seeds lie denser near the impact; each node joins the Voronoi cell of its nearest seed (ties: the lowest), and each part
of a cell connected along mesh edges is a new fragment. A seed without a node has no effect, so every fragment owns at
least one node: the rule of the virtual node algorithm (Molino, Bao, Fedkiw 2004) that Glondu 2014 builds on.

Each edge between two fragments gets a crack plane, the bisector of the two seeds. With `curvature`, distances are
measured in a smoothly warped space, phi(x) = x + A sin(K x + p), where bisectors are curved; the edge's plane is the
tangent plane of the bisector where it crosses the edge:

    f(x) = |phi(x) - phi(s)|^2 - |phi(x) - phi(t)|^2,   grad f = 2 phi'(x)^T (phi(t) - phi(s))
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.fracture.pieces import (
    bisector_crossings,
    connected_pieces,
    edge_lengths,
    nearest_seeds,
    range_between,
    seed_pairs,
    warped,
)
from fracture_collision.portable_math import cosine, dots, images, lengths, normal_numbers, power, products
from fracture_collision.records import FractureEvent, documented

# How far a plane may pass beyond an edge's end, as a share of the edge: a tenth of what the service accepts.
CROSSING_ROUNDING = 1e-10


@documented
class PatternSettings(NamedTuple):
    """How a material breaks; the scene file gives the reasons.

    Fields:
      seeds: seeds of the largest break
      seeds_per_overload: seeds of a blow, per multiple of the strength in its impulse, at least 2
      concentration: a node's weight as a seed falls with this power of its distance from the impact
      curvature: amplitude of the curves of cracks as a share of the distance between seeds; 0: flat cracks
      minimum_nodes: smaller pieces stay with the neighbour they share most edges with
    """

    seeds: int = 12
    seeds_per_overload: float = 4.0
    concentration: float = 1.0
    curvature: float = 0.0
    minimum_nodes: int = 4


class Pattern(NamedTuple):
    """Pieces of a fragment and the cuts between them; nodes by index within the fragment, planes in the body frame."""

    pieces: np.ndarray  # (k,) for each node of the fragment, the index of its piece: 0 .. piece_count - 1
    piece_count: int
    cut_edges: np.ndarray  # (c, 2) nodes
    cut_planes: np.ndarray  # (c, 4) unit normal from the first node to the second, and offset n.x [m]


class Warp(NamedTuple):
    """A smooth map of space, x + A sin(K x + p): the sum of three waves."""

    amplitudes: np.ndarray  # (3, 3) [m]
    waves: np.ndarray  # (3, 3) [1/m]
    phases: np.ndarray  # (3,)

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Images (n, 3) [m] of points (n, 3) [m]."""
        return warped(points, self.each)

    @property
    def each(self) -> tuple[tuple[float, ...], ...]:
        """As kernels take it: of each wave its amplitude, its K and its phase."""
        return tuple(tuple(wave) for wave in np.column_stack(self).tolist())

    def jacobians(self, points: np.ndarray) -> np.ndarray:
        """Derivatives d phi_i / d x_j at `points` (n, 3) [m]: (n, 3, 3)."""
        slopes = cosine(products(points, self.waves.T) + self.phases)
        return np.eye(3) + products(slopes[:, None, :] * self.amplitudes.T, self.waves)


def voronoi_pattern(
    points: np.ndarray,
    edges: np.ndarray,
    impact_point: np.ndarray,
    seed_count: int,
    settings: PatternSettings,
    generator: np.random.Generator,
) -> Pattern | None:
    """Break the fragment with nodes at `points` (k, 3) [m] near `impact_point` (3,) [m], both in the body frame.

    `edges` (e, 2) int64 are the mesh edges inside the fragment. Returns None if it holds together: fewer than two
    pieces of at least `settings.minimum_nodes`. Equal arguments and generator state give equal bytes.
    """
    seeds = draw_seeds(points, edges, impact_point, min(seed_count, len(points)), settings.concentration, generator)
    warp = draw_warp(points, len(seeds), settings.curvature, generator)
    return cells_of_seeds(points, edges, seeds, warp, settings.minimum_nodes)


def cells_of_seeds(
    points: np.ndarray, edges: np.ndarray, seeds: np.ndarray, warp: Warp | None, minimum_nodes: int
) -> Pattern | None:
    """Break the fragment into the cells of `seeds` (s, 3) [m], curved by `warp`; the rest as in `voronoi_pattern`."""
    places, centers = (points, seeds) if warp is None else (warp(points), warp(seeds))
    labels = nearest_seeds(places, centers)
    pieces, piece_count, cut = connected_pieces(labels, edges, minimum_nodes)
    if piece_count < 2:
        return None
    # From the lower seed to the higher, so that all edges between two seeds share one plane. No edge connects two
    # pieces of one seed, or they would be one.
    cut = np.where((labels[cut[:, 0]] > labels[cut[:, 1]])[:, None], cut[:, ::-1], cut)
    if warp is None:
        planes = _flat_planes(points, seeds, labels, cut)
    else:
        planes = _curved_planes(points, centers, labels, cut, warp)
    return Pattern(pieces, piece_count, cut, planes)


def draw_seeds(
    points: np.ndarray,
    edges: np.ndarray,
    impact_point: np.ndarray,
    count: int,
    concentration: float,
    generator: np.random.Generator,
) -> np.ndarray:
    """Nodes drawn with weights by distance from the impact, each moved by up to half an edge: no two distances tie."""
    edge_length = edge_lengths(points, edges).mean() if len(edges) else 0.0
    distance = lengths(points - impact_point)
    weights = power(distance + 2.0 * edge_length + np.finfo(float).tiny, -concentration)
    chosen = generator.choice(len(points), size=count, replace=False, p=weights / weights.sum())
    return points[chosen] + 0.5 * edge_length * generator.uniform(-1.0, 1.0, (count, 3))


def draw_warp(
    points: np.ndarray, seed_count: int, curvature: float, generator: np.random.Generator
) -> Warp | None:
    """Three waves as long as two cells; the amplitude stays below the fold, |A| |K| < 1. None for flat cracks."""
    if curvature <= 0.0 or seed_count < 2:
        return None
    _, across, along = np.sort(np.ptp(points, axis=0))
    # nodes on a line parallel to an axis have cells along that line
    cell = np.sqrt(across * along / seed_count) if across > 0.0 else along / seed_count
    directions = normal_numbers(generator, (2, 3, 3))
    directions /= lengths(directions)[..., None]
    wave_number = np.pi / cell
    amplitude = min(curvature * cell, 0.8 / wave_number) / 3.0
    return Warp(amplitude * directions[0], wave_number * directions[1], generator.uniform(0.0, 2.0 * np.pi, 3))


def _flat_planes(points: np.ndarray, seeds: np.ndarray, labels: np.ndarray, cut: np.ndarray) -> np.ndarray:
    pair, inverse = seed_pairs(labels, cut, len(seeds))
    normals = seeds[pair[:, 1]] - seeds[pair[:, 0]]
    normals /= lengths(normals)[:, None]
    offsets = dots(normals, 0.5 * (seeds[pair[:, 1]] + seeds[pair[:, 0]]))
    # Labels come from distances, sides from dot products; where rounding makes the two differ, the pair's plane moves
    # by that rounding, for all its edges alike.
    sides = images(points[cut], normals[inverse])
    highest_first, lowest_second = range_between(sides, inverse, len(pair))
    between = (highest_first <= offsets) & (offsets < lowest_second)
    offsets = np.where(between, offsets, 0.5 * (highest_first + lowest_second))
    planes = np.column_stack((normals, offsets))[inverse]
    # With seeds at nodes, both ends of an edge may be in the bisector: it is cut in its middle, at a right angle.
    start, end = points[cut[:, 0]], points[cut[:, 1]]
    slack = CROSSING_ROUNDING * lengths(end - start)
    low, high = sides[:, 0] - planes[:, 3], sides[:, 1] - planes[:, 3]
    crossed = (low <= slack) & (high >= -slack) & (high - low > slack)
    return np.where(crossed[:, None], planes, middle_planes(start, end))


def middle_planes(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Planes (c, 4) through the middles of edges from `start` to `end` (c, 3) [m], at right angles to them."""
    normals = (end - start) / lengths(end - start)[:, None]
    return np.column_stack((normals, dots(normals, 0.5 * (start + end))))


def _curved_planes(
    points: np.ndarray, warped_seeds: np.ndarray, labels: np.ndarray, cut: np.ndarray, warp: Warp
) -> np.ndarray:
    start, end = points[cut[:, 0]], points[cut[:, 1]]
    s, t = warped_seeds[labels[cut[:, 0]]], warped_seeds[labels[cut[:, 1]]]
    # Kept off the ends, so that a node stays on its own side of the plane.
    columns = (np.ascontiguousarray(rows.T) for rows in (start, end - start, s, t))
    shares = np.clip(bisector_crossings(*columns, warp.each), 1e-6, 1.0 - 1e-6)
    crossing = start + shares[:, None] * (end - start)
    normals = images(warp.jacobians(crossing).transpose(0, 2, 1), t - s)
    normals /= lengths(normals)[:, None]
    along = (end - start) / lengths(end - start)[:, None]
    # An edge that runs nearly within the bisector, or against it over a bulge, is cut at a right angle instead.
    grazing = dots(normals, along) < 0.05
    normals = np.where(grazing[:, None], along, normals)
    return np.column_stack((normals, dots(normals, crossing)))


# A crack no farther than this share of a cut edge from the edge's end counts as running through the node there: what it
# cuts off is no fragment to simulate.
AT_NODE = 1e-3


OTHER_CORNERS = np.array([(1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2)])


class CrackedMesh(NamedTuple):
    """A body's mesh of n nodes, with the cracks of earlier events."""

    points: np.ndarray  # (n, 3) float64 [m], body frame
    tetrahedra: np.ndarray  # (m, 4) int64
    pinched: np.ndarray  # (p, 2) int64, see pinched_ends


class Naming(NamedTuple):
    """The numbers of an event."""

    sequence: int
    body_id: int
    fragment_id: int  # that breaks
    first_new_id: int  # the new fragments are numbered from here


def event_of(pattern: Pattern, nodes: np.ndarray, naming: Naming) -> FractureEvent:
    """The event by which a fragment with mesh nodes (k,), numbered 0 .. k - 1 in `pattern`, breaks into its pieces."""
    return FractureEvent(
        sequence=naming.sequence,
        body_id=naming.body_id,
        fragment_id=naming.fragment_id,
        new_fragment_ids=(naming.first_new_id + np.arange(pattern.piece_count)).astype(np.uint32),
        nodes=nodes.astype(np.uint32),
        node_fragments=pattern.pieces.astype(np.uint32),
        cut_edges=nodes[pattern.cut_edges].astype(np.uint32),
        cut_planes=np.ascontiguousarray(pattern.cut_planes),
    )


def pinched_ends(points: np.ndarray, edges: np.ndarray, planes: np.ndarray) -> np.ndarray:
    """Ends (p, 2) of cut edges (c, 2) at which their planes (c, 4) pass: the node there first, the other end second.

    points (n, 3) [m]. The space beside such a node, along this edge, is not the node's.
    """
    sides = dots(points[edges], planes[:, None, :3]) - planes[:, 3:]
    slack = AT_NODE * lengths(points[edges[:, 1]] - points[edges[:, 0]])
    return np.concatenate((edges[sides[:, 0] >= -slack], edges[sides[:, 1] <= slack][:, ::-1]))


def without_flat_pieces(pattern: Pattern, nodes: np.ndarray, mesh: CrackedMesh) -> Pattern:
    """The pattern with each piece that has hardly any volume joined to the neighbour with which it shares most edges.

    A piece with mesh nodes (k,) is flat if cracks pass through all its nodes and, in each tetrahedron, cut off the
    corner there: a plane along a face of the body leaves such a piece behind it.
    """
    pieces, cut, planes = pattern.pieces, pattern.cut_edges, pattern.cut_planes
    new = pinched_ends(mesh.points[nodes], cut, planes)
    while True:
        pieces = _numbered(pieces)
        count = int(pieces.max()) + 1
        still = new[pieces[new[:, 0]] != pieces[new[:, 1]]]
        flat = _flat_pieces(pieces, nodes, mesh, np.concatenate((mesh.pinched, nodes[still])))
        ends = pieces[cut]
        if not len(flat) or count == 1:
            break
        beside = ends[(ends == flat[0]).any(axis=1) & (ends[:, 0] != ends[:, 1])]
        neighbours = np.where(beside[:, 0] == flat[0], beside[:, 1], beside[:, 0])
        pieces = np.where(pieces == flat[0], np.bincount(neighbours).argmax(), pieces)
    kept = ends[:, 0] != ends[:, 1]
    return Pattern(pieces, count, cut[kept], planes[kept])


def _flat_pieces(pieces: np.ndarray, nodes: np.ndarray, mesh: CrackedMesh, pinched: np.ndarray) -> np.ndarray:
    """The pieces, ascending, of which every node and every tetrahedron's corner is `pinched` (p, 2)."""
    is_pinched = np.zeros(len(mesh.points), np.bool_)
    is_pinched[pinched[:, 0]] = True
    free = np.bincount(pieces[~is_pinched[nodes]], minlength=int(pieces.max()) + 1)
    doubtful = np.flatnonzero(free == 0)
    if not len(doubtful):
        return doubtful
    piece_of_node = np.full(len(mesh.points), -1)
    piece_of_node[nodes] = pieces
    ends = mesh.tetrahedra[:, OTHER_CORNERS]  # (m, 4, 3) the ends of the three edges at each corner
    base = len(mesh.points)
    cut_off = np.isin(mesh.tetrahedra[:, :, None] * base + ends, pinched[:, 0] * base + pinched[:, 1]).any(axis=2)
    return np.setdiff1d(doubtful, piece_of_node[mesh.tetrahedra[~cut_off]])


def _numbered(pieces: np.ndarray) -> np.ndarray:
    """The pieces numbered 0, 1 ... in the order of their first nodes."""
    _, first, inverse = np.unique(pieces, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int64)
    rank[np.argsort(first, kind="stable")] = np.arange(len(first))
    return rank[inverse.ravel()]

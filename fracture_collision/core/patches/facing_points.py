"""Where the surfaces of two fragments face each other along a direction, and how far apart they are there.

Seen along n, from a to b, a face of a towards n and a face of b against it overlap in a polygon, on which their
distance along n is linear: it is least at the polygon's corners. These are corners of b over faces of a, corners of a
under faces of b, and crossings of edges. Edges and corners within flat or concave parts are nowhere outermost. So the
points found here contain the least distance of the two surfaces along n whatever their meshes, and moving b by minus
the least along n makes them disjoint. Surfaces that are nowhere over each other have no point.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel, query_kernel

# Faces at less than 3 degrees from along n have no distance along it; edges need only one side that faces, by a sine.
FACING, EDGE_FACING = 0.05, 0.02
# Edges that look nearly parallel, by the sine, do not cross: the corners at their ends do.
LEAST_CROSSING = 1e-4
# Points on a rim belong to both sides, up to this share of the smaller fragment's size.
ON_RIM = 1e-9
# Kinds of points.
OF_B, OF_A, CROSSING = 0, 1, 2
# Columns of _rows_of behind the box.
LOW, HIGH, CORNERS = 4, 5, 6
_CELLS_EACH = 1.0  # cells of the grid for each feature in it
_MOST_CELLS = 64  # along each side


class Posed(NamedTuple):
    """A Surface in the frame of the query."""

    corners: np.ndarray  # (c, 3) float64 [m]
    triangles: np.ndarray  # (t, 3) int32
    normals: np.ndarray  # (t, 3) float64
    edges: np.ndarray  # (e, 2) int32
    beside: np.ndarray  # (e, 2) int32
    is_sharp: np.ndarray  # (c,) bool


class FacingPoints(NamedTuple):
    """Points in no particular order; where several features meet, there are several."""

    points: np.ndarray  # (k, 3) float64 [m] on a
    gaps: np.ndarray  # (k,) float64 [m] from there to b along n
    features: np.ndarray  # (k, 3) int64: kind; row of the corner, or of a's edge and of b's


class _Seen(NamedTuple):
    """What of one fragment is over the other, and near enough; along n: columns u, v and height."""

    places: np.ndarray  # (c, 3) float64 [m] of all corners
    faces: np.ndarray  # (f,) int64 rows of triangles
    corners: np.ndarray  # (m,) int64
    edges: np.ndarray  # (e,) int64


class _View(NamedTuple):
    """What of both is looked at."""

    window: np.ndarray  # (6,) [m] of both: least and most along u, along v; then the lowest of b, the highest of a
    lowest: float  # [m] of gaps that count
    limit: np.ndarray  # (1,) [m] the highest of these; where only the least is asked for, the least so far
    rim: float  # [m] see ON_RIM
    is_of_least: bool  # only the least gap is asked for
    enough: float  # [m] and the search ends at one that is less than this


class _Grid(NamedTuple):
    """Features by the cells that their boxes seen along n meet."""

    low: tuple[float, float]
    per_cell: tuple[float, float]  # [1/m]
    cells: tuple[int, int]
    begin: np.ndarray  # (cells + 1,) int64
    entries: np.ndarray  # int64 number of the feature in its list


@kernel
def facing_points(a, b, n, gaps, size):
    """The FacingPoints of two Posed surfaces along a unit vector n, whose gap is between `gaps` (lowest, highest) [m].

    size [m]: of the smaller fragment.
    """
    axes = axes_along(n)
    view = _View(np.empty(6), gaps[0], np.array([gaps[1]]), ON_RIM * size, False, -math.inf)
    (points, gaps, features), count = _look(a, b, axes, view)
    for k in range(count):
        u, v, h = points[k, 0], points[k, 1], points[k, 2]
        for d in range(3):
            points[k, d] = u * axes[0, d] + v * axes[1, d] + h * axes[2, d]
    return FacingPoints(points[:count].copy(), gaps[:count].copy(), features[:count].copy())


@kernel
def overlap_along(a, b, n, lowest, most, size):
    """The largest overlap [m] of two Posed surfaces along a unit vector n, of those whose gap is no less than `lowest`.

    Once one exceeds `most` [m], that one is the answer. size [m]: of the smaller fragment.
    """
    view = _View(np.empty(6), lowest, np.zeros(1), ON_RIM * size, True, -most)
    _look(a, b, axes_along(n), view)
    return 0.0 - view.limit[0]


@kernel
def _look(a, b, axes, view):
    """The FacingPoints of two Posed surfaces along the last of the axes, places along these; and their number."""
    of_a, of_b, window, rim = seen_along(a.corners, axes), seen_along(b.corners, axes), view.window, view.rim
    box_a, box_b = box_around(of_a), box_around(of_b)
    for d in range(2):
        window[2 * d], window[2 * d + 1] = max(box_a[d], box_b[d]) - rim, min(box_a[3 + d], box_b[3 + d]) + rim
    window[4], window[5] = box_b[2], box_a[5]
    room = 1 if view.is_of_least else 64
    found, count = FacingPoints(np.empty((room, 3)), np.empty(room), np.empty((room, 3), np.int64)), 0
    if window[0] > window[1] or window[2] > window[3]:
        return found, count
    seen_a, seen_b = _near(a, of_a, axes[2], 1.0, view), _near(b, of_b, axes[2], -1.0, view)
    found, count = _corners_over(seen_b, seen_a, a.triangles, OF_B, view, found, count)
    found, count = _corners_over(seen_a, seen_b, b.triangles, OF_A, view, found, count)
    return _crossings(seen_a, a.edges, seen_b, b.edges, view, found, count)


@kernel
def box_around(places):
    """Least and most (6,) [m] of the columns of places (k, 3): an order of magnitude faster than min() of each."""
    box = np.array([math.inf, math.inf, math.inf, -math.inf, -math.inf, -math.inf])
    for k in range(len(places)):
        for d in range(3):
            box[d], box[3 + d] = min(box[d], places[k, d]), max(box[3 + d], places[k, d])
    return box


@kernel
def axes_along(n):
    """Rows: two unit vectors across n, and n."""
    axes, least = np.zeros((3, 3)), 0
    for d in range(1, 3):
        if abs(n[d]) < abs(n[least]):
            least = d
    i, j = (least + 1) % 3, (least + 2) % 3
    length = math.sqrt(n[i] * n[i] + n[j] * n[j])
    axes[0, i], axes[0, j] = n[j] / length, -n[i] / length
    for d in range(3):
        axes[2, d] = n[d]
    for d in range(3):
        p, q = (d + 1) % 3, (d + 2) % 3
        axes[1, d] = n[p] * axes[0, q] - n[q] * axes[0, p]
    return axes


@kernel
def seen_along(corners, axes):
    """Corners (c, 3) [m] along each of the axes."""
    seen = np.empty((len(corners), 3))
    for k in range(len(corners)):
        for d in range(3):
            seen[k, d] = corners[k, 0] * axes[d, 0] + corners[k, 1] * axes[d, 1] + corners[k, 2] * axes[d, 2]
    return seen


@kernel
def _near(posed, places, n, sign, view):
    """The _Seen of a fragment; sign: 1 for a, whose faces point along n, -1 for b.

    A feature of a can be within `limit` of b only if it is no more than that below the lowest of b, and conversely.
    """
    triangles, edges = posed.triangles, posed.edges
    window = view.window
    least = sign * window[4 if sign > 0.0 else 5] - view.limit[0]
    beyond = np.empty(len(places), np.uint8)  # a bit for each side of what is looked at
    for k in range(len(places)):
        u, v, h = places[k, 0], places[k, 1], sign * places[k, 2]
        beyond[k] = (u < window[0]) | ((u > window[1]) << 1) | ((v < window[2]) << 2) | ((v > window[3]) << 3)
        beyond[k] |= (h < least) << 4
    faces, faces_used, touches = np.empty(len(triangles), np.int64), 0, np.zeros(len(places), np.bool_)
    for t in range(len(triangles)):
        i, j, k = triangles[t]
        if beyond[i] & beyond[j] & beyond[k] == 0 and sign * _along(posed.normals[t], n) > FACING:
            faces[faces_used] = t
            faces_used += 1
            touches[i] = touches[j] = touches[k] = True
    corners, corners_used = np.empty(len(places), np.int64), 0
    for k in range(len(places)):
        if touches[k] and posed.is_sharp[k] and beyond[k] == 0:
            corners[corners_used] = k
            corners_used += 1
    chosen, edges_used = np.empty(len(edges), np.int64), 0
    for e in range(len(edges)):
        if beyond[edges[e, 0]] & beyond[edges[e, 1]]:
            continue
        one, other = posed.normals[posed.beside[e, 0]], posed.normals[posed.beside[e, 1]]
        if max(sign * _along(one, n), sign * _along(other, n)) > EDGE_FACING:
            chosen[edges_used] = e
            edges_used += 1
    return _Seen(places, faces[:faces_used], corners[:corners_used], chosen[:edges_used])


@query_kernel
def _along(m, n):
    return m[0] * n[0] + m[1] * n[1] + m[2] * n[2]


@kernel
def _rows_of(places, rows, chosen, corners, rim):
    """What is read of features `chosen` (k,) of `rows`, which have so many corners each, one after the other.

    (k, 6 + 3 corners) [m]: the box seen along n, wider by `rim`, least and most height, and the corners.
    """
    out = np.empty((len(chosen), CORNERS + 3 * corners))
    for k in range(len(chosen)):
        low_u = low_v = low = math.inf
        high_u = high_v = high = -math.inf
        for i in range(corners):
            c = rows[chosen[k], i]
            u, v, h = places[c, 0], places[c, 1], places[c, 2]
            low_u, high_u = min(low_u, u), max(high_u, u)
            low_v, high_v = min(low_v, v), max(high_v, v)
            low, high = min(low, h), max(high, h)
            out[k, CORNERS + 3 * i], out[k, CORNERS + 3 * i + 1], out[k, CORNERS + 3 * i + 2] = u, v, h
        out[k, 0], out[k, 1], out[k, 2], out[k, 3] = low_u - rim, high_u + rim, low_v - rim, high_v + rim
        out[k, LOW], out[k, HIGH] = low, high
    return out


@kernel
def _grid_of(rows, window):
    """The _Grid of features (k,), see _rows_of."""
    wide, high = window[1] - window[0], window[3] - window[2]
    along = math.sqrt(max(_CELLS_EACH * len(rows), 1.0))
    nu = min(max(int(along * math.sqrt(wide / high)), 1), _MOST_CELLS) if high > 0.0 and wide > 0.0 else 1
    nv = min(max(int(along * math.sqrt(high / wide)), 1), _MOST_CELLS) if high > 0.0 and wide > 0.0 else 1
    per_cell = (nu / wide if wide > 0.0 else 0.0), (nv / high if high > 0.0 else 0.0)
    grid = _Grid((window[0], window[2]), per_cell, (nu, nv), np.zeros(nu * nv + 1, np.int64), np.empty(0, np.int64))
    for turn in range(2):
        if turn == 1:
            total = 0
            for c in range(nu * nv + 1):
                total, grid.begin[c] = total + grid.begin[c], total
            entries = np.empty(total, np.int64)
        for k in range(len(rows)):
            i0, i1 = _cell(grid, 0, rows[k, 0]), _cell(grid, 0, rows[k, 1])
            j0, j1 = _cell(grid, 1, rows[k, 2]), _cell(grid, 1, rows[k, 3])
            for i in range(i0, i1 + 1):
                for j in range(j0, j1 + 1):
                    if turn == 1:
                        entries[grid.begin[i * nv + j]] = k
                    grid.begin[i * nv + j] += 1
    for c in range(nu * nv, 0, -1):
        grid.begin[c] = grid.begin[c - 1]
    grid.begin[0] = 0
    return _Grid(grid.low, grid.per_cell, grid.cells, grid.begin, entries)


@query_kernel
def _cell(grid, d, x):
    return min(max(int((x - grid.low[d]) * grid.per_cell[d]), 0), grid.cells[d] - 1)


@kernel
def _corners_over(of, over, triangles, kind, view, found, count):
    """Add the corners of one _Seen, of a `kind`, that are over faces of the other; returns as _add."""
    limit, rim = view.limit, view.rim
    sign = 1.0 if kind == OF_B else -1.0
    if len(of.corners) == 0 or len(over.faces) == 0 or limit[0] < view.enough:
        return found, count
    faces = _rows_of(over.places, triangles, over.faces, 3, rim)
    grid = _grid_of(faces, view.window)
    for k in range(len(of.corners)):
        corner = of.corners[k]
        u, v, h = of.places[corner, 0], of.places[corner, 1], of.places[corner, 2]
        c = _cell(grid, 0, u) * grid.cells[1] + _cell(grid, 1, v)
        for entry in range(grid.begin[c], grid.begin[c + 1]):
            t = grid.entries[entry]
            if u < faces[t, 0] or u > faces[t, 1] or v < faces[t, 2] or v > faces[t, 3]:
                continue
            least, most = sign * (h - faces[t, HIGH]), sign * (h - faces[t, LOW])
            if min(least, most) > limit[0] or max(least, most) < view.lowest:
                continue
            is_over, height = _height_at(faces, t, u, v, rim)
            if not is_over:
                continue
            gap = sign * (h - height)
            if gap <= limit[0]:
                on_a = height if kind == OF_B else h
                found, count = _add(view, found, count, (u, v, on_a, gap), (kind, corner, 0))
                if limit[0] < view.enough:
                    return found, count
    return found, count


@query_kernel
def _length(u, v):
    return math.sqrt(u * u + v * v)


@query_kernel
def _height_at(faces, t, u, v, rim):
    """(whether u, v is over a face, or beyond a side by no more than `rim`; the face's height there); see _rows_of."""
    b, c = CORNERS + 3, CORNERS + 6
    au, av, ah = faces[t, CORNERS], faces[t, CORNERS + 1], faces[t, CORNERS + 2]
    ub, vb, uc, vc = faces[t, b] - au, faces[t, b + 1] - av, faces[t, c] - au, faces[t, c + 1] - av
    area = ub * vc - uc * vb
    if area == 0.0:
        return False, 0.0
    size = abs(area)
    pu, pv = u - au, v - av
    of_b, of_c = (pu * vc - uc * pv) / area, (ub * pv - pu * vb) / area
    of_a = 1.0 - of_b - of_c
    if of_b * size < -rim * _length(uc, vc) or of_c * size < -rim * _length(ub, vb):
        return False, 0.0
    if of_a * size < -rim * _length(faces[t, b] - faces[t, c], faces[t, b + 1] - faces[t, c + 1]):
        return False, 0.0
    of_b, of_c = min(max(of_b, 0.0), 1.0), min(max(of_c, 0.0), 1.0)
    height = ah + of_b * (faces[t, b + 2] - ah) + of_c * (faces[t, c + 2] - ah)
    return True, min(max(height, faces[t, LOW]), faces[t, HIGH])


@kernel
def _crossings(of_a, edges_a, of_b, edges_b, view, found, count):
    """Add the crossings of edges of both; returns as _add."""
    limit, rim = view.limit, view.rim
    if len(of_a.edges) == 0 or limit[0] < view.enough or len(of_b.edges) == 0:
        return found, count
    mine = _rows_of(of_a.places, edges_a, of_a.edges, 2, rim)
    others = _rows_of(of_b.places, edges_b, of_b.edges, 2, rim)
    grid = _grid_of(others, view.window)
    for i in range(len(mine)):
        low_u, high_u, low_v, high_v = mine[i, 0], mine[i, 1], mine[i, 2], mine[i, 3]
        low, high = mine[i, LOW], mine[i, HIGH]
        for cu in range(_cell(grid, 0, low_u), _cell(grid, 0, high_u) + 1):
            for cv in range(_cell(grid, 1, low_v), _cell(grid, 1, high_v) + 1):
                c = cu * grid.cells[1] + cv
                for entry in range(grid.begin[c], grid.begin[c + 1]):
                    j = grid.entries[entry]
                    if low_u > others[j, 1] or high_u < others[j, 0] or low_v > others[j, 3] or high_v < others[j, 2]:
                        continue
                    if others[j, LOW] - high > limit[0] or others[j, HIGH] - low < view.lowest:
                        continue
                    # two boxes may share several cells: the one at the lower corner of their overlap counts
                    u, v = max(low_u, others[j, 0]), max(low_v, others[j, 2])
                    if _cell(grid, 0, u) != cu or _cell(grid, 1, v) != cv:
                        continue
                    crosses, u, v, height, gap = _crossing(mine, i, others, j, rim)
                    if crosses and gap <= limit[0]:
                        feature = CROSSING, of_a.edges[i], of_b.edges[j]
                        found, count = _add(view, found, count, (u, v, height, gap), feature)
                        if limit[0] < view.enough:
                            return found, count
    return found, count


@query_kernel
def _crossing(a, i, b, j, rim):
    """Whether rows of two _rows_of cross as seen, where (u, v), the first's height there, and the other's above it."""
    p, q = CORNERS, CORNERS + 3
    ua, va, ub, vb = a[i, q] - a[i, p], a[i, q + 1] - a[i, p + 1], b[j, q] - b[j, p], b[j, q + 1] - b[j, p + 1]
    area = ua * vb - va * ub
    length_a, length_b = _length(ua, va), _length(ub, vb)
    if abs(area) <= LEAST_CROSSING * length_a * length_b:
        return False, 0.0, 0.0, 0.0, 0.0
    wu, wv = b[j, p] - a[i, p], b[j, p + 1] - a[i, p + 1]
    on_a, on_b = (wu * vb - wv * ub) / area, (wu * va - wv * ua) / area
    if min(on_a, 1.0 - on_a) * length_a < -rim or min(on_b, 1.0 - on_b) * length_b < -rim:
        return False, 0.0, 0.0, 0.0, 0.0
    on_a, on_b = min(max(on_a, 0.0), 1.0), min(max(on_b, 0.0), 1.0)
    height = a[i, p + 2] + on_a * (a[i, q + 2] - a[i, p + 2])
    other = b[j, p + 2] + on_b * (b[j, q + 2] - b[j, p + 2])
    return True, a[i, p] + on_a * ua, a[i, p + 1] + on_a * va, height, other - height


@kernel
def _add(view, found, count, point, feature):
    """Write a point; returns (the FacingPoints, which may be larger ones, number of points)."""
    points, gaps, features = found
    if point[3] < view.lowest:
        return found, count
    if view.is_of_least:
        view.limit[0] = point[3]
        return found, count
    if count == len(gaps):
        points = np.vstack((points, np.empty((count, 3))))
        gaps = np.append(gaps, np.empty(count))
        features = np.vstack((features, np.empty((count, 3), np.int64)))
    points[count, 0], points[count, 1], points[count, 2] = point[0], point[1], point[2]
    gaps[count] = point[3]
    features[count, 0], features[count, 1], features[count, 2] = feature
    return FacingPoints(points, gaps, features), count + 1

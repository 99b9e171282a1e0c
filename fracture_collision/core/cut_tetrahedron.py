"""A tetrahedron shared by several fragments: who owns a point, and the exact polygons between the owners.

The margin rule (docs/numerics.md). Each fragment f with a node in the tetrahedron has a margin at x: the smallest
signed distance to the planes of the tetrahedron's cut edges between f and another fragment, positive on f's side. The
point belongs to the largest margin. For consistent planes (bisectors of a Voronoi pattern) that is the exact cell; for
any planes it is a partition. Glondu 2014, sections 4.1 and 4.3 store the planes and ask the question; the rule for
several planes in one tetrahedron is ours.

Symbols: slot k = one distinct fragment of the (up to) four nodes; g = (nx, ny, nz, o) a linear functional n.x - o;
M_k = min over the functionals of slot k.

The polygons: for each choice of the functional that attains every slot's minimum, the set where the choice holds is
convex and all margins are linear on it. So the interface of slots f and g is the plane M_f = M_g clipped by that set
and by M_f >= M_h for the other slots h, and a face of the tetrahedron clipped likewise is f's share of that face. What
the tetrahedron behind the face gives to another fragment, of that share, is a step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.compiled import inlined_kernel, kernel, query_kernel
from fracture_collision.core.margin_clipping import clip_to_choice, clip_to_region, tie_limit

EDGE_FIRST = np.array([0, 0, 0, 1, 1, 2])
EDGE_SECOND = np.array([1, 2, 3, 2, 3, 3])
# Face k lies opposite vertex k, counter-clockwise from outside for a tetrahedron of positive volume.
FACE_VERTICES = np.array([[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]])
INTERFACE = 4  # kind of a triangle between two fragments; 0..3: on that face
MAX_TRIANGLES = 4096  # more than any choice of planes was seen to make (below 200); exceeding it raises


class CutScratch(NamedTuple):
    """Working space: one tetrahedron's margins, and the triangles made from them."""

    labels: np.ndarray  # (4,) int64 fragment of each slot
    functionals: np.ndarray  # (4, 4, 4) float64
    counts: np.ndarray  # (4,) int64 functionals of each slot
    corners: np.ndarray  # (4, 3) float64 [m]
    triangles: np.ndarray  # (MAX_TRIANGLES, 9) float64 [m]
    fronts: np.ndarray  # (MAX_TRIANGLES,) int64 slot
    backs: np.ndarray  # (MAX_TRIANGLES,) int64 slot, -1 at a face's share
    kinds: np.ndarray  # (MAX_TRIANGLES,) int64
    polygon: np.ndarray  # (32, 3) float64 [m]
    spare: np.ndarray  # (32, 3) float64 [m]
    choice: np.ndarray  # (4,) int64
    value: np.ndarray  # (4,) float64
    order: np.ndarray  # (4,) int64
    heights: np.ndarray  # (4, 4, 32) float64 [m] of each functional at a polygon's vertices
    origin: np.ndarray  # (4,) int64 of confined margins: which slots they were


@kernel
def make_cut_scratch():
    return CutScratch(
        np.zeros(4, np.int64), np.zeros((4, 4, 4)), np.zeros(4, np.int64), np.zeros((4, 3)),
        np.empty((MAX_TRIANGLES, 9)), np.empty(MAX_TRIANGLES, np.int64), np.empty(MAX_TRIANGLES, np.int64),
        np.empty(MAX_TRIANGLES, np.int64), np.empty((32, 3)), np.empty((32, 3)), np.zeros(4, np.int64),
        np.zeros(4), np.zeros(4, np.int64), np.zeros((4, 4, 32)),
        np.zeros(4, np.int64),
    )  # fmt: skip


@inlined_kernel
def collect_margins(corner_labels, cut_planes, flips, planes, slot_labels, functionals, counts):
    """Fill slot labels (4,), functionals (4, 4, 4), counts (4,); returns the number of slots.

    corner_labels (4,): fragment of each node; cut_planes (6,): index into `planes` (p, 4) or -1; flips (6,): 1 where
    the stored plane points from the edge's second local vertex to its first.
    """
    slots = 0
    for i in range(4):
        new = True
        for s in range(slots):
            if slot_labels[s] == corner_labels[i]:
                new = False
        if new:
            slot_labels[slots] = corner_labels[i]
            counts[slots] = 0
            slots += 1
    for e in range(6):
        p = cut_planes[e]
        if p < 0:
            continue
        for end in range(2):
            label = corner_labels[EDGE_FIRST[e]] if end == 0 else corner_labels[EDGE_SECOND[e]]
            s = 0
            while slot_labels[s] != label:
                s += 1
            sign = -1.0 if (end == 0) != (flips[e] == 1) else 1.0
            nx, ny, nz, o = sign * planes[p, 0], sign * planes[p, 1], sign * planes[p, 2], sign * planes[p, 3]
            known = False
            for q in range(counts[s]):
                g = functionals[s, q]
                if g[0] == nx and g[1] == ny and g[2] == nz and g[3] == o:
                    known = True
            if not known:
                g = functionals[s, counts[s]]
                g[0], g[1], g[2], g[3] = nx, ny, nz, o
                counts[s] += 1
    return slots


@inlined_kernel
def margin(functionals, count, x, y, z):
    """Smallest signed distance [m] to a slot's `count` functionals; infinity without any."""
    least = np.inf
    for q in range(count):
        g = functionals[q]
        least = min(least, g[0] * x + g[1] * y + g[2] * z - g[3])
    return least


@inlined_kernel
def owner_slot(slots, functionals, counts, slot_labels, x, y, z):
    """Slot of the largest margin; the smaller label at a tie."""
    best = 0
    best_margin = margin(functionals[0], counts[0], x, y, z)
    for s in range(1, slots):
        m = margin(functionals[s], counts[s], x, y, z)
        if m > best_margin or (m == best_margin and slot_labels[s] < slot_labels[best]):
            best, best_margin = s, m
    return best


@query_kernel
def section(corners, a, b, c, o, limit, polygon, value, order):
    """The tetrahedron's section with the plane a x + b y + c z = o, right-handed about (a, b, c); its vertex count.

    None if the plane only touches it, to `limit` [m]: a face in the plane is not within the tetrahedron, it may be a
    step.
    """
    above, positive = 0, False
    for i in range(4):
        value[i] = a * corners[i, 0] + b * corners[i, 1] + c * corners[i, 2] - o
        if abs(value[i]) <= limit:
            value[i] = 0.0
        positive = positive or value[i] > 0.0
        if value[i] >= 0.0:
            above += 1
    if above == 4 or not positive:
        return 0
    # corners above first, in their order; then those below
    used = 0
    for upper in range(2):
        for i in range(4):
            if (value[i] >= 0.0) == (upper == 0):
                order[used] = i
                used += 1
    count = 4 if above == 2 else 3
    for k in range(count):
        # an edge each, in cyclic order: the cycle of the four mixed edges, or around the lone corner
        if above == 2:
            p, q = order[k // 2], order[2 + ((k + 1) // 2) % 2]
        elif above == 1:
            p, q = order[0], order[1 + k]
        else:
            p, q = order[3], order[k]
        t = value[p] / (value[p] - value[q])
        for d in range(3):
            polygon[k, d] = corners[p, d] + t * (corners[q, d] - corners[p, d])
    nx = ny = nz = 0.0
    for k in range(1, count - 1):
        ux, uy, uz = polygon[k, 0] - polygon[0, 0], polygon[k, 1] - polygon[0, 1], polygon[k, 2] - polygon[0, 2]
        vx, vy, vz = (
            polygon[k + 1, 0] - polygon[0, 0],
            polygon[k + 1, 1] - polygon[0, 1],
            polygon[k + 1, 2] - polygon[0, 2],
        )
        nx += uy * vz - uz * vy
        ny += uz * vx - ux * vz
        nz += ux * vy - uy * vx
    if nx * a + ny * b + nz * c < 0.0:
        for k in range(count // 2):
            for d in range(3):
                polygon[k, d], polygon[count - 1 - k, d] = polygon[count - 1 - k, d], polygon[k, d]
    return count


@query_kernel
def emit(polygon, count, front, back, kind, triangles, fronts, backs, kinds, used):
    for k in range(1, count - 1):
        if used >= len(triangles):
            raise RuntimeError("a cut tetrahedron made more triangles than MAX_TRIANGLES")
        for d in range(3):
            triangles[used, d] = polygon[0, d]
            triangles[used, 3 + d] = polygon[k, d]
            triangles[used, 6 + d] = polygon[k + 1, d]
        fronts[used] = front
        backs[used] = back
        kinds[used] = kind
        used += 1
    return used


@query_kernel
def face_shares(face, slots, work, used):
    """Each slot's share of a face of the tetrahedron `work.corners`, from its margins; of a lone slot, all of it.

    Triangles go into `work` from row `used` on, right-handed about the tetrahedron's outward normal: fronts the slot,
    backs -1, kinds the face. Returns the row behind the last.
    """
    for f in range(slots):
        _first_choice(work)
        while True:
            count = load_face(work.corners, face, work.polygon)
            count = clip_to_region(count, slots, work, f, work.corners, face, 1.0)
            used = emit(work.polygon, count, f, -1, face, work.triangles, work.fronts, work.backs, work.kinds, used)
            if not _next_choice(slots, work, f):
                break
    return used


@query_kernel
def interfaces(slots, work, used):
    """The polygons between any two slots within the tetrahedron `work.corners`, from its margins.

    Triangles go into `work` from row `used` on, right-handed about the outward normal of the slot in fronts; backs has
    the slot behind, kinds INTERFACE. Returns the row behind the last.
    """
    functionals, choice, polygon, limit = work.functionals, work.choice, work.polygon, tie_limit(work.corners)
    _first_choice(work)
    while True:
        for f in range(slots):
            m = functionals[f, choice[f]]
            for g in range(f + 1, slots):
                h = functionals[g, choice[g]]
                # outward of f is where its margin falls below g's
                a, b, c, o = h[0] - m[0], h[1] - m[1], h[2] - m[2], h[3] - m[3]
                count = section(work.corners, a, b, c, o, limit, polygon, work.value, work.order)
                if count:
                    count = clip_to_choice(count, slots, work, limit, f, g)
                used = emit(polygon, count, f, g, INTERFACE, work.triangles, work.fronts, work.backs, work.kinds, used)
        if not _next_choice(slots, work, -1):
            return used


@query_kernel
def _confine(slots, work, polygon, size, limit, confined):
    """What of the margins in `work` can matter on a convex polygon of `size` vertices; returns the number of slots.

    A functional that another of its slot stays below is no minimum there; a slot with a functional below all of
    another's has nothing of it. Those equal all over it, to `limit` [m], stay: what lies beside decides. The fewer are
    left, the fewer choices and cuts there are. confined.origin: which slots of `work` they are.
    """
    heights = confined.heights
    for s in range(slots):
        for q in range(work.counts[s]):
            g = work.functionals[s, q]
            for k in range(size):
                heights[s, q, k] = g[0] * polygon[k, 0] + g[1] * polygon[k, 1] + g[2] * polygon[k, 2] - g[3]
    left = 0
    for s in range(slots):
        if _is_beaten(s, slots, work.counts, heights, size, limit):
            continue
        count = 0
        for q in range(work.counts[s]):
            needed = True
            for r in range(work.counts[s]):
                never_above, below = True, False
                for k in range(size):
                    never_above = never_above and heights[s, r, k] <= heights[s, q, k]
                    below = below or heights[s, r, k] < heights[s, q, k] - limit
                needed = needed and not (never_above and below)
            if needed:
                for d in range(4):
                    confined.functionals[left, count, d] = work.functionals[s, q, d]
                count += 1
        confined.labels[left], confined.counts[left], confined.origin[left] = work.labels[s], count, s
        left += 1
    return left


@query_kernel
def _is_beaten(s, slots, counts, heights, size, limit):
    """Whether one of a slot's functionals is below all of some other slot's at all vertices."""
    for r in range(slots):
        if r == s:
            continue
        for q in range(counts[s]):
            below = True
            for p in range(counts[r]):
                for k in range(size):
                    below = below and heights[s, q, k] < heights[r, p, k] - limit
            if below:
                return True
    return False


@query_kernel
def steps(face, slots, work, behind_slots, behind, near, far, used):
    """Where the two tetrahedra at a face disagree about its owner: a step of the regions' border, in the face.

    `work` has the margins of one and its corners, `behind` those of the one behind the face; `near` and `far` are
    working space. Triangles go into `far` from row `used` on, right-handed about the outward normal of the first:
    fronts a slot of `work`, backs one of `behind`, of another fragment; kinds the face. Returns the row behind the
    last.
    """
    limit = tie_limit(work.corners)
    load_face(work.corners, face, far.polygon)
    slots = _confine(slots, work, far.polygon, 3, limit, near)
    for f in range(slots):
        _first_choice(near)
        while True:
            count = load_face(work.corners, face, near.polygon)
            count = clip_to_region(count, slots, near, f, work.corners, face, 1.0)
            far_slots = _confine(behind_slots, behind, near.polygon, count, limit, far) if count else 0
            for g in range(far_slots):
                if far.labels[g] == near.labels[f]:
                    continue
                _first_choice(far)
                while True:
                    for k in range(count):
                        for d in range(3):
                            far.polygon[k, d] = near.polygon[k, d]
                    left = clip_to_region(count, far_slots, far, g, work.corners, face, -1.0)
                    used = emit(
                        far.polygon, left, near.origin[f], far.origin[g], face, far.triangles, far.fronts, far.backs,
                        far.kinds, used,
                    )  # fmt: skip
                    if not _next_choice(far_slots, far, g):
                        break
            if not _next_choice(slots, near, f):
                break
    return used


@query_kernel
def agree_on_face(slots, work, behind_slots, behind, near, far, face):
    """Whether two tetrahedra, one at least cut, certainly give each point of their common face to the same fragment.

    `face`: the near tetrahedron's, of `work.corners`; `near` and `far` are working space. A quick test: False may also
    mean that nobody knows.
    """
    limit = tie_limit(work.corners)
    load_face(work.corners, face, near.polygon)
    slots = _confine(slots, work, near.polygon, 3, limit, near)
    if slots != _confine(behind_slots, behind, near.polygon, 3, limit, far):
        return False
    if slots == 1:
        return near.labels[0] == far.labels[0]
    for s in range(slots):
        other = -1
        for r in range(slots):
            if far.labels[r] == near.labels[s] and far.counts[r] == near.counts[s]:
                other = r
        if other < 0:
            return False
        for q in range(near.counts[s]):
            g = near.functionals[s, q]
            known = False
            for r in range(near.counts[s]):
                h = far.functionals[other, r]
                known = known or (g[0] == h[0] and g[1] == h[1] and g[2] == h[2] and g[3] == h[3])
            if not known:
                return False
    return not _ties_on_face(slots, near, work.corners, face)


@query_kernel
def _ties_on_face(slots, work, corners, face):
    """Whether margins of two slots may be equal all over a face: then each side of it can have an owner of its own."""
    limit = tie_limit(corners)
    for s in range(slots):
        for r in range(s):
            for q in range(work.counts[s] * work.counts[r]):
                g, h = work.functionals[s, q % work.counts[s]], work.functionals[r, q // work.counts[s]]
                equal = True
                for k in range(3):
                    c = corners[FACE_VERTICES[face, k]]
                    d = (g[0] - h[0]) * c[0] + (g[1] - h[1]) * c[1] + (g[2] - h[2]) * c[2] - (g[3] - h[3])
                    equal = equal and abs(d) <= limit
                if equal:
                    return True
    return False


@query_kernel
def _first_choice(work):
    for s in range(4):
        work.choice[s] = 0


@query_kernel
def _next_choice(slots, work, but):
    """The next choice of the functional that attains each slot's minimum, `but` one's; False behind the last."""
    for s in range(slots):
        if s == but:
            continue
        work.choice[s] += 1
        if work.choice[s] < work.counts[s]:
            return True
        work.choice[s] = 0
    return False


@query_kernel
def load_face(corners, face, polygon):
    for k in range(3):
        for d in range(3):
            polygon[k, d] = corners[FACE_VERTICES[face, k], d]
    return 3

"""Placement of the face points and the hub of a tetrahedron divided like a fan.

See cut_tetrahedron.py; docs/numerics.md has the rule that places each of them.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.fracture.cut_patterns import CUT_COUNT, CUT_EDGES, GROUP, GROUPS
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.mesh.cut_tetrahedron import (
    EDGE_BETWEEN,
    EDGE_FIRST,
    EDGE_SECOND,
    FACE_VERTICES,
    ON_FACE,
    SINGULAR,
    point_on_edge,
)

NEVER = np.iinfo(np.int64).max


@query_kernel
def load_crossings(mesh, body, edge_shift, t, pattern, work):
    """Load the crossings of the cut edges of tetrahedron `t`; returns the oldest and newest fracture that cut them."""
    v = mesh.tetrahedra[t]
    oldest, newest = NEVER, -1
    for c in range(CUT_COUNT[pattern]):
        e = CUT_EDGES[pattern, c]
        edge = mesh.tetrahedron_edges[t, e] + edge_shift
        a, b = v[EDGE_FIRST[e]], v[EDGE_SECOND[e]]
        point_on_edge(mesh.nodes, min(a, b), max(a, b), body.edge_share[edge], work.crossings[e])
        event = np.int64(body.edge_event[edge])
        work.event[e] = event
        oldest, newest = min(oldest, event), max(newest, event)
    return oldest, newest


@query_kernel
def _load_planes(mesh, body, edge_shift, t, work):
    """Load the planes and shares: face points and hubs of several events or more than two fragments need them, too."""
    v = mesh.tetrahedra[t]
    for e in range(6):
        i, j = EDGE_FIRST[e], EDGE_SECOND[e]
        work.cut[e] = work.labels[i] != work.labels[j]
        if work.cut[e]:
            edge = mesh.tetrahedron_edges[t, e] + edge_shift
            p, share = body.planes[body.edge_plane[edge]], body.edge_share[edge]
            forward = v[i] < v[j]
            work.shares[e] = share if forward else 1.0 - share
            for d in range(4):
                work.planes[e, d] = p[d] if forward else -p[d]


@query_kernel
def place_hub(mesh, body, edge_shift, t, pattern, oldest, newest, work):
    """Place face points and hub of tetrahedron `t`; its labels, corners, crossings and events are in `work`."""
    hub, groups, lone = work.hub, GROUPS[pattern], -1
    flat = groups > 2
    if flat or oldest < newest:
        _load_planes(mesh, body, edge_shift, t, work)
        _place_face_points(mesh, t, work)
        for i in range(4):
            work.group[i] = GROUP[pattern, i]
        if oldest < newest:
            oldest, groups, flat = _decide_by_events(work, oldest)
            if flat:
                lone = _lone_of_first(work, oldest)
    for d in range(3):
        hub[d] = 0.0
    used = 0
    if not flat:
        # not planar, or no other crack has reached it: the mean of the crossings of the first crack
        for c in range(CUT_COUNT[pattern]):
            e = CUT_EDGES[pattern, c]
            if work.event[e] == oldest:
                used += 1
                for d in range(3):
                    hub[d] += work.crossings[e, d]
        for d in range(3):
            hub[d] /= used
        return
    group = work.group
    for face in range(4):
        f = FACE_VERTICES[face]
        if face == lone:
            continue
        if group[f[0]] != group[f[1]] and group[f[1]] != group[f[2]] and group[f[2]] != group[f[0]]:
            used += 1
            for d in range(3):
                hub[d] += work.face_points[face, d]
    for d in range(3):
        hub[d] /= used
    if groups == 4 and lone < 0:
        _common_point_of_tetrahedron(work, hub)
    _settle_on_face(work)


@query_kernel
def _place_face_points(mesh, t, work):
    for face in range(4):
        f = FACE_VERTICES[face]
        a, b, c = work.labels[f[0]], work.labels[f[1]], work.labels[f[2]]
        if a != b and b != c and c != a:
            _place_face_point(mesh.tetrahedra[t], face, work)


@query_kernel
def _decide_by_events(work, oldest):
    """Which crack places the hub of a tetrahedron cut by several fractures, the first being `oldest`.

    Returns (event that places the hub, number of groups made up to that event, whether the hub is computed from face
    points). Fills work.group.
    """
    groups = _part_into_groups(work, oldest)
    if groups > 2:
        return oldest, groups, True
    newer = _next_event(work, oldest)
    if not _oldest_is_flat(work, oldest):
        return oldest, groups, False
    return newer, _part_into_groups(work, newer), True


@query_kernel
def _settle_on_face(work):
    """Move a hub on a face of three groups to its face point; otherwise the two would divide the face differently."""
    corners, hub, group = work.corners, work.hub, work.group
    for face in range(4):
        f = FACE_VERTICES[face]
        a, b, c = group[f[0]], group[f[1]], group[f[2]]
        if a == b or b == c or c == a:
            continue
        p, q, r, top = corners[f[0]], corners[f[1]], corners[f[2]], corners[face]
        ux, uy, uz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
        vx, vy, vz = r[0] - p[0], r[1] - p[1], r[2] - p[2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        above = nx * (hub[0] - p[0]) + ny * (hub[1] - p[1]) + nz * (hub[2] - p[2])
        height = nx * (top[0] - p[0]) + ny * (top[1] - p[1]) + nz * (top[2] - p[2])
        if above / height <= ON_FACE:
            for d in range(3):
                hub[d] = work.face_points[face, d]
            return


@query_kernel
def _next_event(work, after):
    """The oldest fracture later than `after` that cut one of the edges, or NEVER."""
    oldest = NEVER
    for e in range(6):
        if work.cut[e] and after < work.event[e] < oldest:
            oldest = work.event[e]
    return oldest


@query_kernel
def _part_into_groups(work, until):
    """Fill `group`: nodes not separated by a fracture up to `until` share a group; returns the number of groups."""
    group = work.group
    for i in range(4):
        group[i] = i
        for j in range(i):
            e = EDGE_BETWEEN[j, i]
            if not work.cut[e] or work.event[e] > until:
                group[i] = min(group[i], group[j])
    groups = 0
    for i in range(4):
        groups += group[i] == i
    return groups


@query_kernel
def _oldest_is_flat(work, oldest):
    """Whether the first crack, which made two groups, is planar: it has three crossings, or its planes are equal."""
    used, first = 0, -1
    same = True
    for e in range(6):
        if not work.cut[e] or work.event[e] != oldest:
            continue
        used += 1
        if first < 0:
            first = e
        else:
            turn = (work.group[EDGE_FIRST[e]] == 0) == (work.group[EDGE_FIRST[first]] == 0)
            same = same and _same_plane(work.planes[e], work.planes[first], turn)
    return used == 3 or same


@query_kernel
def _lone_of_first(work, newest):
    """Node cut off by an older fracture, if the fracture `newest` separated all three others at once; -1 otherwise.

    The face opposite this node does not contribute to the hub.
    """
    for i in range(4):
        lone = True
        for j in range(4):
            if j != i:
                e = EDGE_BETWEEN[i, j]
                lone = lone and work.cut[e] == 1 and work.event[e] < newest
                for k in range(j):
                    if k != i:
                        f = EDGE_BETWEEN[k, j]
                        lone = lone and work.cut[f] == 1 and work.event[f] == newest
        if lone:
            return i
    return -1


@query_kernel
def _place_face_point(nodes, face, work):
    """The point where three fragments meet in a face, computed from the face alone, with its nodes in mesh order."""
    f = FACE_VERTICES[face]
    a, b, c = f[0], f[1], f[2]
    if nodes[a] > nodes[b]:
        a, b = b, a
    if nodes[b] > nodes[c]:
        b, c = c, b
    if nodes[a] > nodes[b]:
        a, b = b, a
    ab, bc, ac = EDGE_BETWEEN[a, b], EDGE_BETWEEN[b, c], EDGE_BETWEEN[a, c]
    newest = max(work.event[ab], work.event[bc], work.event[ac])
    out = work.face_points[face]
    if work.event[ab] < newest:
        # one or all of the three edges are of the newest event
        if work.event[bc] == newest:
            _on_older_crack(work, a, b, c, out)
        else:
            _on_older_crack(work, b, a, c, out)
    elif work.event[bc] < newest:
        _on_older_crack(work, c, a, b, out)
    else:
        _common_point_of_face(work, a, b, c, out)


@query_kernel
def _on_older_crack(work, i, j, l, out):  # noqa: E741
    """Intersection, in their face, of the plane between nodes j and l with the older crack around node i."""
    e = EDGE_BETWEEN[j, l]
    sign = 1.0 if j < l else -1.0
    n = work.planes[e]
    p, r = work.crossings[EDGE_BETWEEN[i, j]], work.crossings[EDGE_BETWEEN[i, l]]
    at_p = sign * (n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - n[3])
    at_r = sign * (n[0] * r[0] + n[1] * r[1] + n[2] * r[2] - n[3])
    s = 0.5
    if at_r - at_p > 0.0:
        s = min(max(at_p / (at_p - at_r), 0.0), 1.0)
    for d in range(3):
        out[d] = p[d] + s * (r[d] - p[d])


@query_kernel
def _share(work, i, j):
    """Position of an edge's crossing as a share of the edge from node i to j."""
    share = work.shares[EDGE_BETWEEN[i, j]]
    return share if i < j else 1.0 - share


@query_kernel
def _common_point_of_face(work, a, b, c, out):
    """Point of a face nearest to the planes of its three edges (least squares), within the triangle of their crossings.

    Cells are convex: where planes agree and meet in the face, they do so within that triangle. If the point is beyond
    an edge, the fragment of the opposite node would reach across that edge: then it is this edge's crossing, so that
    the two fragments there share no more than they must. Otherwise it is clipped to the triangle, along the line from
    the centroid.
    """
    x = work.crossings
    p, q, r = x[EDGE_BETWEEN[a, b]], x[EDGE_BETWEEN[b, c]], x[EDGE_BETWEEN[a, c]]
    suu = suv = svv = su = sv = 0.0
    for k in range(3):
        e = EDGE_BETWEEN[a, b] if k == 0 else EDGE_BETWEEN[b, c] if k == 1 else EDGE_BETWEEN[a, c]
        n = work.planes[e]
        h = n[0] * p[0] + n[1] * p[1] + n[2] * p[2] - n[3]
        u = n[0] * (q[0] - p[0]) + n[1] * (q[1] - p[1]) + n[2] * (q[2] - p[2])
        v = n[0] * (r[0] - p[0]) + n[1] * (r[1] - p[1]) + n[2] * (r[2] - p[2])
        suu, suv, svv = suu + u * u, suv + u * v, svv + v * v
        su, sv = su + u * h, sv + v * h
    determinant = suu * svv - suv * suv
    third = 1.0 / 3.0
    u = v = third
    if determinant > SINGULAR * (suu + svv) ** 2:
        u, v = (suv * sv - svv * su) / determinant, (suv * su - suu * sv) / determinant
    ab, bc, ac = _share(work, a, b), _share(work, b, c), _share(work, a, c)
    at_a = (1.0 - u - v) * (1.0 - ab) + v * (1.0 - ac)
    at_b = (1.0 - u - v) * ab + u * (1.0 - bc)
    at_c = u * bc + v * ac
    least = min(at_a, at_b, at_c)
    if least < 0.0:
        u = 1.0 if at_a == least else 0.0
        v = 1.0 if at_a != least and at_b == least else 0.0
    s = 1.0
    for k in range(3):
        end = 1.0 - u - v if k == 0 else u if k == 1 else v
        if end < 0.0:
            s = min(s, third / (third - end))
    u, v = third + s * (u - third), third + s * (v - third)
    for d in range(3):
        out[d] = p[d] + u * (q[d] - p[d]) + v * (r[d] - p[d])


@query_kernel
def _common_point_of_tetrahedron(work, out):
    """The point nearest to all six planes (least squares), clipped to the tetrahedron of the face points."""
    corners = work.face_points
    a00 = a01 = a02 = a11 = a12 = a22 = r0 = r1 = r2 = 0.0
    o = corners[0]
    for e in range(6):
        n = work.planes[e]
        h = n[0] * o[0] + n[1] * o[1] + n[2] * o[2] - n[3]
        u = n[0] * (corners[1, 0] - o[0]) + n[1] * (corners[1, 1] - o[1]) + n[2] * (corners[1, 2] - o[2])
        v = n[0] * (corners[2, 0] - o[0]) + n[1] * (corners[2, 1] - o[1]) + n[2] * (corners[2, 2] - o[2])
        w = n[0] * (corners[3, 0] - o[0]) + n[1] * (corners[3, 1] - o[1]) + n[2] * (corners[3, 2] - o[2])
        a00, a01, a02, a11, a12, a22 = a00 + u * u, a01 + u * v, a02 + u * w, a11 + v * v, a12 + v * w, a22 + w * w
        r0, r1, r2 = r0 - u * h, r1 - v * h, r2 - w * h
    c00, c01, c02 = a11 * a22 - a12 * a12, a02 * a12 - a01 * a22, a01 * a12 - a02 * a11
    determinant = a00 * c00 + a01 * c01 + a02 * c02
    w1 = w2 = w3 = 0.25
    if determinant > SINGULAR * (a00 + a11 + a22) ** 3:
        c11, c12, c22 = a00 * a22 - a02 * a02, a01 * a02 - a00 * a12, a00 * a11 - a01 * a01
        w1 = (c00 * r0 + c01 * r1 + c02 * r2) / determinant
        w2 = (c01 * r0 + c11 * r1 + c12 * r2) / determinant
        w3 = (c02 * r0 + c12 * r1 + c22 * r2) / determinant
    s = 1.0
    for k in range(4):
        end = 1.0 - w1 - w2 - w3 if k == 0 else w1 if k == 1 else w2 if k == 2 else w3
        if end < 0.0:
            s = min(s, 0.25 / (0.25 - end))
    w1, w2, w3 = 0.25 + s * (w1 - 0.25), 0.25 + s * (w2 - 0.25), 0.25 + s * (w3 - 0.25)
    for d in range(3):
        out[d] = o[d] + w1 * (corners[1, d] - o[d]) + w2 * (corners[2, d] - o[d]) + w3 * (corners[3, d] - o[d])


@query_kernel
def _same_plane(p, q, same_way):
    """Whether two planes are bitwise equal, with the same or (not `same_way`) opposite orientation."""
    sign = 1.0 if same_way else -1.0
    return p[0] == sign * q[0] and p[1] == sign * q[1] and p[2] == sign * q[2] and p[3] == sign * q[3]

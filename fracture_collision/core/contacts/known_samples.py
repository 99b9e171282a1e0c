"""Contacts of crack samples, which are known before any search, and functions that all contacts of samples share."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.field.elementary_queries import INSIDE, OUTSIDE, Probe, bounded_probe
from fracture_collision.core.field.flood import NO_SOURCE
from fracture_collision.core.fracture.crack_seeds import find_seeds
from fracture_collision.core.memory.compiled import query_kernel
from fracture_collision.core.memory.kinds import TETRAHEDRA, is_bounded
from fracture_collision.core.memory.pools import NEVER_BROKEN
from fracture_collision.core.memory.rotations import to_other
from fracture_collision.core.mesh.cut_tetrahedron import point_on_edge
from fracture_collision.core.mesh.sample_numbers import (
    FIRST_NODE,
    crossing_number,
    edge_of,
    is_crossing,
    is_node,
    tetrahedron_of,
)

# Allowance that keeps bounds valid under rounding: share of the smaller R, and of all coordinates behind a depth.
BOUND_SLACK = 1e-12
COORDINATE_SLACK = 8.0 * np.finfo(np.float64).eps

# columns of ids
ID_SIDE, ID_SAMPLE, ID_SOURCE, ID_TETRAHEDRON, ID_AT = 0, 1, 2, 3, 4


@query_kernel
def _farthest(pools, f):
    """Largest coordinate [m] of fragment f's geometry in its body frame."""
    if not is_bounded(pools.fragment.kind[f]):
        return abs(pools.fragment.shape[f, 3])
    farthest = 0.0
    for d in range(6):
        farthest = max(farthest, abs(pools.fragment.box[f, d]))
    return farthest


@query_kernel
def share_a_body(pools, a, b):
    """Whether two fragments come from one body that broke."""
    fragment = pools.fragment
    return (
        fragment.kind[a] == TETRAHEDRA and fragment.kind[b] == TETRAHEDRA and fragment.mesh[a] == fragment.mesh[b]
        and fragment.node_shift[a] != NEVER_BROKEN and fragment.node_shift[a] == fragment.node_shift[b]
    )  # fmt: skip


class Side(NamedTuple):
    """One of the two sides of a pair: the samples of `own`, to be queried in `other`."""

    number: int  # 0: own is a, 1: own is b
    own: int
    other: int
    rotation: np.ndarray  # (3, 3) float64: from own's body frame to the other's
    translation: np.ndarray  # (3,) float64 [m], likewise
    one_body: bool  # whether the two come from one body that broke
    slack: float  # [m] rounding_slack of the pair


@query_kernel
def side_of(pair, number, one_body, slack):
    """The Side `number` of a Pair."""
    own, other = (pair.a, pair.b) if number == 0 else (pair.b, pair.a)
    return Side(number, own, other, pair.rotation[number], pair.translation[number], one_body, slack)


class Placed(NamedTuple):
    """A sample in the frame of the fragment that it is queried in."""

    number: int
    x: float  # [m]
    y: float
    z: float
    start: int  # a tetrahedron to start the search from, -1: none is known
    moved: float  # [m] how far it has moved since the body broke; infinity: the two are not of one body
    deep: float  # [m] bound on its depth: `moved` and the rounding


@query_kernel
def placed(pools, side, entry):
    """The Placed sample of row `entry` of SamplePool, a sample of this Side."""
    point, sample = pools.samples.points[entry], pools.samples.numbers[entry]
    x, y, z = to_other(side.rotation, side.translation, point[0], point[1], point[2])
    start = home_tetrahedron(pools, side.other, sample) if side.one_body else -1
    moved = moved_since(point, x, y, z) if side.one_body else math.inf
    return Placed(np.int64(sample), x, y, z, np.int64(start), moved, moved + side.slack)


@query_kernel
def home_tetrahedron(pools, f, sample):
    """A tetrahedron of fragment f's mesh that holds the sample, or has it on a node or edge."""
    mesh, k = pools.mesh, pools.fragment.mesh[f]
    first = mesh.first[k]
    if is_node(first, sample):
        # node_tets_begin has one row more than nodes in each mesh before this one
        return mesh.node_tets[mesh.node_tets_begin[first[FIRST_NODE] + sample + k]]
    if is_crossing(first, sample):
        edge, _ = edge_of(first, sample)
        return mesh.edge_tets[edge]
    return tetrahedron_of(first, sample)


@query_kernel
def moved_since(point, x, y, z):
    """Distance [m] of a point (3,) from its place in the unbroken body; (x, y, z): in the other's frame."""
    dx, dy, dz = x - point[0], y - point[1], z - point[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@query_kernel
def rounding_slack(pools, a, b, translation):
    """How much rounding may reduce the depth bound [m] of fragments a and b with relative translations (2, 3) [m]."""
    fragment = pools.fragment
    slack = BOUND_SLACK * min(fragment.radius[a], fragment.radius[b])
    slack += COORDINATE_SLACK * (_farthest(pools, a) + _farthest(pools, b))
    for d in range(3):
        slack += COORDINATE_SLACK * (abs(translation[0, d]) + abs(translation[1, d]))
    return slack


@query_kernel
def put_contact(sink, row, side, sample, point, answer):
    """Write row `row` of a Sink from a side, a sample number, its point and the Probe of that point.

    point (x, y, z) [m]: in the other's body frame.
    """
    contact, ids = sink.contacts[row], sink.ids[row]
    contact[0], contact[1], contact[2] = point
    contact[3], contact[4], contact[5] = answer.x, answer.y, answer.z
    contact[6], contact[7], contact[8] = answer.nx, answer.ny, answer.nz
    contact[9] = answer.distance
    ids[ID_SIDE], ids[ID_SAMPLE] = side, sample
    ids[ID_SOURCE], ids[ID_TETRAHEDRON], ids[ID_AT] = answer.source, answer.source_tetrahedron, answer.tetrahedron


@query_kernel
def ask_sample(pools, other, sample, near, deep, reached, scratch):
    """bounded_probe of a Placed sample, searched to `deep` [m].

    In place no sample is inside another fragment of its body, so none is deeper than it has moved. The search finds a
    farther surface where cracks through nodes leave the sample's own fragment neither volume nor area about it. Such a
    sample is as deep as it has moved, along the normal found; most_depth stays that of the point.
    """
    point, searched = (sample.x, sample.y, sample.z), min(deep, sample.deep)
    answer = bounded_probe(pools, other, point, near, searched, sample.start, reached, scratch)
    if answer.status != INSIDE or -answer.distance <= sample.deep:
        return answer
    if answer.distance == -math.inf:
        if searched < sample.deep:
            return answer
        answer = bounded_probe(pools, other, point, near, math.inf, sample.start, True, scratch)
    nx, ny, nz, moved = answer.nx, answer.ny, answer.nz, sample.moved
    x, y, z = sample.x + moved * nx, sample.y + moved * ny, sample.z + moved * nz
    return Probe(INSIDE, -moved, nx, ny, nz, x, y, z, answer.most_depth, NO_SOURCE, -1, answer.tetrahedron)


@query_kernel
def query_seeds(pools, pair, wanted, near, sink, scratch):
    """Contacts of a Pair of one body at the crossings of the crack that they share, until there are `wanted`.

    near [m]: detection tolerance. A crossing is a sample of both: the
    two alternate as its owner. Fills the Sink as far as it goes. Returns (contacts, crossings queried).
    """
    a, b, rotation, translation = pair
    mesh, body, fragment = pools.mesh, pools.body, pools.fragment
    slack = rounding_slack(pools, a, b, translation)
    begin, end = find_seeds(fragment, pools.seeds, a, b)
    if end - begin < wanted:
        return 0, 0
    count, asked = 0, 0
    point = scratch.point
    for k in range(begin, end):
        if count == wanted:
            break
        asked += 1
        e = pools.seeds.edges[k]
        side = (k - begin) % 2
        own, other = (a, b) if side == 0 else (b, a)
        end_of_own = 0 if body.node_fragment[mesh.edges[e, 0] + fragment.node_shift[a]] == own else 1
        share = body.edge_share[e + fragment.edge_shift[a]]
        point_on_edge(mesh.nodes, mesh.edges[e, 0], mesh.edges[e, 1], share, point)
        x, y, z = to_other(rotation[side], translation[side], point[0], point[1], point[2])
        moved = moved_since(point, x, y, z)
        number = np.int64(crossing_number(mesh.first[fragment.mesh[a]], e, end_of_own))
        sample = Placed(number, x, y, z, np.int64(mesh.edge_tets[e]), moved, moved + slack)
        answer = ask_sample(pools, other, sample, near, math.inf, False, scratch)
        if answer.status == OUTSIDE:
            continue
        if count < len(sink.contacts):
            put_contact(sink, count, side, number, (x, y, z), answer)
        count += 1
    return count, asked

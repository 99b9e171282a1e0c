"""The samples of new fragments: those of the broken one, dealt out, and those on the new cracks.

A fragment's samples are the nodes of the mesh on the body's old surface, two crossings for every mesh edge that a crack
cuts, one for each side (Glondu 2014, 6.3), and the corners where cracks meet (corner_samples.py).
"""

from __future__ import annotations

import numpy as np

from fracture_collision import grouping
from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.mesh.cut_tetrahedron import point_on_edge
from fracture_collision.core.mesh.sample_numbers import (
    FIRST_EDGE,
    FIRST_NODE,
    NewSamples,
    crossing_number,
    edge_of,
    is_crossing,
    is_node,
)
from fracture_collision.core.samples.sample_leaves import fill_leaves, leaf_count

NOBODYS = -1  # part of a point that no new fragment keeps
_grouped = kernel(grouping.grouped)


@kernel
def new_samples(pools, broken, cut, corners):
    """NewSamples of a Broken: two at each of the mesh edges `cut` (k,), ascending, and `corners`.

    pools: mesh and body; corners: all corners of the new fragments, including those of earlier cracks.
    """
    mesh, body = pools.mesh, pools.body
    first = mesh.first[broken.mesh]
    crossings = 2 * len(cut)
    count = crossings + len(corners.points)
    new = NewSamples(
        np.empty((count, 3)), np.empty(count, np.int32), np.empty(count, np.int32), np.empty(count, np.int32)
    )
    for q in range(crossings):
        e, side = cut[q // 2] + first[FIRST_EDGE], q % 2
        node = mesh.edges[e, side]
        share = body.edge_share[e + broken.edge_shift]
        point_on_edge(mesh.nodes, mesh.edges[e, 0], mesh.edges[e, 1], share, new.points[q])
        new.samples[q], new.parents[q] = crossing_number(first, e, side), node - first[FIRST_NODE]
        new.parts[q] = body.node_fragment[node + broken.node_shift] - broken.first
    for c in range(len(corners.points)):
        q = crossings + c
        for d in range(3):
            new.points[q, d] = corners.points[c, d]
        new.samples[q], new.parents[q], new.parts[q] = corners.samples[c], corners.parents[c], corners.parts[c]
    return new


@kernel
def parts_of(pools, broken, samples):
    """The part (s,) int32 of a Broken that each sample, of `samples` (s,) numbers, goes to; pools: mesh and body.

    NOBODYS for corners, which depend on all cracks around them and are made anew for the new fragments.
    """
    mesh, body = pools.mesh, pools.body
    first = mesh.first[broken.mesh]
    parts = np.empty(len(samples), np.int32)
    for i in range(len(samples)):
        sample, node = samples[i], NOBODYS
        if is_node(first, sample):
            node = first[FIRST_NODE] + sample
        elif is_crossing(first, sample):
            edge, side = edge_of(first, sample)
            node = mesh.edges[edge, side]
        parts[i] = NOBODYS
        if node != NOBODYS:
            parts[i] = body.node_fragment[node + broken.node_shift] - broken.first
    return parts


@kernel
def deal_samples(pools, samples, broken, new, room):
    """Write the samples and leaves of all fragments of a Broken, and where each fragment's are.

    pools: mesh, body and fragment; samples: SamplePool's points and numbers of the broken fragment; new: NewSamples;
    room: the rows of SamplePool to be written (its columns), and the numbers of its first free sample and leaf. Returns
    (samples, leaves) written.
    """
    fragment = pools.fragment
    (points, numbers), (out_points, out_numbers, values, entries, sample, leaf) = samples, room
    count = broken.end - broken.first
    parts = np.append(parts_of(pools, broken, numbers), new.parts)
    order, begins = _grouped(parts, count)
    for k in range(len(order)):
        i = order[k]
        if i < len(numbers):
            out_points[k], out_numbers[k] = points[i], numbers[i]
        else:
            out_points[k], out_numbers[k] = new.points[i - len(numbers)], new.samples[i - len(numbers)]
    fill_leaves(out_points, begins, values, entries, fragment.middle[broken.first : broken.end])
    first_leaf = leaf
    for part in range(count):
        f = broken.first + part
        fragment.sample_begin[f], fragment.sample_end[f] = sample + begins[part], sample + begins[part + 1]
        fragment.leaf_begin[f] = leaf
        leaf += leaf_count(begins[part + 1] - begins[part])
        fragment.leaf_end[f] = leaf
    return len(order), leaf - first_leaf

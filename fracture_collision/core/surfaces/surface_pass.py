"""Surface search for all pairs of a step, after their samples: bounds for whole surfaces, contacts between samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_places import put_in_world
from fracture_collision.core.memory.compiled import kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import BOX, TETRAHEDRA, TRIANGLES
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.memory.rotations import relative_pose, turned_back
from fracture_collision.core.mesh.surface_elements import ElementTable
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.search.traversal import BY_LIMIT, COMPLETE, depth_limit
from fracture_collision.core.surfaces.surface_certificate import NOBODY, SurfaceWork, judge_surfaces
from fracture_collision.core.surfaces.surface_contact import put_surface_contact


class Surfaces(NamedTuple):
    """Elements and working memory of a search between samples."""

    table: ElementTable
    work: SurfaceWork


class Between(NamedTuple):
    """Results between samples, of p pairs: at most one contact each."""

    has_contact: np.ndarray  # (p,) bool
    contacts: np.ndarray  # (p, 10) float64: rows of query_pair
    ids: np.ndarray  # (p, 5) int64
    asked: np.ndarray  # (p,) int64: points queried


def judge_pairs(
    pools: Pools, surfaces: Surfaces, rows: np.ndarray, rotations: np.ndarray, positions: np.ndarray,
    pairs: np.ndarray, todo: np.ndarray, is_free: np.ndarray, epsilon: float, near: float, found: PairContacts,
    offsets: np.ndarray, scratch: Scratch, crew: Crew,
) -> PairContacts:  # fmt: skip
    """`found` with bounds that hold for the surfaces of the pairs `todo`, and with deeper points between samples added.

    todo: of `pairs` (p, 2), those that `found` was searched for; is_free (p,): whether a pair's visits are unlimited:
    others get only a bound; epsilon, near: shares of the smaller R; offsets (p + 1,): of found's contacts.
    """
    kinds = pools.fragment.kind[rows]
    has_edges = (kinds == BOX) | (kinds == TETRAHEDRA) | (kinds == TRIANGLES)
    todo = todo[has_edges[pairs[todo]].all(axis=1)]
    p = len(pairs)
    bounds, exhausted = found.bounds.copy(), found.exhausted.copy()
    between = Between(np.zeros(p, np.bool_), np.empty((p, 10)), np.empty((p, 5), np.int64), np.zeros(p, np.int64))
    is_open = is_free[todo] & (found.exhausted[todo] == COMPLETE)
    _bound_by_thickness(pools, rows, pairs, todo[~is_open], bounds)
    todo = todo[is_open]
    if len(todo):
        elements = surfaces.table.of(pools, np.unique(rows[pairs[todo]]))
        crew.share(
            _judge_share, pools, elements, rows, rotations, positions, pairs, todo, epsilon, near, found.gaps,
            found.normals, offsets, bounds, exhausted, between, surfaces.work, scratch,
        )  # fmt: skip
    cut = np.flatnonzero(bounds == np.inf)
    bounds[cut] = found.bounds[cut]
    _bound_by_thickness(pools, rows, pairs, cut, bounds)
    visits = found.visits + between.asked
    if not between.has_contact.any():
        return found._replace(bounds=bounds, visits=visits, exhausted=exhausted)
    counts = found.counts + between.has_contact
    total = int(counts.sum())
    points_a, points_b, normals = np.empty((total, 3)), np.empty((total, 3)), np.empty((total, 3))
    gaps, samples = np.empty(total), np.empty((total, 2), np.int64)
    _insert(pairs, rotations, positions, offsets, found, between, points_a, points_b, normals, gaps, samples)
    return PairContacts(counts, bounds, visits, exhausted, points_a, points_b, normals, gaps, samples)


@kernel
def _bound_by_thickness(pools, rows, pairs, todo, bounds):
    """Set bounds for the surfaces of pairs that are not searched."""
    for p in todo:
        a, b = rows[pairs[p, 0]], rows[pairs[p, 1]]
        bounds[p] = max(bounds[p], depth_limit(pools, a), depth_limit(pools, b))


@threaded_kernel
def _judge_share(
    pools, elements, rows, rotations, positions, pairs, todo, epsilon, near, gaps, normals, offsets, bounds, exhausted,
    between, work, scratch, threads, thread,
):  # fmt: skip
    """Process every `threads`-th pair of `todo`, starting at `thread`."""
    rotation, translation = scratch.rotation[thread], scratch.translation[thread]
    for turn in range(thread, len(todo), threads):
        p = todo[turn]
        i, j = pairs[p, 0], pairs[p, 1]
        a, b = rows[i], rows[j]
        relative_pose(rotations[i], positions[i], rotations[j], positions[j], rotation[0], translation[0])
        relative_pose(rotations[j], positions[j], rotations[i], positions[i], rotation[1], translation[1])
        radius = min(pools.fragment.radius[a], pools.fragment.radius[b])
        deepest, nx, ny, nz = -math.inf, 0.0, 0.0, 0.0
        for c in range(offsets[p], offsets[p + 1]):
            if -gaps[c] > deepest:
                deepest = -gaps[c]
                # from a to b in the world; out of b in its frame
                nx, ny, nz = turned_back(rotations[j], -normals[c, 0], -normals[c, 1], -normals[c, 2])
        judged = judge_surfaces(
            pools, elements, a, b, rotation, translation, deepest, (nx, ny, nz), epsilon * radius, work, scratch, thread
        )
        between.asked[p] = judged.asked
        depth = judged.depth
        if judged.side != NOBODY:
            put_surface_contact(
                pools, a, b, rotation, translation, judged, epsilon * radius, near * radius, work,
                between.contacts[p : p + 1], between.ids[p : p + 1], scratch, thread,
            )  # fmt: skip
            between.has_contact[p] = True
            depth = max(depth, -between.contacts[p, 9])
        if judged.bound == math.inf:
            exhausted[p] = BY_LIMIT
        bounds[p] = max(bounds[p], judged.bound, depth + epsilon * radius)


@kernel
def _insert(pairs, rotations, positions, offsets, found, between, points_a, points_b, normals, gaps, samples):
    """Write the contacts of `found`, those of each pair followed by what was found between samples, to new arrays."""
    o = 0
    for p in range(len(pairs)):
        for c in range(offsets[p], offsets[p + 1]):
            points_a[o], points_b[o], normals[o] = found.points_a[c], found.points_b[c], found.normals[c]
            gaps[o], samples[o] = found.gaps[c], found.samples[c]
            o += 1
        if between.has_contact[p]:
            put_in_world(
                pairs[p], rotations, positions, between.contacts[p], between.ids[p], o, points_a, points_b, normals,
                gaps, samples,
            )  # fmt: skip
            o += 1

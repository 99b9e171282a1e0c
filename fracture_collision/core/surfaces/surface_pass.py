"""Surface search for all pairs of a step, after their samples: bounds for whole surfaces, contacts between samples."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from fracture_collision.core.contacts.contact_choice import Rule
from fracture_collision.core.contacts.contact_places import make_world_contacts, put_in_world
from fracture_collision.core.memory.compiled import kernel, query_kernel, threaded_kernel
from fracture_collision.core.memory.crew import Crew
from fracture_collision.core.memory.kinds import WITH_FACES
from fracture_collision.core.memory.pair import Sink, Step, put_pair
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.memory.rotations import turned_back
from fracture_collision.core.mesh.surface_elements import ElementTable
from fracture_collision.core.search.depth_limits import depth_limit_of_pair
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.core.search.scratch import Scratch
from fracture_collision.core.search.traversal import BY_LIMIT, COMPLETE
from fracture_collision.core.surfaces.surface_certificate import NOBODY, judge_surfaces
from fracture_collision.core.surfaces.surface_contact import put_surface_contact
from fracture_collision.grouping import begins_of


class Between(NamedTuple):
    """Results between samples, of p pairs: at most one contact each."""

    has_contact: np.ndarray  # (p,) bool
    found: Sink  # p rows
    asked: np.ndarray  # (p,) int64: points queried


class Judged(NamedTuple):
    """What threads write, each pair its own row."""

    bounds: np.ndarray  # (p,) float64 [m]; infinity: MOST_ASKED did not suffice
    exhausted: np.ndarray  # (p,) uint8
    between: Between


def judge_pairs(
    pools: Pools, elements: ElementTable, step: Step, work: tuple[np.ndarray, np.ndarray], rule: Rule,
    found: PairContacts, scratch: tuple[Scratch, ...], crew: Crew,
) -> PairContacts:  # fmt: skip
    """`found` with bounds that hold for whole surfaces, and with deeper points between samples added.

    work: the pairs `todo` (m,) of the Step that `found` was searched for, and whether the visits of each pair were
    unlimited (p,): others get only a bound. rule: with epsilon and near as shares of the smaller R.
    """
    todo, is_free = work
    rows, pairs = step.rows, step.pairs
    kinds = pools.fragment.kind[rows]
    has_edges = np.isin(kinds, WITH_FACES)
    todo = todo[has_edges[pairs[todo]].all(axis=1)]
    p = len(pairs)
    bounds, exhausted = found.bounds.copy(), found.exhausted.copy()
    between = Between(np.zeros(p, np.bool_), Sink(np.empty((p, 10)), np.empty((p, 5), np.int64)), np.zeros(p, np.int64))
    is_open = is_free[todo] & (found.exhausted[todo] == COMPLETE)
    _bound_by_thickness(pools, step, todo[~is_open], bounds, scratch[0])
    todo = todo[is_open]
    if len(todo):
        table = elements.of(pools, np.unique(rows[pairs[todo]]))
        known, judged = (found, begins_of(found.counts)), Judged(bounds, exhausted, between)
        crew.share(_judge_share, (pools, table), step, todo, rule, known, judged, own=scratch)
    cut = np.flatnonzero(bounds == np.inf)
    bounds[cut] = found.bounds[cut]
    _bound_by_thickness(pools, step, cut, bounds, scratch[0])
    visits = found.visits + between.asked
    if not between.has_contact.any():
        return found._replace(bounds=bounds, visits=visits, exhausted=exhausted)
    counts = found.counts + between.has_contact
    total = int(counts.sum())
    columns = make_world_contacts(total)
    _insert(step, begins_of(found.counts), found, between, columns)
    return PairContacts(counts, bounds, visits, exhausted, *columns)


@query_kernel
def _bound_by_thickness(pools, step, todo, bounds, scratch):
    """Set bounds for the surfaces of pairs that are not searched."""
    for p in todo:
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        bounds[p] = max(bounds[p], depth_limit_of_pair(pools, pair))


@threaded_kernel
def _judge_share(geometry, step, todo, rule, found, out, scratch, part):
    """Process every pair of `todo` that is a thread's, see Crew.share.

    geometry: pools and Elements; rule: as in judge_pairs; found: PairContacts and their offsets; out: Judged.
    """
    pools, elements = geometry
    thread, threads = part
    contacts, offsets = found
    for turn in range(thread, len(todo), threads):
        p = todo[turn]
        pair = put_pair(step, p, scratch.rotation, scratch.translation)
        radius = min(pools.fragment.radius[pair.a], pools.fragment.radius[pair.b])
        deepest, nx, ny, nz = -math.inf, 0.0, 0.0, 0.0
        for c in range(offsets[p], offsets[p + 1]):
            if -contacts.gaps[c] > deepest:
                deepest = -contacts.gaps[c]
                # from a to b in the world; out of b in its frame
                n = contacts.normals[c]
                nx, ny, nz = turned_back(step.rotations[step.pairs[p, 1]], -n[0], -n[1], -n[2])
        epsilon, between = rule.epsilon * radius, out.between
        judged = judge_surfaces(pools, elements, pair, deepest, (nx, ny, nz), epsilon, scratch)
        between.asked[p] = judged.asked
        depth = judged.depth
        if judged.side != NOBODY:
            sink = Sink(between.found.contacts[p : p + 1], between.found.ids[p : p + 1])
            put_surface_contact(pools, pair, judged, epsilon, rule.near * radius, sink, scratch)
            between.has_contact[p] = True
            depth = max(depth, -sink.contacts[0, 9])
        if judged.bound == math.inf:
            out.exhausted[p] = BY_LIMIT
        out.bounds[p] = max(out.bounds[p], judged.bound, depth + epsilon)


@kernel
def _insert(step, offsets, found, between, out):
    """Write the contacts of `found`, each pair's followed by what was found between samples, to WorldContacts."""
    points_a, points_b, normals, gaps, samples = out
    o = 0
    for p in range(len(step.pairs)):
        for c in range(offsets[p], offsets[p + 1]):
            points_a[o], points_b[o], normals[o] = found.points_a[c], found.points_b[c], found.normals[c]
            gaps[o], samples[o] = found.gaps[c], found.samples[c]
            o += 1
        if between.has_contact[p]:
            put_in_world(step, p, between.found, p, out, o)
            o += 1

"""Build the answer message from the contacts of the pairs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.search.kept_answer import PairContacts
from fracture_collision.records import BUDGET_EXHAUSTED, ContactConstraintArray
from fracture_collision.world.combined_friction import combined_friction, combined_restitution
from fracture_collision.world.contact_ids import contact_ids
from fracture_collision.world.gates.states_gate import CheckedStates
from fracture_collision.world.present import Present
from fracture_collision.world.settings import Settings


def contact_answer(
    checked: CheckedStates, here: Present, radius: np.ndarray, pairs: np.ndarray, found: PairContacts,
    settings: Settings,
) -> ContactConstraintArray:  # fmt: skip
    """Build the answer from the pairs (p, 2), indices into `here`, and the contacts `found` for them with `settings`.

    It lists pairs that have contacts or a missed depth bound above the penetration tolerance, a share of the smaller of
    their `radius` (n,) [m]. Its contact arrays are those of `found`, not copies.
    """
    tolerance = settings.penetration_tolerance
    fragments = _Fragments(here.ids, here.friction, here.restitution, radius)
    results = _Results(found.counts, found.bounds, found.exhausted, found.samples)
    a, b, begin, bounds, friction, restitution, keys, exhausted = _list_pairs(fragments, pairs, results, tolerance)
    return ContactConstraintArray(
        step=checked.step,
        fracture_sequence=checked.fracture_sequence,
        status=BUDGET_EXHAUSTED if exhausted else 0,
        fragment_a=a,
        fragment_b=b,
        pair_begin=begin,
        missed_depth_bound=bounds,
        friction=friction,
        restitution=restitution,
        points_a=found.points_a,
        points_b=found.points_b,
        normals=found.normals,
        gaps=found.gaps,
        contact_ids=keys,
        lookahead=float(settings.lookahead),
    )


class _Fragments(NamedTuple):
    """What an answer takes from the n fragments of a step."""

    ids: np.ndarray  # (n,) int64
    friction: np.ndarray  # (n,)
    restitution: np.ndarray  # (n,)
    radius: np.ndarray  # (n,) [m]


class _Results(NamedTuple):
    """What an answer takes from PairContacts: p pairs, N contacts in all."""

    counts: np.ndarray  # (p,) int64
    bounds: np.ndarray  # (p,) [m]
    exhausted: np.ndarray  # (p,) uint8
    samples: np.ndarray  # (N, 2) int64


@kernel
def _list_pairs(fragments, pairs, found, tolerance):
    ids, friction, restitution, radius = fragments
    counts, bounds, exhausted, samples = found
    n, exhausted_any = 0, False
    is_listed = np.empty(len(pairs), np.bool_)
    for p in range(len(pairs)):
        epsilon = tolerance * min(radius[pairs[p, 0]], radius[pairs[p, 1]])
        is_listed[p] = counts[p] > 0 or bounds[p] > epsilon
        n += is_listed[p]
        exhausted_any |= exhausted[p] != 0
    a, b, begin = np.empty(n, np.uint32), np.empty(n, np.uint32), np.zeros(n + 1, np.uint32)
    missed, of_friction, of_restitution = np.empty(n), np.empty(n), np.empty(n)
    own, other, numbers = np.empty((3, len(samples)), np.int64)
    k = contact = 0
    for p in range(len(pairs)):
        if not is_listed[p]:
            continue
        i, j = pairs[p, 0], pairs[p, 1]
        a[k], b[k], missed[k] = ids[i], ids[j], bounds[p]
        of_friction[k] = combined_friction(friction[i], friction[j])
        of_restitution[k] = combined_restitution(restitution[i], restitution[j])
        for _ in range(counts[p]):
            from_a = samples[contact, 0] == 0
            own[contact], other[contact] = (ids[i], ids[j]) if from_a else (ids[j], ids[i])
            numbers[contact] = samples[contact, 1]
            contact += 1
        k += 1
        begin[k] = contact
    keys = np.empty(len(samples), np.uint64)
    contact_ids(own, other, numbers, keys)
    return a, b, begin, missed, of_friction, of_restitution, keys, exhausted_any

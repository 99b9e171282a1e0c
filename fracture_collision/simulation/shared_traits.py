"""What the bodies of touching fragments have in common: looked up for the pairs of a step's contacts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.records import ContactConstraintArray
from fracture_collision.simulation.body_traits import Traits
from fracture_collision.simulation.cast import Cast
from fracture_collision.simulation.engine.engine import rows_of


class SharedTraits(NamedTuple):
    """Of p pairs."""

    body_a: np.ndarray  # (p,) int64 rows of the bodies, n for what cannot move
    body_b: np.ndarray  # (p,) int64
    rolling_arm: np.ndarray  # (p,) [m] the larger one
    sizes: np.ndarray  # (p,) R [m], the smaller one
    is_one_body: np.ndarray  # (p,) bool: fragments of one body


def shared_traits(contacts: ContactConstraintArray, traits: Traits, cast: Cast) -> SharedTraits:
    """Traits of the pairs of `contacts`. ValueError if a fragment is neither among the n of `traits` nor static."""
    immovable = len(traits.fragment_ids)

    def of(fragments: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        rows = rows_of(fragments, traits.fragment_ids)
        arms, sizes = traits.rolling_arms[rows], traits.forms.sizes[rows]
        for fragment in np.unique(fragments[rows == immovable]).tolist():
            if fragment not in cast.body_id_of or not cast.scene_body(fragment).is_static:
                raise ValueError(f"contacts of step {contacts.step}: fragment {fragment} is not in the states")
            arms[fragments == fragment] = cast.scene_body(fragment).material.rolling_arm
            sizes[fragments == fragment] = cast.sizes[fragment]
        return rows, arms, sizes

    (a, arms_a, sizes_a), (b, arms_b, sizes_b) = of(contacts.fragment_a), of(contacts.fragment_b)
    is_one_body = (traits.body_ids[a] == traits.body_ids[b]) & (a < immovable)
    return SharedTraits(a, b, np.maximum(arms_a, arms_b), np.minimum(sizes_a, sizes_b), is_one_body)

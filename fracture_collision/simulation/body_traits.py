"""Scene properties of the bodies in motion, as arrays: looked up when bodies come or go, not for every contact."""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import NamedTuple

import numpy as np

from fracture_collision.simulation.breakable_body import BreakableBody
from fracture_collision.simulation.engine.engine import BodyStates
from fracture_collision.simulation.scene.scene import SceneBody
from fracture_collision.simulation.solver.touch_ahead import Forms


class Traits(NamedTuple):
    """Of n bodies in motion."""

    fragment_ids: np.ndarray  # (n,) uint32, in the engine's order
    body_ids: np.ndarray  # (n + 1,) int64; the last, -1, for what cannot move
    rolling_arms: np.ndarray  # (n + 1,) [m]; the last, 0, for what cannot move
    strengths: np.ndarray  # (n,) [N s]; inf for what does not break
    forms: Forms


def traits_of(
    states: BodyStates,
    bodies: Mapping[int, SceneBody],
    sizes: Mapping[int, float],
    body_ids: Mapping[int, int],
    breakable: Mapping[int, BreakableBody],
    held_together: Container[int],
) -> Traits:
    """Traits of the bodies in `states`.

    The other arguments are the simulation's own tables: `bodies`, their R `sizes` [m] and `breakable` by body id,
    `body_ids` by fragment id, `held_together`: fragments that do not break.
    """
    numbers = np.array([*(body_ids[fragment] for fragment in states.fragment_ids.tolist()), -1], dtype=np.int64)
    arms, strengths = np.zeros(len(states.masses) + 1), np.full(len(states.masses), np.inf)
    forms = Forms(np.zeros(len(arms), np.bool_), np.full(len(arms), np.inf))
    for i, (fragment_id, body_id) in enumerate(zip(states.fragment_ids.tolist(), numbers.tolist(), strict=False)):
        material, mesh = bodies[body_id].material, breakable.get(body_id)
        fracture, arms[i] = material.fracture, material.rolling_arm
        forms.is_round[i], forms.sizes[i] = bodies[body_id].shape.kind == "sphere", sizes[body_id]
        if (
            fracture is not None
            and mesh is not None
            and fragment_id not in held_together
            and states.masses[i] >= fracture.minimum_mass
            and mesh.node_count(fragment_id) >= 2 * fracture.pattern.minimum_nodes
        ):
            strengths[i] = fracture.strength
    return Traits(states.fragment_ids, numbers, arms, strengths, forms)

"""Worlds for comparison: our method at samples alone, and one that remembers nothing."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.edges.ridges import NO_RIDGES
from fracture_collision.core.lookahead.motion import Motion
from fracture_collision.core.memory.pair import Step
from fracture_collision.core.pair.narrow_phase import Scene
from fracture_collision.core.patches.shapes import NO_SHAPES, Geometry
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world import CollisionWorld, Settings
from worlds.fractured_worlds import FracturedWorld, with_messages

EVERY = 1 << 20  # contacts per pair that no pair has


class SampledWorld(CollisionWorld):
    """Neither patches of surfaces nor crossings of ridges, to test the search of samples."""

    def _scene(self, step: Step, motion: Motion) -> Scene:
        scene = super()._scene(step, motion)
        return scene._replace(geometry=Geometry(scene.geometry.pools, NO_RIDGES, NO_SHAPES), whole=None)


class ForgetfulWorld(CollisionWorld):
    """Every answer is a first one."""

    def contacts(self, states: FragmentStates) -> ContactConstraintArray:
        self.forget()
        return super().contacts(states)


def sampled_world(case: FracturedWorld, settings: Settings) -> SampledWorld:
    """With the messages of `case`."""
    return with_messages(SampledWorld(settings), case)


def in_order(answer: ContactConstraintArray) -> ContactConstraintArray:
    """With the contacts of each pair by their ids: the paper's method lists them as it finds them."""
    pair = np.repeat(np.arange(len(answer.fragment_a)), np.diff(answer.pair_begin))
    order = np.lexsort((answer.contact_ids, pair))
    places = {name: getattr(answer, name).reshape(-1, 3)[order] for name in ("points_a", "points_b", "normals")}
    return answer._replace(
        **{name: rows.ravel() for name, rows in places.items()},
        gaps=answer.gaps[order], contact_ids=answer.contact_ids[order],
    )  # fmt: skip

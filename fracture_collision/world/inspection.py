"""Views into a CollisionWorld for users; no answer needs them.

Spheres of a tree's level, the field on a plane, all contacts that an answer could have listed, and the difference
between these and the answer.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.core.field.elementary_queries import INSIDE, probe
from fracture_collision.core.memory.compiled import threaded_kernel
from fracture_collision.core.memory.kinds import PLANE
from fracture_collision.core.memory.pools import Pools
from fracture_collision.core.pair.broad_phase import world_boxes
from fracture_collision.core.search.scratch import make_scratch
from fracture_collision.portable_math import products
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.world.collision_world import CollisionWorld
from fracture_collision.world.present import Present

# Contacts per pair to list all of them.
EVERY_CONTACT = 1 << 30
# Of a plane across x, y or z: the axis that its columns go along, and that of its rows.
PLANE_AXES = ((1, 2), (0, 2), (0, 1))
NOBODY = -1  # no fragment's id
ROUNDING = 1e-9  # of depths, as a share
FINEST = 192  # cells along the longer side of a plane's grid, by default


class LevelSpheres(NamedTuple):
    """A cover of the samples of each fragment.

    It has n spheres: those of one level of its tree, and the leaf samples above that level, with radius 0.
    """

    fragment_ids: np.ndarray  # (n,) int64
    centres: np.ndarray  # (n, 3) [m] body frame
    radii: np.ndarray  # (n,) [m]
    deepest: int  # level of all the trees


class PlaneField(NamedTuple):
    """Depths at the middles of the cells of a grid across an axis; rows and columns go along PLANE_AXES of it."""

    axis: int  # 0, 1, 2: x, y, z
    place: float  # [m] along it, world
    corner: np.ndarray  # (2,) [m] of the first cell, where its column and its row begin, world
    cell: float  # [m] edge
    owners: np.ndarray  # (rows, columns) int64 id of the fragment around the point (the deepest), or NOBODY
    depths: np.ndarray  # (rows, columns) [m] to the nearest surface of that fragment; 0 for NOBODY
    shared: np.ndarray  # (rows, columns) bool: inside more than one fragment


class AnswerErrors(NamedTuple):
    """An answer compared with all contacts of the exact field, along the shortest ways out."""

    listed: int  # contacts
    colliding: int  # all contacts
    unlisted: float  # [m] deepest penetration that is not listed, and deeper than all that are listed of its pair
    promised: float  # [m] depth that the missed depth bounds, or epsilon for a pair without one, allow to be unlisted


def asked_with(world: CollisionWorld, states: FragmentStates, **settings: Any) -> ContactConstraintArray:
    """The contacts that a world with other `settings` would answer at `states`.

    `world` keeps its own settings.
    """
    chosen = world.settings
    world.change_settings(chosen._replace(**settings))
    try:
        return world.contacts(states)
    finally:
        world.change_settings(chosen)


def every_contact(world: CollisionWorld, states: FragmentStates) -> ContactConstraintArray:
    """The contacts at `states` if each pair had room for all: what self-adapting selection (5.2) chooses from."""
    return asked_with(
        world, states, contacts_per_pair=EVERY_CONTACT, max_work=EVERY_CONTACT, max_contacts=EVERY_CONTACT
    )


def errors_of(
    answer: ContactConstraintArray, every: ContactConstraintArray, world: CollisionWorld, here: Present, epsilon: float
) -> AnswerErrors:
    """Compare an answer with all contacts.

    `every`: every_contact for the same states, of a `world` of method glondu2014 with the exact field, with `here`
    present; `epsilon`: the penetration tolerance of the answer, a share of R.
    """
    listed = np.zeros(len(every.fragment_a))
    keys, named = _pair_keys(every), _pair_keys(answer)
    row = np.searchsorted(named, keys).clip(max=max(len(named) - 1, 0))
    # a pair absent from the answer has no contact and nothing deeper than epsilon
    unnamed = named[row] != keys if len(named) else np.ones(len(keys), bool)
    listed[~unnamed] = _deepest(answer)[row[~unnamed]]
    is_deeper = -every.gaps > (1.0 + ROUNDING) * listed[_pair_of_each(every)]
    is_unlisted = is_deeper & ~np.isin(every.contact_ids, answer.contact_ids)
    promised = answer.missed_depth_bound.max(initial=0.0)
    radius = world.geometry.pools.fragment.radius[here.rows]
    ends = (radius[np.searchsorted(here.ids, end[unnamed])] for end in (every.fragment_a, every.fragment_b))
    return AnswerErrors(
        listed=len(answer.gaps),
        colliding=len(every.gaps),
        unlisted=float((-every.gaps[is_unlisted]).max(initial=0.0)),
        promised=float(max(promised, (epsilon * np.minimum(*ends)).max(initial=0.0))),
    )


def _deepest(contacts: ContactConstraintArray) -> np.ndarray:
    """Depth (p,) [m] of the deepest contact of each pair; 0: none is deep."""
    deepest = np.zeros(len(contacts.fragment_a))
    np.maximum.at(deepest, _pair_of_each(contacts), -contacts.gaps)
    return deepest


def _pair_of_each(contacts: ContactConstraintArray) -> np.ndarray:
    """(N,) the pair of each contact."""
    return np.repeat(np.arange(len(contacts.fragment_a)), np.diff(contacts.pair_begin).astype(np.int64))


def _pair_keys(contacts: ContactConstraintArray) -> np.ndarray:
    return contacts.fragment_a.astype(np.uint64) << np.uint64(32) | contacts.fragment_b.astype(np.uint64)


def spheres_of_level(world: CollisionWorld, here: Present, level: int) -> LevelSpheres:
    """Of the movable fragments in `here`; level 0: one sphere each. Planes and spheres have no tree.

    The world's method must be glondu2014: the other has no trees.
    """
    paper = world.geometry.paper
    assert paper is not None, "method exact has no trees"
    ids, centres, radii, deepest = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros(0)], 0
    for fragment_id, row in zip(here.ids[~here.is_static].tolist(), here.rows[~here.is_static].tolist(), strict=True):
        tree = paper.sphere_tree(row)
        if not len(tree.size):
            continue
        levels = _levels(tree.size)
        cover = (levels == level) | ((levels < level) & (tree.size == 1))
        ids.append(np.full(np.count_nonzero(cover), fragment_id))
        centres.append(tree.center[cover])
        radii.append(tree.radius[cover])
        deepest = max(deepest, int(levels.max()))
    return LevelSpheres(np.concatenate(ids), np.concatenate(centres), np.concatenate(radii), deepest)


def _levels(sizes: np.ndarray) -> np.ndarray:
    """Depth (n,) of each entry of a tree in preorder whose subtrees have `sizes` (n,) entries."""
    count = len(sizes)
    begun = np.arange(count + 1)  # entries before each one; their subtrees have begun
    ended = np.cumsum(np.bincount(np.arange(count) + sizes, minlength=count + 1))
    return (begun - ended)[:count]


def reach_along(world: CollisionWorld, here: Present, axis: int) -> tuple[float, float] | None:
    """[m] Lower and upper end of the boxes of movable fragments along a world axis; None if nothing can move."""
    boxes, _ = _solid_boxes(world.geometry.pools, here)
    boxes = boxes[~here.is_static & np.isfinite(boxes).all(axis=1)]
    return (float(boxes[:, axis].min()), float(boxes[:, axis + 3].max())) if len(boxes) else None


def field_on_plane(
    world: CollisionWorld, here: Present, axis: int, place: float, finest: int = FINEST
) -> PlaneField | None:
    """The field on the plane at `place` [m] across a world axis, over the movable fragments that it cuts.

    None if it cuts none. The field is that of the world's settings; `finest`: cells along the longer side. Includes
    static bodies in that area, but no planes.
    """
    pools = world.geometry.pools
    boxes, is_solid = _solid_boxes(pools, here)
    cut = is_solid & (boxes[:, axis] <= place) & (place <= boxes[:, axis + 3])
    sized_by = cut & ~here.is_static
    if not sized_by.any():
        return None
    across = list(PLANE_AXES[axis])
    low, high = boxes[sized_by, :3][:, across].min(axis=0), boxes[sized_by, 3:][:, across].max(axis=0)
    cell = float((high - low).max()) / finest
    columns, rows = (max(math.ceil((high[k] - low[k]) / cell), 1) for k in range(2))
    owners, depths = np.full((rows, columns), NOBODY), np.full((rows, columns), -np.inf)
    shared = np.zeros((rows, columns), dtype=bool)
    scratch = make_scratch(len(pools.mesh.tetrahedra), 1)
    for i in np.flatnonzero(cut).tolist():
        first = np.floor((boxes[i, :3][across] - low) / cell).astype(int).clip(0, (columns, rows))
        last = np.ceil((boxes[i, 3:][across] - low) / cell).astype(int).clip(0, (columns, rows))
        part = slice(first[1], last[1]), slice(first[0], last[0])
        points = np.full((*owners[part].shape, 3), place)
        points[..., across[0]] = low[0] + cell * (np.arange(first[0], last[0]) + 0.5)
        points[..., across[1]] = low[1] + cell * (np.arange(first[1], last[1]) + 0.5)[:, None]
        own = products(points.reshape(-1, 3) - here.positions[i], here.rotations[i])
        depth = np.empty(owners[part].shape)
        _depths_inside(pools, here.rows[i], np.ascontiguousarray(own), depth.reshape(-1), scratch)
        shared[part] |= (depth > 0.0) & (depths[part] > 0.0)
        is_deepest = depth > depths[part]
        owners[part][is_deepest] = here.ids[i]
        depths[part][is_deepest] = depth[is_deepest]
    return PlaneField(axis, place, low, cell, owners, np.maximum(depths, 0.0), shared)


@threaded_kernel
def _depths_inside(pools, row, points, depths, scratch):
    """Depth (n,) [m] of points (n, 3) [m] in the body frame of fragment `row`; minus infinity outside."""
    for i in range(len(points)):
        answer = probe(pools, row, (points[i, 0], points[i, 1], points[i, 2]), 0.0, math.inf, scratch)
        depths[i] = -answer[1] if answer[0] == INSIDE else -math.inf


def _solid_boxes(pools: Pools, here: Present) -> tuple[np.ndarray, np.ndarray]:
    """World boxes (n, 6) [m] of the fragments in `here`, and which of them are not planes (n,)."""
    boxes = np.empty((len(here.rows), 6))
    world_boxes(pools.fragment.box, here.rows, here.rotations, here.positions, np.zeros(len(here.rows)), boxes)
    return boxes, pools.fragment.kind[here.rows] != PLANE

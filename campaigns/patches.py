"""A scene whose contacts between surfaces come from one direction per pair: to compare both rules, until it is the rule.

    python -m campaigns.patches FILE.yaml [--seconds 2] [--today]
"""

from __future__ import annotations

import math
from pathlib import Path
from time import perf_counter
from typing import Any

import click
import numpy as np

from fracture_collision.core.lookahead.motion import Motion, motion_of, put_pose
from fracture_collision.core.memory.kinds import WITH_FACES
from fracture_collision.core.memory.pools import NEVER_BROKEN
from fracture_collision.core.patches.pair_contacts import Placing, mesh_patch
from fracture_collision.core.patches.shapes import ShapeTable
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.world import Settings

EPSILON = Settings().penetration_tolerance
GRAVITY = np.array([0.0, 0.0, -9.81])


class Patched(Lockstep):
    """Lockstep whose answers have patches where both of a pair have surfaces."""

    def __init__(self, scene: Any, settings: Settings, **more: Any) -> None:
        super().__init__(scene, settings, **more)
        self._theirs, self.world.contacts = self.world.contacts, self._contacts
        self._table, self._rows = ShapeTable(), 0
        self.seconds = 0.0

    def _contacts(self, states: FragmentStates) -> ContactConstraintArray:
        original = self._theirs(states)
        began = perf_counter()
        here, geometry, step = self.world.present(states), self.world.geometry, self.world.settings.lookahead
        pools = geometry.pools
        count = len(pools.fragment.kind)
        if count < self._rows:
            self._table, self._rows = ShapeTable(), 0
        for row in range(self._rows, count):
            self._table.append(pools, row, row + 1)
        self._rows = count
        shapes, kinds = self._table.view, pools.fragment.kind
        linear = here.linear + np.where(here.is_static[:, None], 0.0, step * GRAVITY)
        centers = np.zeros_like(here.positions)
        motion: Motion = motion_of(
            kinds, pools.fragment.box, (here.rows, here.rotations, here.positions), centers, (linear, here.angular), step
        )
        ends = here.rotations.copy(), here.positions.copy()
        for i in range(len(here.ids)):
            put_pose(motion, here.rotations, here.positions, i, step, ends[0][i], ends[1][i])
        columns: list[list[Any]] = [[] for _ in range(11)]
        known = {
            (int(a), int(b)): k for k, (a, b) in enumerate(zip(original.fragment_a, original.fragment_b, strict=True))
        }
        for i, j in self._pairs(pools, here, ends, kinds):
            a, b = here.rows[i], here.rows[j]
            pair = int(here.ids[i]), int(here.ids[j])
            if kinds[a] in WITH_FACES and kinds[b] in WITH_FACES:
                found = self._patch(pools, shapes, here, ends, i, j)
            else:
                found = self._kept(original, known.get(pair))
            if found is not None:
                values = (
                    *pair, math.sqrt(here.friction[i] * here.friction[j]),
                    max(here.restitution[i], here.restitution[j]), 0.0, *found,
                )  # fmt: skip
                for column, value in zip(columns, values, strict=True):
                    column.append(value)
        answer = self._assembled(original, columns)
        self.seconds += perf_counter() - began
        return answer

    def _pairs(self, pools: Any, here: Any, ends: Any, kinds: np.ndarray) -> list[tuple[int, int]]:
        n = len(here.ids)
        low, high = np.full((n, 3), -np.inf), np.full((n, 3), np.inf)
        for i in range(n):
            box = pools.fragment.box[here.rows[i]]
            if np.isfinite(box).all():
                corners = np.array([[box[0 + 3 * (c & 1)], box[1 + 3 * (c >> 1 & 1)], box[2 + 3 * (c >> 2)]]
                                    for c in range(8)])  # fmt: skip
                both = np.vstack((corners @ here.rotations[i].T + here.positions[i], corners @ ends[0][i].T + ends[1][i]))
                reach = 2.0 * EPSILON * pools.fragment.radius[here.rows[i]]
                low[i], high[i] = both.min(axis=0) - reach, both.max(axis=0) + reach
        meets = (low[:, None] <= high[None]).all(axis=2) & (low[None] <= high[:, None]).all(axis=2)
        meets &= ~(here.is_static[:, None] & here.is_static[None])
        return [(int(i), int(j)) for i, j in np.argwhere(np.triu(meets, 1))]

    def _patch(self, pools: Any, shapes: Any, here: Any, ends: Any, i: int, j: int) -> Any:
        frame, origin = here.rotations[j], here.positions[j]
        placings = tuple(
            Placing(
                np.ascontiguousarray([frame.T @ here.rotations[k], frame.T @ ends[0][k]]),
                np.ascontiguousarray([frame.T @ (here.positions[k] - origin), frame.T @ (ends[1][k] - origin)]),
            )
            for k in (i, j)
        )
        a, b = int(here.rows[i]), int(here.rows[j])
        tolerance = EPSILON * min(pools.fragment.radius[a], pools.fragment.radius[b])
        shift, moved = pools.fragment.node_shift, math.inf
        if shift[a] != NEVER_BROKEN and shift[a] == shift[b]:
            first, last = shapes.first[a, 0], shapes.first[a + 1, 0]
            hull = np.column_stack([column[first:last] for column in shapes.hull[:3]])
            in_b = hull @ placings[0].rotations[0].T + placings[0].positions[0]
            moved = float(np.linalg.norm(in_b - hull, axis=1).max())
        b_first = bool(here.is_static[j] and not here.is_static[i])
        patch = mesh_patch(shapes, (a, b), placings, tolerance, b_first, moved, 8)
        if not len(patch.gaps):
            return None
        normal = frame @ patch.normal
        points = patch.points @ frame.T + origin
        ids = np.array([hash((int(here.ids[i]), int(here.ids[j]), int(n))) & (2**64 - 1) for n in patch.numbers], np.uint64)
        return points, points + patch.gaps[:, None] * normal, np.tile(normal, (len(ids), 1)), patch.gaps, ids, len(ids)

    @staticmethod
    def _kept(original: ContactConstraintArray, k: int | None) -> Any:
        if k is None:
            return None
        rows = slice(int(original.pair_begin[k]), int(original.pair_begin[k + 1]))
        points = (getattr(original, name).reshape(-1, 3)[rows] for name in ("points_a", "points_b", "normals"))
        return *points, original.gaps[rows], original.contact_ids[rows], rows.stop - rows.start

    @staticmethod
    def _assembled(original: ContactConstraintArray, columns: list[list[Any]]) -> ContactConstraintArray:
        a, b, friction, restitution, bound, points_a, points_b, normals, gaps, ids, counts = columns

        def joined(parts: list[Any], kind: type) -> np.ndarray:
            return np.concatenate([np.asarray(part, kind).ravel() for part in parts] or [np.zeros(0, kind)])

        return original._replace(
            fragment_a=np.array(a, np.uint32), fragment_b=np.array(b, np.uint32), friction=np.array(friction),
            restitution=np.array(restitution), missed_depth_bound=np.array(bound),
            pair_begin=np.concatenate([[0], np.cumsum(counts)]).astype(np.uint32), points_a=joined(points_a, float),
            points_b=joined(points_b, float), normals=joined(normals, float), gaps=joined(gaps, float),
            contact_ids=joined(ids, np.uint64), status=0,
        )  # fmt: skip


@click.command()
@click.argument("scene")
@click.option("--seconds", default=2.0)
@click.option("--today", is_flag=True, help="The present rule instead.")
def main(scene: str, seconds: float, today: bool) -> None:
    """Runs a scene and prints where its bodies end."""
    what = load_scene(Path(scene) if scene.endswith(".yaml") else scene)._replace(duration=seconds)
    settings = Settings(threads=1, lookahead=what.time_step)
    with (Lockstep if today else Patched)(what, settings) as run:
        deepest = 0.0
        for exchange in run:
            deepest = min(deepest, exchange.contacts.gaps.min(initial=0.0))
        places = exchange.states.positions.reshape(-1, 3)
        for i, place in zip(exchange.states.fragment_ids, places, strict=True):
            print(i, np.round(place, 5))
        print("speed", exchange.report.max_speed, "deepest, mm", 1e3 * deepest)


if __name__ == "__main__":
    main()

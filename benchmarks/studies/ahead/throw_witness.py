"""Gaps around the thrown body at each moment of a simulation's steps, and penetration depths: the judge of throws.py.

The service reports what is near. If it is deep, libigl computes the depth: for crossing edges the service measures
along the direction across both, which may far exceed the depth of either body in the other.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.simulation.simulation import Simulation
from fracture_collision.world import CollisionWorld, Settings

sys.path.append(str(Path(__file__).resolve().parents[3] / "test"))  # the ground truth lives with the tests
from truth.surface_truth import Solid  # noqa: E402

DEEP = 5e-4  # [m]
TARGET_ID, THROWN_ID = 1, 2


class Step(NamedTuple):
    states: FragmentStates  # at its beginning
    time: float  # [s] duration
    before: BodyStates
    linear: np.ndarray  # (n, 3) [m/s] velocity of centres within it
    angular: np.ndarray  # (n, 3) [rad/s]
    shares: np.ndarray  # (n,) fraction of the step after which they stand still
    energy: float  # [J] after it


class Witness:
    """Queried at each moment for what is near the thrown body; `world` gets its input from the first run."""

    def __init__(self, scene: Scene) -> None:
        self.world = CollisionWorld(Settings(threads=1))
        self._reach = dict.fromkeys((TARGET_ID, THROWN_ID), np.inf)  # [m] around the body frame's origin
        self._solids: dict[int, Solid | None] = {}
        simulation = Simulation(scene)
        for body in simulation.start_bodies():
            if body.vertices.size:
                self._reach[body.body_id] = float(np.linalg.norm(body.vertices.reshape(-1, 3), axis=1).max())
            elif body.primitive.dimensions:
                self._reach[body.body_id] = float(np.linalg.norm(body.primitive.dimensions))
        simulation.close()

    def gaps(self, steps: list[Step], leap: float) -> Iterator[float]:
        """[m] The least gap of the thrown body to any other, at each moment at which it is within epsilon of one.

        Between two moments it moves no farther than `leap` [m] relative to any other.
        """
        for step in steps:
            yield from self._gaps_within(step, leap)

    def _gaps_within(self, step: Step, leap: float) -> Iterator[float]:
        before, h = step.before, step.time
        ids = step.states.fragment_ids
        rows, mine = np.searchsorted(ids, before.fragment_ids), before.fragment_ids == THROWN_ID
        reach, other_reach = self._reach[THROWN_ID], self._reach[TARGET_ID]
        v, w, places = step.linear, np.linalg.norm(step.angular, axis=1), before.frame_positions.copy()
        others = ~mine
        if mine.all():  # the target stands still, at the origin
            v, w, places = np.vstack([v, np.zeros(3)]), np.append(w, 0.0), np.vstack([places, np.zeros(3)])
            mine, others = np.array([True, False]), np.array([False, True])
        arms, frames = before.frame_positions - before.centers, Rotation.from_quat(before.frame_orientations)
        arm = float(np.linalg.norm(arms, axis=1).max())
        turns = (reach + arm) * w[mine] + (0.0 if np.isinf(other_reach) else (other_reach + arm) * w[others])
        way = h * float((np.linalg.norm(v[others] - v[mine], axis=1) + turns).max())
        if not self._may_touch(places[mine], places[others], way):
            return
        positions, orientations = step.states.positions.reshape(-1, 3), step.states.orientations.reshape(-1, 4)
        count = int(np.ceil(way / leap)) + 1
        times = h * np.arange(count) / count
        for t in times[times <= h * step.shares.max() + h / count]:
            moved = np.minimum(t, h * step.shares)[:, None]
            turn = Rotation.from_rotvec(moved * step.angular)
            places[: len(rows)] = before.centers + moved * step.linear + turn.apply(arms)
            if not self._may_touch(places[mine], places[others], leap):
                continue
            positions, orientations = positions.copy(), orientations.copy()
            positions[rows], orientations[rows] = places[: len(rows)], (turn * frames).as_quat()
            answer = self.world.contacts(
                step.states._replace(positions=positions.ravel(), orientations=orientations.ravel())
            )
            pair = np.repeat(np.arange(len(answer.fragment_a)), np.diff(answer.pair_begin.astype(np.int64)))
            is_own = (answer.fragment_a == THROWN_ID) | (answer.fragment_b == THROWN_ID)
            chosen = is_own[pair]
            if not chosen.any():
                continue
            gaps = answer.gaps.copy()
            for c in np.flatnonzero(chosen & (gaps < -DEEP)):
                depth = self._depth(answer, int(pair[c]), int(c), ids, positions, orientations)
                gaps[c] = max(gaps[c], -depth)
            yield float(gaps[chosen].min())

    def _depth(
        self, answer: ContactConstraintArray, pair: int, contact: int, ids: np.ndarray, positions: np.ndarray,
        orientations: np.ndarray,
    ) -> float:  # fmt: skip
        """[m] Depth of a contact's points, each in the other's surface, the larger; infinite if one has no mesh."""
        fragments = int(answer.fragment_a[pair]), int(answer.fragment_b[pair])
        points = answer.points_a.reshape(-1, 3)[contact], answer.points_b.reshape(-1, 3)[contact]
        depth = 0.0
        for fragment, point in zip(fragments, reversed(points), strict=True):
            solid = self._solid(fragment)
            if solid is None:
                return np.inf
            row = int(np.searchsorted(ids, fragment))
            placed = Rotation.from_quat(orientations[row]).inv().apply(point - positions[row])
            depth = max(depth, -float(solid.signed(placed[None])[0]))
        return depth

    def _solid(self, fragment: int) -> Solid | None:
        if fragment not in self._solids:
            mesh = self.world.fragment_mesh(fragment)
            triangles = mesh.vertices.reshape(-1, 3)[mesh.triangles.reshape(-1, 3)]
            self._solids[fragment] = Solid(triangles) if len(triangles) else None
        return self._solids[fragment]

    def _may_touch(self, mine: np.ndarray, others: np.ndarray, way: float) -> bool:
        """Tests balls around the frames' origins (1, 3), (n, 3); `way` [m] is the remaining motion."""
        reach, other_reach = self._reach[THROWN_ID], self._reach[TARGET_ID]
        if np.isinf(other_reach):
            return bool(mine[0, 2] <= 1.01 * reach + way)
        return bool(np.linalg.norm(others - mine, axis=1).min() <= 1.01 * (reach + other_reach) + way)

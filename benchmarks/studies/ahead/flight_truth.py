"""Time of first contact of two rigid bodies that move within a step, by another library.

The continuous collision detection of ipctk (MIT; tight inclusion, Wang et al. 2021) tests all vertices, edges and faces
along straight segments. A rotating body gets enough of them that its path is nowhere farther off the arc than SAG of
its size.
"""

from __future__ import annotations

from typing import NamedTuple

import ipctk
import numpy as np
from scipy.spatial.transform import Rotation

ipctk.set_num_threads(1)

SAG = 1e-5
# Of the reported times [share of a segment]; a finer tolerance takes a thousand times as long where faces slide past
# each other.
TOLERANCE, MOST_ITERATIONS = 1e-5, 100_000


class Mover(NamedTuple):
    """A closed surface and its motion."""

    vertices: np.ndarray  # (n, 3) [m] body frame
    triangles: np.ndarray  # (t, 3)
    center: np.ndarray  # (3,) [m] of mass, body frame; the centre of rotation
    position: np.ndarray  # (3,) [m] of the body frame in the world
    turn: Rotation
    velocity: np.ndarray  # (3,) [m/s] of the body frame's origin
    spin: np.ndarray  # (3,) [rad/s] world axes

    def at(self, t: float) -> np.ndarray:
        """Its vertices (n, 3) in the world after `t` [s]."""
        arm = self.turn.apply(self.center)
        center = self.position + arm + t * (self.velocity + np.cross(self.spin, arm))
        after = Rotation.from_rotvec(t * self.spin) * self.turn
        return center + after.apply(self.vertices - self.center)


class Flight:
    """Two movers, tested against each other."""

    def __init__(self, one: Mover, other: Mover) -> None:
        self._movers = one, other
        self._ccd = ipctk.TightInclusionCCD(tolerance=TOLERANCE, max_iterations=MOST_ITERATIONS)
        faces = np.vstack([one.triangles, other.triangles + len(one.vertices)]).astype(np.int32)
        edges = np.unique(np.sort(np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
        self._mesh = ipctk.CollisionMesh(self._at(0.0), np.asfortranarray(edges), np.asfortranarray(faces))
        whose = np.repeat(np.arange(2, dtype=np.int32), [len(one.vertices), len(other.vertices)])
        self._mesh.can_collide = ipctk.make_vertex_patches_filter(whose)

    def first_touch(self, time: float, near: float = 0.0) -> float:
        """[s] until the two are no farther apart than `near` [m], rounded down; infinity: not within `time` [s]."""
        angle = time * max(float(np.linalg.norm(mover.spin)) for mover in self._movers)
        parts = max(int(np.ceil(angle / np.sqrt(8.0 * SAG))), 1)
        before = self._at(0.0)
        for k in range(parts):
            after = self._at(time * (k + 1) / parts)
            if self._are_apart(before, after, near):
                before = after
                continue
            share = ipctk.compute_collision_free_stepsize(
                self._mesh, before, after, min_distance=near, narrow_phase_ccd=self._ccd
            )
            if share < 1.0:
                return time * (k + share) / parts
            before = after
        return np.inf

    def _are_apart(self, before: np.ndarray, after: np.ndarray, near: float) -> bool:
        """Tests the boxes of the paths."""
        count = len(self._movers[0].vertices)
        one, other = (np.vstack([before[part], after[part]]) for part in (slice(count), slice(count, None)))
        gaps = np.maximum(one.min(axis=0) - other.max(axis=0), other.min(axis=0) - one.max(axis=0))
        return bool(gaps.max() > near)

    def _at(self, t: float) -> np.ndarray:
        return np.asfortranarray(np.vstack([mover.at(t) for mover in self._movers]))

"""Static support of bodies at rest by their contacts: a linear program over friction cones.

For all bodies at rest together: are there contact forces, each within its friction cone, whose sum and moment on each
body balance its weight? A pair resists rolling by torques of up to its rolling arm times its normal force. Each body is
granted TOLERANCE of its weight, and of its weight times its size as a moment; what is missing beyond that is minimised.
Optionally, contacts that only hook onto an edge of a standing box (HOOK) do not count.

A vertex on an edge may be pushed along any direction between those of the faces beside it; an answer has one of them,
another one a micrometre away, and a body that rests there trembles between them. So the directions within TREMBLE of
the present place count too. Edges that are nearly flat are searched for no crossings, so that surfaces may be closer
than their samples say by epsilon: contacts count up to that much farther apart than the service lists them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog
from scipy.sparse import coo_array
from scipy.spatial.transform import Rotation

from fracture_collision.world.inspection import asked_with

TOLERANCE = 0.05  # of the weight
FACETS = 12  # of a friction cone
SPEED_AT_REST = 2e-3  # [m/s] of any point of the body
ROOM = 4096  # contacts per pair: all within the detection tolerance
# [m] A sample on one face of a box and this little behind another would be free if moved by that much. The support is
# valid but invisible: a body that hangs by it seems to float.
HOOK = 2e-4
ON_FACE = 1e-9
TREMBLE = 1e-5  # [m]
TREMBLES = 8  # places asked at
SAME_DIRECTION = 0.98  # cosine


class Support(NamedTuple):
    fragment_ids: np.ndarray  # (n,) of the bodies at rest
    missing: np.ndarray  # (n,) unsupported load beyond TOLERANCE, as a share of their weight

    @property
    def unsupported(self) -> list[int]:
        return self.fragment_ids[self.missing > 1e-6].tolist()


class _Resting(NamedTuple):
    """The bodies at rest."""

    fragment_ids: np.ndarray  # (n,)
    row_of: dict[int, int]  # by fragment
    centers: np.ndarray  # (n, 3) [m]
    weight: np.ndarray  # (n,) [N]
    size: np.ndarray  # (n,) [m]


class _Entries:
    """The nonzero entries of a sparse matrix."""

    def __init__(self) -> None:
        self._rows, self._columns, self._values = [], [], []

    def add(self, row: int, column: int, value: float) -> None:
        self._rows.append(row), self._columns.append(column), self._values.append(value)

    def matrix(self, rows: int, columns: int):
        return coo_array((self._values, (self._rows, self._columns)), shape=(rows, columns)).tocsr()


class _Forces:
    """The columns of the linear program that are forces and torques, each not negative."""

    def __init__(self, bodies: _Resting) -> None:
        self._bodies = bodies
        self.balance = _Entries()  # six rows a body, in units of its weight
        self.limits = _Entries()  # of torques, by the normal force
        self.count, self.limit_count = 0, 0

    def press(self, a: int, b: int, point: np.ndarray, edges: np.ndarray) -> list[int]:
        """Adds forces along the edges (FACETS, 3) of a friction cone, on b and reversed on a; returns their columns."""
        for force in edges:
            self._act(b, point, force, 1.0)
            self._act(a, point, force, -1.0)
            self.count += 1
        return list(range(self.count - len(edges), self.count))

    def resist_rolling(self, a: int, b: int, scale: float, arm: float, pressing: list[int]) -> None:
        """Adds torques between a and b, each no greater than `arm` [m] times the forces in the columns `pressing`."""
        for axis in range(3):
            for sign in (1.0, -1.0):
                for body, way in ((b, 1.0), (a, -1.0)):
                    k = self._bodies.row_of.get(body)
                    if k is not None:
                        share = way * sign * scale / self._bodies.size[k] / self._bodies.weight[k]
                        self.balance.add(6 * k + 3 + axis, self.count, share)
                self.limits.add(self.limit_count, self.count, 1.0)
                for each in pressing:
                    self.limits.add(self.limit_count, each, -arm)
                self.limit_count += 1
                self.count += 1

    def _act(self, body: int, at: np.ndarray, force: np.ndarray, sign: float) -> None:
        k = self._bodies.row_of.get(body)
        if k is None:
            return
        (x, y, z), (u, v, w) = at - self._bodies.centers[k], force
        size = self._bodies.size[k]  # np.cross takes most of the time of a verdict
        moment = (y * w - z * v) / size, (z * u - x * w) / size, (x * v - y * u) / size
        for i, value in enumerate((u, v, w, *moment)):
            self.balance.add(6 * k + i, self.count, sign * value / self._bodies.weight[k])


def support_of(run, scene, hooks: bool = True) -> Support:
    """Support in the present state of a Lockstep run; `hooks`: whether contacts that only hook onto an edge count."""
    states = run.states()
    registry = run.world.fragments()
    boxes = [] if hooks else _standing_boxes(run.simulation, registry)
    reach = run.world.settings.detection_tolerance + run.world.settings.penetration_tolerance
    contacts = [
        _without_hooks(asked_with(run.world, each, contacts_per_pair=ROOM, detection_tolerance=reach), boxes)
        for each in (states, *_trembling(states))
    ]
    bodies = run.simulation.dynamics.states()
    rolling = {body_id: body.material.rolling_arm for body_id, body in run.simulation._cast.body_of.items()}
    of = dict(zip(registry.fragment_ids.tolist(), registry.body_ids.tolist(), strict=True))
    size = np.sqrt(np.trace(bodies.inertias, axis1=1, axis2=2) / bodies.masses)
    speed = np.linalg.norm(bodies.linear, axis=1) + np.linalg.norm(bodies.angular, axis=1) * size
    robot = run.simulation.robot
    driven = [] if robot is None else robot.fragment_ids.tolist()
    resting = np.flatnonzero((speed < SPEED_AT_REST) & ~np.isin(bodies.fragment_ids, driven))
    gravity = scene.gravity
    weight = bodies.masses[resting] * np.linalg.norm(gravity)
    if not len(resting) or not weight.any():
        return Support(bodies.fragment_ids[resting], np.zeros(len(resting)))
    row_of = {int(bodies.fragment_ids[i]): k for k, i in enumerate(resting)}
    at_rest = _Resting(bodies.fragment_ids[resting], row_of, bodies.centers[resting], weight, size[resting])
    arm_of = {f: rolling[of[f]] for f in of}
    return _solve(_forces_of(contacts, at_rest, arm_of), at_rest, gravity)


def _trembling(states):
    """Yields states in which each body is TREMBLE away from its place, in directions drawn anew."""
    random = np.random.default_rng(0)
    for _ in range(TREMBLES):
        away = random.normal(size=(len(states.fragment_ids), 3))
        away *= TREMBLE / np.linalg.norm(away, axis=1, keepdims=True)
        yield states._replace(positions=states.positions + away)


def _standing_boxes(simulation, registry):
    """Returns a list of (fragment id, half edges (3,), position (3,), orientation (3, 3))."""
    bodies = {int(fragment): simulation._cast.body_of.get(int(body)) for fragment, body in
              zip(registry.fragment_ids, registry.body_ids, strict=True)}  # fmt: skip
    return [
        (fragment, 0.5 * np.array(body.shape.size), body.position, Rotation.from_quat(body.orientation).as_matrix())
        for fragment, body in bodies.items()
        if body is not None and body.is_static and body.shape.kind == "box"
    ]


def _without_hooks(contacts, boxes):
    begin = contacts.pair_begin.astype(int)
    kept = np.ones(len(contacts.gaps), bool)
    normals = contacts.normals.reshape(-1, 3)
    for fragment, half, position, rotation in boxes:
        for fragments, samples in (
            (contacts.fragment_a, contacts.points_b), (contacts.fragment_b, contacts.points_a),
        ):  # fmt: skip
            mine = np.flatnonzero(np.repeat(fragments == fragment, np.diff(begin)))
            normal = np.abs(normals[mine] @ rotation)
            face = normal.argmax(axis=1)[:, None]
            behind = half - np.abs((samples.reshape(-1, 3)[mine] - position) @ rotation)
            np.put_along_axis(behind, face, np.inf, axis=1)
            of_face = np.take_along_axis(normal, face, axis=1)[:, 0] > 1.0 - ON_FACE
            kept[mine[of_face & (behind.min(axis=1) < HOOK)]] = False
    return contacts._replace(
        pair_begin=np.concatenate(([0], np.cumsum(kept)))[begin], contact_ids=contacts.contact_ids[kept],
        points_a=contacts.points_a[kept], points_b=contacts.points_b[kept], normals=contacts.normals[kept],
        gaps=contacts.gaps[kept],
    )  # fmt: skip


def _forces_of(contacts, bodies: _Resting, arm_of: dict[int, float]) -> _Forces:
    """Forces at the contacts of the first answer, and at those of the others that have a direction of their own."""
    forces, row_of = _Forces(bodies), bodies.row_of
    directions: dict[tuple[int, int], list[np.ndarray]] = {}
    for answer in contacts:
        begin = answer.pair_begin.astype(int)
        points = 0.5 * (answer.points_a + answer.points_b).reshape(-1, 3)
        normals = answer.normals.reshape(-1, 3)
        for p in range(len(answer.fragment_a)):
            a, b = int(answer.fragment_a[p]), int(answer.fragment_b[p])
            if a not in row_of and b not in row_of:
                continue
            scale = min(bodies.weight[row_of[f]] for f in (a, b) if f in row_of)
            known = directions.setdefault((a, b), [])
            pressing = []
            for c in range(begin[p], begin[p + 1]):
                if answer is contacts[0] or all(each @ normals[c] < SAME_DIRECTION for each in known):
                    known.append(normals[c])
                    pressing += forces.press(a, b, points[c], scale * _cone_about(normals[c], answer.friction[p]))
            arm = max(arm_of[a], arm_of[b])
            if arm > 0.0 and pressing:
                forces.resist_rolling(a, b, scale, arm, pressing)
    return forces


def _cone_about(normal: np.ndarray, friction: float) -> np.ndarray:
    """The edges (FACETS, 3) of a pyramid that contains the friction cone; their normal component is 1."""
    turns = 2.0 * np.pi * np.arange(FACETS) / FACETS
    circle = np.column_stack((np.cos(turns), np.sin(turns))) / np.cos(np.pi / FACETS)
    t = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    t /= np.linalg.norm(t)
    return normal + friction * circle @ np.array((t, np.cross(normal, t)))


def _solve(forces: _Forces, bodies: _Resting, gravity: np.ndarray) -> Support:
    n, column = len(bodies.weight), forces.count
    # granted and missing, of either sign, of each row
    for sign in (1.0, -1.0):
        for _kind in range(2):
            for row in range(6 * n):
                forces.balance.add(row, column, sign)
                column += 1
    cost = np.zeros(column)
    bounds = np.full((column, 2), np.inf)
    bounds[:, 0] = 0.0
    for k in range(2):
        granted = slice(forces.count + 12 * n * k, forces.count + 12 * n * k + 6 * n)
        missing = slice(granted.stop, granted.stop + 6 * n)
        bounds[granted, 1] = TOLERANCE
        cost[missing] = 1.0
    balance = forces.balance.matrix(6 * n, column)
    target = np.zeros((n, 6))
    target[:, :3] = -gravity / np.linalg.norm(gravity)
    limits, most = None, None
    if forces.limit_count:
        limits, most = forces.limits.matrix(forces.limit_count, column), np.zeros(forces.limit_count)
    done = linprog(cost, limits, most, balance, target.ravel(), bounds, method="highs")
    assert done.status == 0, done.message
    found = done.x[forces.count :].reshape(2, 2, n, 6)[:, 1]
    return Support(bodies.fragment_ids, found.sum(axis=(0, 2)))

"""A recorded run as triangles, normals and colours at one moment, and the camera that shows it.

Moments and camera are chosen from what breaks and moves in the run and where the thrown bodies come from.
"""

from __future__ import annotations

import math

import numpy as np

from fracture_collision.bag.reader import BagError
from fracture_collision.records import CollisionBody
from fracture_collision.viewer.film.recorded_run import RecordedRun, RecordedStates
from fracture_collision.viewer.pictures.body_mesh import BodyMesh, mesh_of_body, mesh_of_fragment
from fracture_collision.viewer.pictures.palette import Paint, Palette
from fracture_collision.viewer.pictures.ray_picture import Camera, TriangleScene


class RunScene:
    """Builds the scene at any of a run's states; meshes are made on first use."""

    def __init__(self, run: RecordedRun) -> None:
        self.run = run
        self._meshes: dict[int, BodyMesh] = {}
        self._palette = Palette()
        for body_id in sorted(run.bodies):
            self._palette.add(run.bodies[body_id])

    def at(self, states: RecordedStates) -> TriangleScene:
        """The triangles of everything present at `states`, in the world."""
        triangles, normals, colours, shine = [], [], [], []
        for fragment_id, position, rotation in self._poses(states):
            mesh = self.mesh(fragment_id)
            triangles.append(mesh.triangles @ rotation.T + position)
            normals.append(mesh.normals @ rotation.T)
            paint = self.paint(fragment_id)
            colours.append(np.where(mesh.is_crack[:, None], paint.crack, paint.outside))
            shine.append(np.where(mesh.is_crack, 0.0, paint.shine))
        if not triangles:
            return TriangleScene(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), self.ground)
        return TriangleScene(
            np.concatenate(triangles), np.concatenate(normals), np.concatenate(colours), np.concatenate(shine),
            self.ground,
        )  # fmt: skip

    @property
    def ground(self) -> float | None:
        """Height [m] of the highest horizontal plane that is solid below; None if there is none."""
        planes = [body.plane for body in self.run.bodies.values() if np.any(body.plane)]
        heights = [-p[3] / p[2] for p in planes if p[2] > 0.999 * np.linalg.norm(p[:3])]
        return max(heights, default=None)

    def centres(self, states: RecordedStates, movable_only: bool = True) -> np.ndarray:
        """Centres (n, 3) [m] of the movable fragments, or of everything solid."""
        return np.array(
            [
                rotation @ self.mesh(f).centre + position
                for f, position, rotation in self._poses(states)
                if not (movable_only and self._body(f).is_static)
            ]
        ).reshape(-1, 3)

    def radius(self, states: RecordedStates) -> float:
        """Median of half the longest box side over the movable fragments [m]; 0 if nothing can move."""
        meshes = [self.mesh(f) for f, *_ in self._poses(states) if not self._body(f).is_static]
        return float(np.median([0.5 * np.ptp(mesh.triangles, axis=(0, 1)).max() for mesh in meshes] or [0.0]))

    def is_breakable(self, fragment_id: int) -> bool:
        """Whether the fragment's body can break."""
        return self._palette.is_breakable(self.run.body_of[fragment_id])

    def paint(self, fragment_id: int) -> Paint:
        """Its colours."""
        return self._palette.paint(fragment_id, self.run.body_of[fragment_id])

    def mesh(self, fragment_id: int) -> BodyMesh:
        """From the fragment's FragmentMesh; if there is none, from its body, which never broke."""
        if fragment_id not in self._meshes:
            recorded = self.run.meshes.get(fragment_id)
            body = self._body(fragment_id)
            if recorded is not None and body.primitive.type == 0:
                self._meshes[fragment_id] = mesh_of_fragment(recorded)
            elif fragment_id == body.fragment_id:
                self._meshes[fragment_id] = mesh_of_body(body)
            else:
                raise BagError(f"no FragmentMesh of fragment {fragment_id}: record the topic fragment_meshes too")
        return self._meshes[fragment_id]

    def _body(self, fragment_id: int) -> CollisionBody:
        if fragment_id not in self.run.body_of:
            raise BagError(f"no CollisionBody or FractureEvent contains fragment {fragment_id}: record both topics")
        return self.run.bodies[self.run.body_of[fragment_id]]

    def _poses(self, states: RecordedStates) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Fragment id, position and rotation matrix of everything solid except planes."""
        from scipy.spatial.transform import Rotation  # late: half a second

        named = set(states.fragment_ids.tolist())
        resting = [b.fragment_id for b in self.run.bodies.values() if b.is_static and b.fragment_id not in named]
        rotations = Rotation.from_quat(states.orientations).as_matrix() if named else np.zeros((0, 3, 3))
        poses = list(zip(states.fragment_ids.tolist(), states.positions, rotations, strict=True))
        poses += [(f, np.zeros(3), np.eye(3)) for f in sorted(resting)]
        return [pose for pose in poses if not np.any(self._body(pose[0]).plane)]


OPENING = math.radians(32.0)
FRACTURE_WEIGHT = 0.75  # share of the choice of moments; the rest is spread evenly over the run
AFTERMATH = 0.3  # [s] time after a fracture that is worth showing


def chosen_moments(run: RecordedRun, count: int) -> list[RecordedStates]:
    """`count` states (fewer if the run has fewer), first and last among them, dense where fractures happen."""
    time = np.array([states.time for states in run.states])
    sequence = np.array([states.fracture_sequence for states in run.states])
    share = np.arange(len(time)) / max(1, len(time) - 1)
    broken_at = time[1:][np.diff(sequence) > 0]
    if len(broken_at):
        seen = np.clip((time[:, None] - broken_at) / AFTERMATH, 0.0, 1.0).mean(axis=1)
        share = (1.0 - FRACTURE_WEIGHT) * share + FRACTURE_WEIGHT * seen / max(seen[-1], 1e-9)
    wanted = np.linspace(0.0, 1.0, count) if count > 1 else np.ones(1)
    nearest = np.abs(share[None] - wanted[:, None]).argmin(axis=1)
    nearest[-1] = len(time) - 1
    return [run.states[i] for i in sorted(set(nearest.tolist()))]


def sun_of(camera: Camera) -> np.ndarray:
    """(3,) towards the sun, which stands high behind the viewer's left shoulder."""
    ahead = camera.target - camera.position
    sun = np.array([-0.55 * ahead[0] - 0.55 * ahead[1], 0.55 * ahead[0] - 0.55 * ahead[1], 0.0])
    return sun / np.linalg.norm(sun) + (0.0, 0.0, 1.25)


def camera_of(scene: RunScene, moments: list[RecordedStates], aspect: float) -> Camera:
    """From the side of the thrown bodies, turned a little and raised, far enough away to see nearly all that moves."""
    centres = [scene.centres(states) for states in moments]
    if not any(map(len, centres)):
        centres = [scene.centres(states, movable_only=False) for states in moments]
    radius = scene.radius(moments[0])
    low, high = _spread(centres, 0.06) - radius, _spread(centres, 0.97) + radius
    target = 0.5 * (low + high)
    front = _front(scene, moments)
    turn, rise = math.radians(24.0), math.radians(17.0)
    flat = np.array([math.cos(turn) * front[0] - math.sin(turn) * front[1],
                     math.sin(turn) * front[0] + math.cos(turn) * front[1]])  # fmt: skip
    back = np.array([*(math.cos(rise) * flat), math.sin(rise)])
    right = np.cross([0.0, 0.0, 1.0], back)
    right /= np.linalg.norm(right)
    up = np.cross(back, right)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    offset = corners - target
    margin = 1.05
    slope = math.tan(0.5 * OPENING)
    reach = np.maximum(np.abs(offset @ up) / slope, np.abs(offset @ right) / (slope * aspect))
    distance = max(float(np.max(margin * reach + offset @ back)), 0.5)
    # Leaves room for bodies to fall: the action is above the middle of the frame.
    target = target - 0.2 * slope * distance * up
    return Camera(target + distance * back, target, OPENING)


def _spread(centres: list[np.ndarray], share: float) -> np.ndarray:
    """(3,) the coordinates below which this share lies.

    Each moment has the same weight: one body weighs as much as all its shards do later.
    """
    points = np.concatenate(centres)
    weights = np.concatenate([np.full(len(group), 1.0 / max(len(group), 1)) for group in centres])
    result = np.empty(3)
    for axis in range(3):
        order = np.argsort(points[:, axis], kind="stable")
        below = np.cumsum(weights[order]) - 0.5 * weights[order]
        result[axis] = np.interp(share * weights.sum(), below, points[order, axis])
    return result


def _front(scene: RunScene, moments: list[RecordedStates]) -> np.ndarray:
    """Horizontal unit vector from breakable bodies to thrown ones, as first seen; else across the long side."""
    first_seen: dict[int, np.ndarray] = {}
    for states in scene.run.states:
        for fragment, position in zip(states.fragment_ids.tolist(), states.positions, strict=True):
            body = scene.run.bodies[scene.run.body_of[fragment]]
            if not body.is_static and fragment == body.fragment_id:
                first_seen.setdefault(fragment, position)
    breakable = [p for f, p in first_seen.items() if scene.is_breakable(f)]
    thrown = [p for f, p in first_seen.items() if not scene.is_breakable(f)]
    if breakable and thrown:
        across = (np.mean(thrown, axis=0) - np.mean(breakable, axis=0))[:2]
        if np.linalg.norm(across) > 1e-3:
            return across / np.linalg.norm(across)
    span = np.ptp(scene.centres(moments[0], movable_only=False), axis=0) if moments else np.ones(3)
    return np.array([0.0, -1.0]) if span[0] >= span[1] else np.array([1.0, 0.0])

"""A recorded run as triangles, normals and colours at one moment."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.bag.reader import BagError
from fracture_collision.records import CollisionBody
from fracture_collision.viewer.film.recorded_run import RecordedRun, RecordedStates
from fracture_collision.viewer.pictures.body_mesh import BodyMesh, mesh_of_body, mesh_of_fragment
from fracture_collision.viewer.pictures.palette import Paint, Palette
from fracture_collision.viewer.pictures.ray_picture import TriangleScene


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
        named = set(states.fragment_ids.tolist())
        resting = [b.fragment_id for b in self.run.bodies.values() if b.is_static and b.fragment_id not in named]
        rotations = Rotation.from_quat(states.orientations).as_matrix() if named else np.zeros((0, 3, 3))
        poses = list(zip(states.fragment_ids.tolist(), states.positions, rotations, strict=True))
        poses += [(f, np.zeros(3), np.eye(3)) for f in sorted(resting)]
        return [pose for pose in poses if not np.any(self._body(pose[0]).plane)]

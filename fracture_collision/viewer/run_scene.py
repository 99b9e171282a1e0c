"""A recorded run as triangles, normals and colours at one moment."""

from __future__ import annotations

import colorsys

import numpy as np
from scipy.spatial.transform import Rotation

from fracture_collision.bag.reader import BagError
from fracture_collision.geometry.generators import brick, shell
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import BOX, SPHERE, CollisionBody
from fracture_collision.viewer.ray_picture import TriangleScene
from fracture_collision.viewer.recorded_run import RecordedRun, RecordedStates
from fracture_collision.viewer.shading import smooth_normals

# Linear RGB. One family of colours a breakable body; what does not break keeps to the quiet ones.
FAMILY_HUES = (0.56, 0.03, 0.11, 0.43, 0.78, 0.33, 0.93, 0.64)
THROWN_COLOUR = (0.10, 0.10, 0.12)
STATIC_COLOURS = ((0.46, 0.29, 0.16), (0.34, 0.21, 0.12), (0.62, 0.60, 0.56), (0.40, 0.42, 0.44))
CREASE = float(np.cos(np.radians(35.0)))  # corners of triangles that meet more sharply are not smoothed


class BodyMesh:
    """Triangles of one fragment or unbroken body, in its body frame, with the normals of their corners."""

    def __init__(self, triangles: np.ndarray, is_crack: np.ndarray | None = None) -> None:
        self.triangles = np.ascontiguousarray(triangles, dtype=np.float64)  # (t, 3, 3)
        self.is_crack = np.zeros(len(triangles), dtype=np.bool_) if is_crack is None else is_crack
        self.normals = np.empty((3 * len(triangles), 3))
        _, place = np.unique(np.round(self.triangles.reshape(-1, 3), 7), axis=0, return_inverse=True)
        place = place.ravel()
        corners = np.argsort(place, kind="stable")
        begin = np.searchsorted(place[corners], np.arange(place.max(initial=-1) + 2))
        smooth_normals(self.triangles, self.is_crack, corners, begin, CREASE, self.normals)
        self.normals = self.normals.reshape(-1, 3, 3)
        self.centre = self.triangles.reshape(-1, 3).mean(axis=0) if len(triangles) else np.zeros(3)


class RunScene:
    """Builds the scene at any of a run's states; meshes are made when first seen."""

    def __init__(self, run: RecordedRun) -> None:
        self.run = run
        self._meshes: dict[int, BodyMesh] = {}
        breakable = [b for b in sorted(run.bodies) if len(run.bodies[b].tetrahedra)]
        self._family = {body_id: i for i, body_id in enumerate(breakable)}
        solid_statics = [b for b in sorted(run.bodies) if run.bodies[b].is_static and not np.any(run.bodies[b].plane)]
        self._static_rank = {body_id: i for i, body_id in enumerate(solid_statics)}

    def at(self, states: RecordedStates) -> TriangleScene:
        """The triangles of everything there is at `states`, in the world."""
        triangles, normals, colours, shine = [], [], [], []
        for fragment_id, position, rotation in self._poses(states):
            mesh = self.mesh(fragment_id)
            triangles.append(mesh.triangles @ rotation.T + position)
            normals.append(mesh.normals @ rotation.T)
            own = self._colours(fragment_id, mesh)
            colours.append(own)
            breakable = self.run.body_of[fragment_id] in self._family
            shine.append(np.where(mesh.is_crack, 0.0, 0.35 if breakable else 0.06))
        if not triangles:
            return TriangleScene(np.zeros((0, 3, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), self.ground)
        return TriangleScene(*map(np.concatenate, (triangles, normals, colours, shine)), self.ground)

    @property
    def ground(self) -> float | None:
        """Height of the highest horizontal plane, solid below [m]."""
        planes = [body.plane for body in self.run.bodies.values() if np.any(body.plane)]
        heights = [-p[3] / p[2] for p in planes if p[2] > 0.999 * np.linalg.norm(p[:3])]
        return max(heights, default=None)

    def centres(self, states: RecordedStates, movable_only: bool = True) -> np.ndarray:
        """Middles of what is there (n, 3) [m]: of all that can move, or of everything solid."""
        return np.array(
            [
                rotation @ self.mesh(f).centre + position
                for f, position, rotation in self._poses(states)
                if not (movable_only and self._body(f).is_static)
            ]
        ).reshape(-1, 3)

    def radius(self, states: RecordedStates) -> float:
        """Half the longest side of the box of the median body that can move [m]; 0 where none can."""
        meshes = [self.mesh(f) for f, *_ in self._poses(states) if not self._body(f).is_static]
        return float(np.median([0.5 * np.ptp(mesh.triangles, axis=(0, 1)).max() for mesh in meshes] or [0.0]))

    def is_breakable(self, fragment_id: int) -> bool:
        return self.run.body_of[fragment_id] in self._family

    def mesh(self, fragment_id: int) -> BodyMesh:
        """Of a fragment, from its FragmentMesh; of a body that never broke, from the body where there is none."""
        if fragment_id not in self._meshes:
            recorded = self.run.meshes.get(fragment_id)
            body = self._body(fragment_id)
            if body.primitive.type == SPHERE:
                radius = body.primitive.dimensions[0]
                sphere = shell(radius, 0.9 * radius, 0.1 * radius, layers=1)
                mesh = BodyMesh(sphere.vertices[boundary_triangles(sphere.tetrahedra)])
            elif body.primitive.type == BOX:
                box = brick(body.primitive.dimensions, 2.0 * max(body.primitive.dimensions))
                mesh = BodyMesh(box.vertices[boundary_triangles(box.tetrahedra)])
            elif recorded is not None:
                corners = recorded.vertices.reshape(-1, 3)[recorded.triangles.reshape(-1, 3)]
                mesh = BodyMesh(corners, recorded.is_crack)
            elif fragment_id != body.fragment_id:
                raise BagError(f"no FragmentMesh of fragment {fragment_id}: record the topic fragment_meshes too")
            else:
                triangles = body.triangles.reshape(-1, 3)
                if not len(triangles):
                    triangles = boundary_triangles(body.tetrahedra.reshape(-1, 4).astype(np.int64))
                mesh = BodyMesh(body.vertices.reshape(-1, 3)[triangles])
            self._meshes[fragment_id] = mesh
        return self._meshes[fragment_id]

    def _body(self, fragment_id: int) -> CollisionBody:
        if fragment_id not in self.run.body_of:
            raise BagError(f"no CollisionBody or FractureEvent names fragment {fragment_id}: record those topics too")
        return self.run.bodies[self.run.body_of[fragment_id]]

    def _poses(self, states: RecordedStates) -> list[tuple[int, np.ndarray, np.ndarray]]:
        """Fragment, position and rotation matrix of everything solid, planes left out."""
        named = set(states.fragment_ids.tolist())
        resting = [b.fragment_id for b in self.run.bodies.values() if b.is_static and b.fragment_id not in named]
        rotations = Rotation.from_quat(states.orientations).as_matrix() if named else np.zeros((0, 3, 3))
        poses = list(zip(states.fragment_ids.tolist(), states.positions, rotations, strict=True))
        poses += [(f, np.zeros(3), np.eye(3)) for f in sorted(resting)]
        return [pose for pose in poses if not np.any(self._body(pose[0]).plane)]

    def _colours(self, fragment_id: int, mesh: BodyMesh) -> np.ndarray:
        body_id = self.run.body_of[fragment_id]
        if body_id in self._family:
            # Neighbouring ids differ visibly: the golden ratio spreads them over the family's range of lightness.
            spread = (fragment_id * 0.6180339887) % 1.0
            hue = FAMILY_HUES[self._family[body_id] % len(FAMILY_HUES)]
            outside = colorsys.hls_to_rgb(hue + 0.02 * (spread - 0.5), 0.42 + 0.12 * spread, 0.62)
            crack = colorsys.hls_to_rgb(hue, 0.80, 0.45)
            return np.where(mesh.is_crack[:, None], np.square(crack), np.square(outside))
        rank = self._static_rank.get(body_id)
        colour = THROWN_COLOUR if rank is None else STATIC_COLOURS[rank % len(STATIC_COLOURS)]
        return np.tile(colour, (len(mesh.triangles), 1))

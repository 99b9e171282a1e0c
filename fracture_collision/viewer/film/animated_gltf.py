"""A recorded run as one animated file, binary glTF 2.0, that plays in any viewer of 3D files without a server.

Each fragment is a node that moves. One that does not exist yet, or no longer, has the scale 0: glTF has no visibility.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from fracture_collision.bag.reader import BagError
from fracture_collision.viewer.film.recorded_run import RecordedRun, RecordedStates
from fracture_collision.viewer.film.run_scene import RunScene
from fracture_collision.viewer.pictures.body_mesh import BodyMesh
from fracture_collision.viewer.pictures.gltf import GltfFile
from fracture_collision.viewer.pictures.palette import PLAIN_SHINE, Paint

FPS = 60.0  # of the animation; players interpolate
FLOOR, FLOOR_PAINT = 20.0, Paint((0.45, 0.47, 0.5), (0.45, 0.47, 0.5), PLAIN_SHINE)  # [m] edge
UPRIGHT = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]  # x y z w: from z upwards, as in a run, to y upwards, as in glTF
STILL = 1e-6  # [m], and for quaternion components: less is no movement


def animated_glb(run: RecordedRun, fps: float = FPS) -> bytes:
    """The file. Raises BagError if the mesh of a fragment is missing, or nothing was recorded."""
    if not run.states:
        raise BagError("no states were recorded")
    scene, file = RunScene(run), GltfFile()
    states = _thinned(run.states, fps)
    times = np.array([each.time for each in states]) - states[0].time
    nodes = []
    for fragment_id, (rows, places) in _tracks(states).items():
        if np.any(run.bodies[run.body_of[fragment_id]].plane):
            continue
        mesh = file.add_mesh(scene.mesh(fragment_id), scene.paint(fragment_id))
        if mesh is None:
            continue
        node = file.add_node(
            {"name": f"fragment {fragment_id}", "mesh": mesh, "translation": places[0, :3].tolist(),
             "rotation": places[0, 3:].tolist()}
        )  # fmt: skip
        nodes.append(node)
        _animate(file, node, times, rows, places)
    named = {fragment_id for each in run.states for fragment_id in each.fragment_ids.tolist()}
    for body in run.bodies.values():
        if body.is_static and body.fragment_id not in named and not np.any(body.plane):
            mesh = file.add_mesh(scene.mesh(body.fragment_id), scene.paint(body.fragment_id))
            nodes.append(file.add_node({"name": body.name or f"body {body.body_id}", "mesh": mesh}))
    if scene.ground is not None:
        nodes.append(file.add_node({"name": "floor", "mesh": file.add_mesh(_square(scene.ground), FLOOR_PAINT)}))
    return file.bytes([file.add_node({"name": "run", "rotation": UPRIGHT, "children": nodes})])


def _thinned(states: list[RecordedStates], fps: float) -> list[RecordedStates]:
    """At most `fps` a second, but always those before and after fragments come or go, and the last."""
    news = [not np.array_equal(a.fragment_ids, b.fragment_ids) for a, b in pairwise(states)]
    chosen: list[RecordedStates] = []
    for each, came, goes in zip(states, (True, *news), (*news, True), strict=True):
        if came or goes or each.time - chosen[-1].time >= 1.0 / fps - 1e-9:
            chosen.append(each)
    return chosen


def _tracks(states: list[RecordedStates]) -> dict[int, tuple[np.ndarray, np.ndarray]]:
    """Of each fragment: the indices (k,) of the states that name it, and (k, 7) positions and quaternions x y z w."""
    rows: dict[int, list[int]] = {}
    places: dict[int, list[np.ndarray]] = {}
    for i, each in enumerate(states):
        for fragment_id, place in zip(
            each.fragment_ids.tolist(), np.hstack((each.positions, each.orientations)), strict=True
        ):
            rows.setdefault(fragment_id, []).append(i)
            places.setdefault(fragment_id, []).append(place)
    return {fragment_id: (np.array(rows[fragment_id]), np.array(places[fragment_id])) for fragment_id in rows}


def _animate(file: GltfFile, node: int, times: np.ndarray, rows: np.ndarray, places: np.ndarray) -> None:
    flips = np.cumprod(np.where(np.sum(places[1:, 3:] * places[:-1, 3:], axis=1) < 0.0, -1.0, 1.0))
    places[1:, 3:] *= flips[:, None]  # a quaternion and its opposite are equal, but not what lies between two
    for path, values in (("translation", places[:, :3]), ("rotation", places[:, 3:])):
        if np.abs(values - values[0]).max() > STILL:
            file.move(node, path, times[rows], values)
    present = np.zeros(len(times), dtype=bool)
    present[rows] = True
    changes = np.flatnonzero(np.diff(present, prepend=not present[0]))
    if len(changes) > 1 or not present[0]:
        scales = np.repeat(present[changes].astype(np.float64)[:, None], 3, axis=1)
        file.move(node, "scale", times[changes], scales, steps=True)


def _square(height: float) -> BodyMesh:
    half = 0.5 * FLOOR
    corners = np.array([[-half, -half, height], [half, -half, height], [half, half, height], [-half, half, height]])
    return BodyMesh(corners, np.array([[0, 1, 2], [0, 2, 3]]))

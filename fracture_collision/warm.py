"""Compiles all kernels into numba's cache: `python -m fracture_collision.warm` (part of `make build`).

It runs both nodes' own warm-ups, a small scene to its end, and draws a picture.
"""

from __future__ import annotations

import time

import numpy as np

import fracture_collision.simulation.warm_up as simulator
import fracture_collision.world.warm_up as service
from fracture_collision.geometry.generators import brick
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.lockstep import Lockstep
from fracture_collision.meshing import tetrahedralize_by_lattice
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.viewer.pictures.body_mesh import BodyMesh
from fracture_collision.viewer.pictures.ray_picture import Camera, TriangleScene, render


def main() -> None:
    """Compiles all kernels and prints what it is compiling."""
    started = time.monotonic()
    service.compile_kernels(progress=_say)
    _say("inspection")
    service.compile_inspection_kernels()
    simulator.compile_kernels(progress=_say)
    _say("a whole run of the scene pane")
    with Lockstep(load_scene("pane")) as run:
        for _ in run:
            pass
    _say("mesher")
    cube = brick((1.0, 1.0, 1.0), 1.0)
    tetrahedralize_by_lattice(cube.vertices, boundary_triangles(cube.tetrahedra), 0.25)
    _say("pictures")
    draw_one_triangle()
    _say(f"all kernels are in the cache, after {time.monotonic() - started:.0f} s")


def draw_one_triangle() -> None:
    """Compiles the kernels of pictures by rendering one."""
    corners = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [0.0, 1.0, 1.0]])
    mesh = BodyMesh(corners, np.array([[0, 1, 2]], np.uint32))
    scene = TriangleScene(mesh.triangles, mesh.normals, np.full((1, 3), 0.5), np.zeros(1), 0.0)
    camera = Camera(np.array([0.2, 0.2, 4.0]), np.zeros(3), 0.8)
    render(scene, camera, 8, 8, np.array([0.0, 0.6, 0.8]))


def _say(words: str) -> None:
    print(words, flush=True)


if __name__ == "__main__":
    main()

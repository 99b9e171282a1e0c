"""Compiles all kernels into numba's cache: `python -m fracture_collision.warm` (part of `make build`).

Parts that have few kernels in common run at the same time, each in a process; a kernel that two of them compile is the
same file. Then both nodes' own warm-ups run, a small scene to its end, and a picture is drawn: with what is cached, in
seconds.
"""

from __future__ import annotations

import multiprocessing
import os
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor

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
from fracture_collision.world.first_start import ALONE, cache_is_cold


def main() -> None:
    """Compiles all kernels and prints what it is compiling."""
    started, cores = time.monotonic(), len(os.sched_getaffinity(0))
    os.environ[ALONE] = "1"  # the parts are divided here
    if cores > 1 and cache_is_cold():
        workers = min(cores, len(PARTS))
        _say(f"{len(PARTS)} parts in {workers} processes")
        with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn")) as pool:
            for each in [pool.submit(compile_part, name) for name in PARTS]:
                each.result()
    service.compile_kernels(progress=_say)
    _say("inspection")
    service.compile_inspection_kernels()
    simulator.compile_kernels(progress=_say)
    _say("a whole run of the scene pane")
    with Lockstep(load_scene("pane")) as run:
        for _ in run:
            pass
    mesh_and_draw(_say)
    _say(f"all kernels are in the cache, after {time.monotonic() - started:.0f} s")


def mesh_and_draw(progress: Callable[[str], None]) -> None:
    """Compiles the kernels of the mesher and of pictures."""
    progress("mesher")
    cube = brick((1.0, 1.0, 1.0), 1.0)
    tetrahedralize_by_lattice(cube.vertices, boundary_triangles(cube.tetrahedra), 0.25)
    progress("pictures")
    draw_one_triangle()


# The longest first.
PARTS: dict[str, Callable[[Callable[[str], None]], None]] = {
    "contacts": service.compile_contacts,
    "fractures": service.compile_fractures,
    "simulator": simulator.compile_kernels,
    "meshes": mesh_and_draw,
}


def compile_part(name: str) -> None:
    """Compiles one of PARTS and says so."""
    PARTS[name](lambda words: None)
    _say(f"{name}: done")


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

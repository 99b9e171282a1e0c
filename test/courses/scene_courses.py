"""Digests of whole scenes: `python test/courses/scene_courses.py [NAME[@CURVATURE] ...]` prints them, --pin keeps them.

A digest covers every state and every answer of a run (scene_run.SceneRun.report). test_scene_courses.py compares them
with scene_courses.yaml, in this process's environment and in others. After a change that is meant to change a course,
pin them again: `python test/courses/scene_courses.py --pin`.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import yaml

PINNED = Path(__file__).with_name("scene_courses.yaml")


def digests(names: list[str]) -> Iterator[tuple[str, str]]:
    from fracture_collision.scene_run import SceneRun
    from fracture_collision.simulation.scene.scene import load_scene
    from fracture_collision.simulation.scene.scene_changes import with_curvature
    from fracture_collision.world.settings import Settings

    for name in names:
        scene, _, curvature = name.partition("@")
        what = load_scene(scene)
        if curvature:
            what = with_curvature(what, float(curvature))
        with SceneRun(what, Settings(threads=1, lookahead=what.time_step), None, False) as run:
            for _ in run:
                pass
        yield name, run.report()["digest"]


def main(arguments: list[str]) -> None:
    pinned = yaml.safe_load(PINNED.read_text())
    names = [name for name in arguments if name != "--pin"] or list(pinned)
    for name, digest in digests(names):
        print(name, digest, flush=True)
        pinned[name] = digest
    if "--pin" in arguments:
        PINNED.write_text(yaml.safe_dump(pinned, sort_keys=False))


if __name__ == "__main__":
    main(sys.argv[1:])

"""Makes golden bags as digests.yaml specifies and writes their digests there: `python bags/make.py [NAME ...]`.

A bag is replaced only if its content differs. After a change that is meant to change answers, inspect the differences
first (`fracture-collision replay bags/NAME`) and commit both.
"""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import yaml

from fracture_collision.bag.exchanges import read_runs
from fracture_collision.replay import InProcess, Replay, settings_of
from fracture_collision.ros.runs.scene_recording import Selection, record_scene
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import with_curvature
from fracture_collision.world.settings import for_step

FOLDER = Path(__file__).resolve().parent
DIGESTS = FOLDER / "digests.yaml"


def main(names: list[str]) -> None:
    """Makes the named bags, or all of digests.yaml, replaces those that differ, and writes their digests."""
    text = DIGESTS.read_text()
    recipes: dict[str, Any] = yaml.safe_load(text)
    unknown = sorted(set(names) - set(recipes))
    if unknown:
        sys.exit(f"{DIGESTS.name} has no {', '.join(unknown)}; it has {', '.join(recipes)}")
    for name in names or recipes:
        with tempfile.TemporaryDirectory(dir=FOLDER) as scratch:
            new, old = Path(scratch) / name, FOLDER / name
            make(recipes[name], new)
            recipes[name]["digest"] = digest_of(new)
            changed = not old.is_dir() or contents(old) != contents(new)
            if changed:
                shutil.rmtree(old, ignore_errors=True)
                new.rename(old)
        size = sum(len(content) for content in contents(old).values())
        print(f"{name:18} {size / 1e3:7.0f} kB  {recipes[name]['digest'][:16]}  {'new' if changed else 'as it was'}")
    head = "".join(line for line in text.splitlines(keepends=True) if line.startswith("#"))
    DIGESTS.write_text(f"{head}\n{yaml.safe_dump(recipes, sort_keys=False, default_flow_style=None, width=120)}")


def make(recipe: dict[str, Any], bag: Path) -> None:
    """Records a scene as its entry in digests.yaml specifies."""
    scene = load_scene(recipe["scene"])
    if "curvature" in recipe:
        scene = with_curvature(scene, recipe["curvature"])
    settings = for_step(scene.time_step, recipe.get("settings", {}))
    for _ in record_scene(scene, settings, None, bag, Selection(*recipe["steps"])):
        pass


def digest_of(bag: Path) -> str:
    """The digest of all answers; asserts that a replay reproduces the recorded ones."""
    replay = Replay(read_runs(bag), InProcess(settings_of(bag, {}).settings))
    for _ in replay:
        pass
    assert replay.report().exact
    return replay.report().digest


def contents(bag: Path) -> dict[str, bytes]:
    """The bytes of each file of a bag, by name."""
    return {file.name: file.read_bytes() for file in sorted(bag.iterdir())}


if __name__ == "__main__":
    main(sys.argv[1:])

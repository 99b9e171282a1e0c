"""`python -m benchmarks.page.pictures`: docs/play.png, docs/play_arm.png and docs/page.png, as a browser shows them.

Two live scenes, and the golden bag of plates as played by `fracture-collision view`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.page.lookers import browser
from benchmarks.page.person import PLATES, Person, scene_played, throw_at
from fracture_collision.run_meshes import read_run_with_meshes
from fracture_collision.viewer.page.bag_player import BagPlayer

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SWING = np.radians([-75.0, 60.0, 0.0, -80.0, 0.0, -50.0, 0.0])  # as in config/scenes/vase.yaml
FLIGHT = 60  # steps
THROUGH = np.radians(20.0)  # the vase stands at 0


def smash_plates(person: Person) -> None:
    for place in (PLATES[0], PLATES[2]):
        whole = person.status.fragments
        throw_at(person, place)
        person.until(lambda whole=whole: person.status.fragments > whole + 10, "shards")


def hit_vase(person: Person) -> None:
    person.hands.command_joints(SWING)
    person.wait(5.0)
    whole = person.status.fragments
    person.hands.command_joints([THROUGH], ["lbr_iiwa_joint_1"])
    person.until(lambda: person.status.fragments > whole + 5, "shards")
    step = person.status.step
    person.until(lambda: person.status.step > step + FLIGHT, "flying shards")


def take(scene: str, act: Callable[[Person], None], file: Path) -> None:
    with scene_played(scene) as (run, person):
        act(person)
        future = person.hands.pause(True)
        person.until(lambda: future.done() and person.status.paused, "a pause")
        with browser(run.address) as seen:
            seen.save_picture(file)


def take_recorded(bag: Path, moment: float, ticked: tuple[str, ...], file: Path) -> None:
    """At `moment` [s], with these boxes ticked."""
    with BagPlayer(read_run_with_meshes(bag)) as player, browser(player.page.address) as seen:
        player.play(False)
        for label in ticked:
            seen.tick(label)
        player.seek(moment)
        player.advance()
        seen.save_picture(file)


if __name__ == "__main__":
    take("plates", smash_plates, DOCS / "play.png")
    take("vase", hit_vase, DOCS / "play_arm.png")
    take_recorded(ROOT / "bags" / "plates", 0.55, ("contact points", "contact normals"), DOCS / "page.png")

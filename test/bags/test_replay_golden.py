"""The golden bags in bags/: the service's answers are those recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from worlds.recorded_pane import replayed

from fracture_collision.bag.exchanges import deserialize_record, read_runs
from fracture_collision.bag.reader import missing_words
from fracture_collision.records import ContactConstraintArray
from fracture_collision.replay import AS_RECORDED, Order, settings_of
from fracture_collision.simulation.scene.scene import scene_files

BAGS = Path(__file__).parents[2] / "bags"
GOLDEN: dict[str, dict[str, Any]] = yaml.safe_load((BAGS / "digests.yaml").read_text())
MOST_BYTES = 6_000_000  # [bytes] in total

OTHER_ANSWERS = """
The service answers otherwise than when this bag was made: {words}
Meant to? `python bags/make.py`, and commit bags/. Not meant to, and the last digits differ, on another processor than
those tried (bags/README.md)? Then something that answers rest on is rounded by what the processor has.
"""


@pytest.mark.parametrize("name", GOLDEN)
def test_answers_equal_those_of_the_golden_bag(name: str) -> None:
    bag = BAGS / name
    settings, words = settings_of(bag, {"threads": 2})
    assert words == missing_words(bag) == []
    runs = read_runs(bag)
    for order in (AS_RECORDED, Order(backwards=True)):
        report = replayed(runs, order, **settings._asdict())
        assert report.unrecorded == 0 and report.recorded_digest == GOLDEN[name]["digest"], "bag and digests.yaml"
        words = report.difference.words() if report.difference else ""
        assert report.exact and report.digest == GOLDEN[name]["digest"], OTHER_ANSWERS.format(words=words)


def test_golden_bags_have_contacts_fractures_and_other_settings() -> None:
    """Contacts in all bags, fractures where the scene has them, flat and curved cracks, and non-default settings."""
    events = {}
    for name in GOLDEN:
        (run,) = read_runs(BAGS / name)
        events[name] = len(run.events)
        assert len(run.questions) >= 4
        answers = [deserialize_record(question.answers[0], ContactConstraintArray) for question in run.questions]
        assert max(len(answer.record.gaps) for answer in answers) > 0
    unbroken = {name for name, count in events.items() if count == 0}
    assert unbroken == {"rolling_plate", "plate_in_bowl", "wall"}
    recipes = GOLDEN.values()
    assert sum(events.values()) > 80 and any("curvature" in each for each in recipes)
    assert len({tuple(each.get("settings", ())) for each in recipes}) >= 3


def test_every_scene_has_a_small_golden_bag() -> None:
    assert {recipe["scene"] for recipe in GOLDEN.values()} == {file.path.stem for file in scene_files()}
    assert sum(file.stat().st_size for file in BAGS.rglob("*")) < MOST_BYTES

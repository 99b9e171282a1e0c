"""Settings: invalid ones raise clear errors, and changes during a run give the answers of a world created with them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from worlds.broken_bar import BAR, STATES, told_world
from worlds.gate_world import SETTINGS as START
from worlds.gate_world import record_bytes

from fracture_collision.core.fracture import crack_surfaces
from fracture_collision.world import CollisionWorld, InvalidMessage, PaperSettings, Settings
from fracture_collision.world.settings import for_step, settings_text
from fracture_collision.world.warm_up import compile_kernels


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("contacts_per_pair", 0), ("penetration_tolerance", -0.1), ("detection_tolerance", 2.0), ("threads", -1),
        ("max_work", 0), ("max_bodies", -1), ("method", "guessed"), ("penetration_tolerance", float("nan")),
    ],
)  # fmt: skip
def test_a_setting_out_of_range_is_rejected_by_name(name: str, value: object) -> None:
    with pytest.raises(ValueError, match=name):
        CollisionWorld(Settings()._replace(**{name: value}))


@pytest.mark.parametrize("name", PaperSettings._fields)
def test_an_unknown_variant_of_the_paper_is_rejected_by_name(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name}: 'grown' is not one of"):
        CollisionWorld(Settings(method="glondu2014", paper=PaperSettings()._replace(**{name: "grown"})))


def test_a_setting_without_effect_is_rejected() -> None:
    with pytest.raises(ValueError, match="lookahead: 0.01 has no effect"):
        CollisionWorld(Settings(method="glondu2014", lookahead=0.01))
    with pytest.raises(ValueError, match="paper: its variants are those of method glondu2014"):
        CollisionWorld(Settings(paper=PaperSettings(tree="plain")))
    assert for_step(0.01, {"method": "glondu2014"}).lookahead == 0.0
    assert for_step(0.01, {}).lookahead == 0.01 and for_step(0.01, {"lookahead": 0.0}).lookahead == 0.0


def test_the_warm_up_compiles_what_only_a_second_fracture_needs() -> None:
    said: list[str] = []
    compile_kernels(said.append)
    assert len(said) == 3
    assert crack_surfaces.rebuild_surfaces.signatures


def test_equal_settings_have_equal_texts() -> None:
    """Whatever numbers they are given by; on one line, with all digits."""
    text = settings_text(Settings(lookahead=0, max_work=True, detection_tolerance=1))
    assert '"lookahead": 0.0,' in text and '"max_work": 1,' in text and '"detection_tolerance": 1.0,' in text
    assert "\n" not in text
    assert json.loads(settings_text(Settings(lookahead=1.0 / 120.0)))["lookahead"] == 1.0 / 120.0


CHANGES = [
    {"contacts_per_pair": 2}, {"penetration_tolerance": 0.1}, {"detection_tolerance": 0.05}, {"threads": 3},
    {"method": "glondu2014"}, {"method": "glondu2014", "paper": PaperSettings(field="exact")},
    {"method": "glondu2014", "paper": PaperSettings(tree="plain")},
    {"method": "glondu2014", "paper": PaperSettings(tree="rebuilt")},
    {"method": "glondu2014", "paper": PaperSettings(traversal="queue")}, {"max_work": 40}, {"max_contacts": 20},
    {"max_bodies": 1}, {"max_nodes": 1}, {"max_fragments": 1},
]  # fmt: skip
# No effect on answers: these affect the next body or fracture, or only the time.
UNSEEN = {"threads", "max_bodies", "max_nodes", "max_fragments"}

# STATES, and variants with the pieces pushed into each other and lifted off the ground.
MOVED = STATES._replace(positions=STATES.positions + np.array([0, 0, 0, 0, 0, 0.02, -0.03, 0.01, 0.02, -0.05, 0, 0.02]))


def answers(world: CollisionWorld) -> list[bytes]:
    """Repeated states give slow pairs their neighbour lists."""
    return [record_bytes(world.contacts(states)) for states in (STATES, STATES, STATES, MOVED)]


@pytest.mark.parametrize("change", CHANGES, ids=str)
def test_a_change_gives_the_answers_of_a_world_made_with_it(change: dict) -> None:
    """The registry names it, if it changes answers."""
    world, is_seen = told_world(START), not UNSEEN & set(change)
    before, named = answers(world), json.loads(world.fragments().settings)
    made_with_it = told_world(START._replace(**change) if is_seen else START)
    expected = answers(made_with_it)
    world.change_settings(START._replace(**change))
    assert world.fragments().digest == made_with_it.fragments().digest
    assert answers(world) == expected and (expected != before) == is_seen
    told = change if is_seen else {}
    if "method" in told:
        told = told | {"paper": told.get("paper", PaperSettings())._asdict()}
    assert json.loads(world.fragments().settings) == named | told
    assert named.keys() == set(Settings._fields) - UNSEEN - {"paper", "max_pairs", "max_message_bytes"}
    world.change_settings(START)
    assert answers(world) == before


def test_changed_limits_apply_to_later_messages() -> None:
    world = told_world(START)
    nodes = len(BAR.vertices) // 3
    for change, kind_of_limit in (
        ({"max_bodies": 2}, "2 bodies"), ({"max_fragments": 6}, "6 fragments"), ({"max_nodes": 2 * nodes - 1}, "nodes")
    ):  # fmt: skip
        world.change_settings(START._replace(**change))
        with pytest.raises(InvalidMessage, match=kind_of_limit) as refused:
            world.add_body(BAR._replace(body_id=9, fragment_id=90))
        assert refused.value.kind == "limit_exceeded"
    world.change_settings(START._replace(max_nodes=2 * nodes))
    world.add_body(BAR._replace(body_id=9, fragment_id=90))
    assert 90 in world.fragments().fragment_ids


def test_a_setting_out_of_range_changes_nothing() -> None:
    world = told_world(START)
    with pytest.raises(ValueError, match="penetration_tolerance"):
        world.change_settings(START._replace(contacts_per_pair=2, penetration_tolerance=np.nan))
    assert world.settings == START

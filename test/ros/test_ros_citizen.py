"""The service among other nodes: which run it follows, parameter changes, names, clocks and diagnostics."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import yaml
from diagnostic_msgs.msg import DiagnosticStatus
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from worlds.broken_bar import BAR, GROUND, STATES, expected_contacts, tell_all
from worlds.gate_world import FIRST, record_bytes

from fracture_collision.records import BOX, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.wire import qos
from fracture_collision.world import Settings
from fracture_collision.world.settings import settings_text

ANSWERS, SETTINGS, REFUSED = (f"fracture_collision: {name}" for name in ("answers", "settings", "refused messages"))
TWO_BOXES = FragmentStates(
    3, 0, np.array([1, 2]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.99]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
)


def tell_two_boxes(client: ServiceClient, run_id: int) -> None:
    for number in (1, 2):
        box = CollisionBody(number, number, primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)))
        client.publish("bodies", box, run_id)


def test_a_run_is_prepared_before_its_first_states(client: ServiceClient, run_id: int) -> None:
    meshes, topic = list[Any](), qos.FRAGMENT_MESHES
    client.node.create_subscription(topic.message_class, topic.name, meshes.append, topic.qos)
    told: list[int] = []

    def are_there() -> bool:
        """Whether those of a run are; else begins another, as the service may have to discover the subscription."""
        if not told or time.monotonic() > started[-1] + 2.0:
            told.append(run_id + len(told))
            started.append(time.monotonic())
            tell_two_boxes(client, told[-1])
        return sum(mesh.run_id == told[-1] for mesh in meshes) == 2

    started: list[float] = []
    client.spin_until(are_there, "meshes of both bodies")
    assert not client.answers and not client.registries
    assert client.ask(TWO_BOXES, told[-1]).fragment_b.tolist() == [2]
    assert client.await_registry(told[-1], 0).fragment_ids.tolist() == [1, 2]
    assert sorted(mesh.fragment_id for mesh in meshes if mesh.run_id == told[-1]) == [1, 2], "each once"


# --- two simulators ---------------------------------------------------------------------------------------------


def test_two_simulators_do_not_mix_their_runs(new_client: Callable[[], ServiceClient], run_id: int) -> None:
    """A new run id is a new scene; the simulator of the earlier one gets an explanation, and no answers."""
    first, second, another = new_client(), new_client(), run_id + 1
    tell_all(first, run_id)
    assert record_bytes(first.ask(STATES, run_id)) == record_bytes(expected_contacts())

    tell_two_boxes(second, another)
    assert second.ask(TWO_BOXES, another).fragment_b.tolist() == [2]
    first.publish("fracture_events", FIRST._replace(sequence=3, fragment_id=10), run_id)
    first.publish("bodies", GROUND._replace(sequence=9, body_id=9, fragment_id=90), run_id)
    first.publish("fragment_states", STATES._replace(step=6), run_id)
    for topic in ("bodies", "fracture_events", "fragment_states"):
        first.await_refusal(f"{topic}: other_run", f"run {run_id} is over: run {another} has begun since")
    assert second.ask(TWO_BOXES._replace(step=7), another).fragment_b.tolist() == [2]
    assert second.await_registry(another, 0).fragment_ids.tolist() == [1, 2]
    second.spin_until(lambda: second.diagnostics.get(ANSWERS) == "ready", "no states are held for the first")
    assert not any(answer.step == 6 for answer in first.answers)
    # the first run again, as when a bag is played in a loop
    tell_all(first, run_id)
    assert record_bytes(first.ask(STATES, run_id)) == record_bytes(expected_contacts())


def test_bodies_and_states_may_be_published_by_two_processes(
    new_client: Callable[[], ServiceClient], run_id: int
) -> None:
    first = new_client()
    tell_all(first, run_id)
    first.ask(STATES, run_id)
    first.drop_publisher("fragment_states")
    second = new_client()
    second.drop_publisher("bodies")
    second.drop_publisher("fracture_events")
    assert record_bytes(second.ask(STATES, run_id)) == record_bytes(expected_contacts())


# --- parameters --------------------------------------------------------------------------------------------------


def test_settings_change_between_two_answers(service: NodeProcess, client: ServiceClient, run_id: int) -> None:
    tell_all(client, run_id)
    start = Settings(threads=1)
    assert record_bytes(client.ask(STATES, run_id)) == record_bytes(expected_contacts(start))
    for change in (
        {"contacts_per_pair": 2}, {"penetration_tolerance": 0.1}, {"detection_tolerance": 0.05}, {"max_work": 40},
        {"method": "glondu2014"}, {"threads": 2},
    ):  # fmt: skip
        assert client.set_parameters(**change) == [""]
        changed = record_bytes(expected_contacts(start._replace(**change)))
        assert record_bytes(client.ask(STATES, run_id)) == changed, change
        name, value = next(iter(change.items()))
        client.spin_until(lambda name=name, value=value: client.details[SETTINGS][name] == str(value), name)
        assert client.diagnostics[SETTINGS] == f"since the answer to step {STATES.step} of run {run_id}"
        assert client.set_parameters(**{name: getattr(start, name)}) == [""]
    words = f"settings changed after the answer to step {STATES.step} of run {run_id}: contacts_per_pair: 8 -> 2"
    assert words in service.log_text()
    for change, words in (
        ({"method": "guessed"}, "method: 'guessed' is not one of exact, glondu2014"),
        ({"contacts_per_pair": 0}, "contacts_per_pair"),
        ({"penetration_tolerance": -0.001}, "penetration_tolerance"),
        ({"penetration_tolerance": "much"}, "Wrong parameter type"),
        ({"timing_file": "elsewhere.npy"}, "read-only"),
    ):
        (reason,) = client.set_parameters(**change)
        assert words in reason, reason
    assert record_bytes(client.ask(STATES, run_id)) == record_bytes(expected_contacts(start))


def test_answers_and_registries_say_what_they_were_made_with(client: ServiceClient, run_id: int) -> None:
    """A registry with the changed settings comes before the first answer with them, and none without such a change."""
    assert client.set_parameters(lookahead=0.01) == [""]
    tell_all(client, run_id)
    assert client.ask(STATES, run_id).lookahead == 0.01
    assert client.ask(STATES._replace(positions=STATES.positions * np.nan), run_id).lookahead == 0.01, "of a refusal"
    for change in ({"lookahead": 0.02}, {"max_work": 9}, {"threads": 2}, {"contacts_per_pair": 5}):
        assert client.set_parameters(**change) == [""]
        client.ask(STATES, run_id)
    assert client.answers[-1].lookahead == 0.02
    client.spin_until(lambda: len(client.registries) == 4, "a registry for each change that answers depend on")
    start = Settings(threads=1)
    told = [json.loads(registry.settings) for registry in client.registries]
    named = [(each["lookahead"], each["max_work"], each["contacts_per_pair"]) for each in told]
    assert named == [(0.01, start.max_work, 8), (0.02, start.max_work, 8), (0.02, 9, 8), (0.02, 9, 5)]
    assert len({registry.digest for registry in client.registries}) == 1
    assert client.registries[-1].settings == settings_text(
        Settings(lookahead=0.02, max_work=9, contacts_per_pair=5)
    )
    changed = ("lookahead", "max_work", "threads", "contacts_per_pair")
    assert client.set_parameters(**{name: getattr(start, name) for name in changed}) == [""] * 4


def test_a_misspelt_parameter_is_named(stage: StageWithClients, tmp_path: Path) -> None:
    file = tmp_path / "service.yaml"
    given = {"contacts_per_pairs": 3, "colour": "red", "method": "glondu2014"}
    file.write_text(yaml.safe_dump({"/**/collision_node": {"ros__parameters": given}}))
    service = stage.start("collision_node", "--params-file", str(file), threads=1, maxwork=5, use_sim_time=False)
    client = stage.client()
    client.await_service()
    said = [line.partition("]: ")[2] for line in service.log_text().splitlines() if "ERROR" in line]
    assert said == [
        "parameter colour is unknown and has no effect",
        "parameter contacts_per_pairs is unknown and has no effect; did you mean contacts_per_pair?",
        "parameter maxwork is unknown and has no effect; did you mean max_work?",
    ]
    client.spin_until(lambda: SETTINGS in client.diagnostics, "diagnostics")
    assert client.diagnostics[SETTINGS] == "; ".join(("since the start", *said))
    assert client.levels[SETTINGS] == DiagnosticStatus.WARN
    assert client.details[SETTINGS]["contacts_per_pair"] == "8" and client.details[SETTINGS]["method"] == "glondu2014"


def test_limits_are_parameters(stage: StageWithClients, run_id: int) -> None:
    _, client = stage.served(max_bodies=2, max_fragments=6, max_message_bytes=30_000)
    tell_all(client, run_id)
    good = record_bytes(client.ask(STATES, run_id))
    another = BAR._replace(body_id=9, fragment_id=90)
    for change, words in (
        ({}, "2 bodies"), ({"max_bodies": 9}, "6 fragments"), ({"max_fragments": 99, "max_nodes": 20}, "but max_nodes")
    ):  # fmt: skip
        client.set_parameters(**change)
        client.publish("bodies", another, run_id)
        client.await_refusal("bodies: limit_exceeded", words)
    client.publish("bodies", another._replace(vertices=np.zeros(3_750)), run_id)
    client.await_refusal("bodies: limit_exceeded", "max_message_bytes, 30000")
    assert record_bytes(client.ask(STATES, run_id)) == good


# --- names, clocks, diagnostics ----------------------------------------------------------------------------------


def test_services_in_a_namespace_and_with_remapped_topics(stage: StageWithClients, run_id: int) -> None:
    renamed = []
    for name in ("bodies", "fracture_events", "fragment_states", "contact_constraints", "fragments"):
        renamed += ["-r", f"{name}:=/cell/{name}_of_the_cell"]
    (_, left), (_, cell) = stage.served("-r", "__ns:=/left"), stage.served(*renamed)
    tell_all(left, run_id)
    tell_two_boxes(cell, run_id)
    for _ in range(3):
        assert record_bytes(left.ask(STATES, run_id)) == record_bytes(expected_contacts())
        assert cell.ask(TWO_BOXES, run_id).fragment_b.tolist() == [2]
    assert left.await_registry(run_id, 2).fragment_ids.tolist() == [2, 10, 12, 13]
    assert cell.await_registry(run_id, 0).fragment_ids.tolist() == [1, 2]
    assert stage.client().node.count_subscribers("fragment_states") == 0
    # /diagnostics is shared, so the two status names must differ.
    left.spin_until(lambda: {f"left/{ANSWERS}", ANSWERS} <= set(left.diagnostics), "diagnostics of both")


def test_diagnostics_come_every_second_with_times_while_simulation_time_stands_still(
    stage: StageWithClients, run_id: int
) -> None:
    service, client = stage.served(use_sim_time=True)
    tell_all(client, run_id)
    for _ in range(5):
        assert record_bytes(client.ask(STATES, run_id)) == record_bytes(expected_contacts())
    client.diagnostics_came.clear()
    client.spin_until(lambda: len(client.diagnostics_came) >= 6, "six words of the service, without a /clock")
    assert 0.9 < median(np.diff(client.diagnostics_came)) < 1.1
    details = client.details[ANSWERS]
    assert details["answers"] == "5" and details["states dropped for newer ones"] == "0"
    for part in ("answer", "update", "broad_phase", "narrow_phase", "conversion and publishing"):
        assert "ms median" in details[f"{part} (last 5)"] and "ms worst" in details[f"{part} (last 5)"]
    # a thousand rejections are a few log lines
    started = time.monotonic()
    for sequence in range(100, 1100):
        client.publish("fracture_events", FIRST._replace(sequence=sequence), run_id)
    client.spin_until(lambda: client.diagnostics.get(REFUSED, "").startswith("1000 rejected"), "a thousand refusals")
    seconds = time.monotonic() - started
    lines = service.log_text().count("rejected, ")
    assert 1 <= lines <= seconds + 2, (lines, seconds)
    assert client.details[REFUSED].keys() == {"fracture_events: sequence_gap"}

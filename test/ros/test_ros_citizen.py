"""The service among other nodes: which run it follows, parameter changes, names, clocks and diagnostics."""

from __future__ import annotations

import json
import time
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
from fracture_collision.ros.wire import qos
from fracture_collision.world import Settings
from fracture_collision.world.settings import settings_text

RUN = 41
ANSWERS, SETTINGS, REFUSED = (f"fracture_collision: {name}" for name in ("answers", "settings", "refused messages"))
TWO_BOXES = FragmentStates(
    3, 0, np.array([1, 2]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.99]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
)


def tell_two_boxes(client: ServiceClient, run_id: int) -> None:
    for number in (1, 2):
        box = CollisionBody(number, number, primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)))
        client.publish("bodies", box, run_id)


def test_a_run_is_prepared_before_its_first_states(stage: StageWithClients) -> None:
    _, client = stage.served()
    meshes, topic = list[Any](), qos.FRAGMENT_MESHES
    client.node.create_subscription(topic.message_class, topic.name, meshes.append, topic.qos)
    told: list[int] = []

    def are_there() -> bool:
        """Whether those of a run are; else begins another, as the service may have to discover the subscription."""
        if not told or time.monotonic() > started[-1] + 2.0:
            told.append(RUN + len(told))
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


def test_two_simulators_do_not_mix_their_runs(stage: StageWithClients) -> None:
    """A new run id is a new scene; the simulator of the earlier one gets an explanation, and no answers."""
    _, first = stage.served()
    tell_all(first, RUN)
    assert record_bytes(first.ask(STATES, RUN)) == record_bytes(expected_contacts())

    second = stage.client()
    second.await_service()
    tell_two_boxes(second, RUN + 1)
    assert second.ask(TWO_BOXES, RUN + 1).fragment_b.tolist() == [2]
    first.publish("fracture_events", FIRST._replace(sequence=3, fragment_id=10), RUN)
    first.publish("bodies", GROUND._replace(sequence=9, body_id=9, fragment_id=90), RUN)
    first.publish("fragment_states", STATES._replace(step=6), RUN)
    for topic in ("bodies", "fracture_events", "fragment_states"):
        first.await_refusal(f"{topic}: other_run", f"run {RUN} is over: run {RUN + 1} has begun since")
    assert second.ask(TWO_BOXES._replace(step=7), RUN + 1).fragment_b.tolist() == [2]
    assert second.await_registry(RUN + 1, 0).fragment_ids.tolist() == [1, 2]
    second.spin_until(lambda: second.diagnostics.get(ANSWERS) == "ready", "no states are held for the first")
    assert not any(answer.step == 6 for answer in first.answers)


def test_bodies_and_states_may_be_published_by_two_processes(stage: StageWithClients) -> None:
    _, first = stage.served()
    tell_all(first, RUN)
    first.ask(STATES, RUN)
    first.drop_publisher("fragment_states")
    second = stage.client()
    second.drop_publisher("bodies")
    second.drop_publisher("fracture_events")
    second.await_service()
    assert record_bytes(second.ask(STATES, RUN)) == record_bytes(expected_contacts())


# --- parameters --------------------------------------------------------------------------------------------------


def test_settings_change_between_two_answers(stage: StageWithClients) -> None:
    service, client = stage.served()
    tell_all(client, RUN)
    start = Settings(threads=1)
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(expected_contacts(start))
    for change in (
        {"contacts_per_pair": 2}, {"penetration_tolerance": 0.1}, {"detection_tolerance": 0.05}, {"max_work": 40},
        {"method": "glondu2014"}, {"threads": 2},
    ):  # fmt: skip
        assert client.set_parameters(**change) == [""]
        changed = record_bytes(expected_contacts(start._replace(**change)))
        assert record_bytes(client.ask(STATES, RUN)) == changed, change
        name, value = next(iter(change.items()))
        client.spin_until(lambda name=name, value=value: client.details[SETTINGS][name] == str(value), name)
        assert client.diagnostics[SETTINGS] == f"since the answer to step {STATES.step} of run {RUN}"
        assert client.set_parameters(**{name: getattr(start, name)}) == [""]
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(expected_contacts(start))
    assert "settings changed after the answer to step 5 of run 41: contacts_per_pair: 8 -> 2" in service.log_text()


def test_answers_and_registries_say_what_they_were_made_with(stage: StageWithClients) -> None:
    """A registry with the changed settings comes before the first answer with them, and none without such a change."""
    _, client = stage.served(lookahead=0.01)
    tell_all(client, RUN)
    assert client.ask(STATES, RUN).lookahead == 0.01
    assert client.ask(STATES._replace(positions=STATES.positions * np.nan), RUN).lookahead == 0.01, "of a refusal"
    for change in ({"lookahead": 0.02}, {"max_work": 9}, {"threads": 2}, {"contacts_per_pair": 5}):
        assert client.set_parameters(**change) == [""]
        client.ask(STATES, RUN)
    assert client.answers[-1].lookahead == 0.02
    client.spin_until(lambda: len(client.registries) == 4, "a registry for each change that answers depend on")
    work = Settings().max_work
    told = [json.loads(registry.settings) for registry in client.registries]
    named = [(each["lookahead"], each["max_work"], each["contacts_per_pair"]) for each in told]
    assert named == [(0.01, work, 8), (0.02, work, 8), (0.02, 9, 8), (0.02, 9, 5)]
    assert len({registry.digest for registry in client.registries}) == 1
    assert client.registries[-1].settings == settings_text(
        Settings(lookahead=0.02, max_work=9, contacts_per_pair=5)
    )


def test_invalid_parameter_changes_are_rejected_with_an_explanation(stage: StageWithClients) -> None:
    _, client = stage.served()
    tell_all(client, RUN)
    for change, words in (
        ({"method": "guessed"}, "method: 'guessed' is not one of exact, glondu2014"),
        ({"contacts_per_pair": 0}, "contacts_per_pair"),
        ({"penetration_tolerance": -0.001}, "penetration_tolerance"),
        ({"penetration_tolerance": "much"}, "Wrong parameter type"),
        ({"timing_file": "elsewhere.npy"}, "read-only"),
    ):
        (reason,) = client.set_parameters(**change)
        assert words in reason, reason
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(expected_contacts(Settings(threads=1)))


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


def test_limits_are_parameters(stage: StageWithClients) -> None:
    _, client = stage.served(max_bodies=2, max_fragments=6, max_message_bytes=30_000)
    tell_all(client, RUN)
    good = record_bytes(client.ask(STATES, RUN))
    another = BAR._replace(body_id=9, fragment_id=90)
    for change, words in (
        ({}, "2 bodies"), ({"max_bodies": 9}, "6 fragments"), ({"max_fragments": 99, "max_nodes": 20}, "but max_nodes")
    ):  # fmt: skip
        client.set_parameters(**change)
        client.publish("bodies", another, RUN)
        client.await_refusal("bodies: limit_exceeded", words)
    client.publish("bodies", another._replace(vertices=np.zeros(3_750)), RUN)
    client.await_refusal("bodies: limit_exceeded", "max_message_bytes, 30000")
    assert record_bytes(client.ask(STATES, RUN)) == good


# --- names, clocks, diagnostics ----------------------------------------------------------------------------------


def test_two_services_in_two_namespaces(stage: StageWithClients) -> None:
    clients = {}
    for side in ("left", "right"):
        _, clients[side] = stage.served("-r", f"__ns:=/{side}")
    tell_all(clients["left"], RUN)
    tell_two_boxes(clients["right"], RUN)
    for _ in range(3):
        assert record_bytes(clients["left"].ask(STATES, RUN)) == record_bytes(expected_contacts())
        assert clients["right"].ask(TWO_BOXES, RUN).fragment_b.tolist() == [2]
    # /diagnostics is shared, so the two status names must differ.
    names = {f"{side}/{ANSWERS}" for side in clients}
    clients["left"].spin_until(lambda: names <= set(clients["left"].diagnostics), "diagnostics of both")


def test_remapped_topics(stage: StageWithClients) -> None:
    renamed = []
    for name in ("bodies", "fracture_events", "fragment_states", "contact_constraints", "fragments"):
        renamed += ["-r", f"{name}:=/cell/{name}_of_the_cell"]
    _, client = stage.served(*renamed)
    stranger = stage.client()
    tell_all(client, RUN)
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(expected_contacts())
    assert client.await_registry(RUN, 2).fragment_ids.tolist() == [2, 10, 12, 13]
    assert stranger.node.count_subscribers("fragment_states") == 0


def test_the_service_answers_while_simulation_time_stands_still(stage: StageWithClients) -> None:
    _, client = stage.served(use_sim_time=True)
    tell_all(client, RUN)
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(expected_contacts())
    client.diagnostics_came.clear()
    client.spin_until(lambda: len(client.diagnostics_came) >= 3, "diagnostics without a /clock")


def test_diagnostics_are_published_every_second_with_times(stage: StageWithClients) -> None:
    _, client = stage.served()
    tell_all(client, RUN)
    for _ in range(5):
        client.ask(STATES, RUN)
    client.diagnostics_came.clear()
    client.spin_until(lambda: len(client.diagnostics_came) >= 6, "six words of the service")
    assert 0.9 < median(np.diff(client.diagnostics_came)) < 1.1
    details = client.details[ANSWERS]
    assert details["answers"] == "5" and details["states dropped for newer ones"] == "0"
    for part in ("answer", "update", "broad_phase", "narrow_phase", "conversion and publishing"):
        assert "ms median" in details[f"{part} (last 5)"] and "ms worst" in details[f"{part} (last 5)"]


def test_a_thousand_rejections_are_a_few_log_lines(stage: StageWithClients) -> None:
    service, client = stage.served()
    tell_all(client, RUN)
    client.ask(STATES, RUN)
    started = time.monotonic()
    for sequence in range(100, 1100):
        client.publish("fracture_events", FIRST._replace(sequence=sequence), RUN)
    client.spin_until(lambda: client.diagnostics.get(REFUSED, "").startswith("1000 rejected"), "a thousand refusals")
    seconds = time.monotonic() - started
    lines = service.log_text().count("rejected, ")
    assert 1 <= lines <= seconds + 2, (lines, seconds)
    assert client.details[REFUSED].keys() == {"fracture_events: sequence_gap"}

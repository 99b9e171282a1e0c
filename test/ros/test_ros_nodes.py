"""The service in its own process, over DDS: answers, rejections, startup and shutdown."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from stages.interrupted_loading import run_code
from stages.ros_client import ServiceClient
from stages.ros_stage import LARGEST_MESSAGE, StageWithClients
from worlds.broken_bar import BAR, GROUND, STATES, expected_contacts, tell_all
from worlds.gate_world import FIRST, SECOND, record_bytes

from fracture_collision.records import INVALID_STATES
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id, loopback_environment
from fracture_collision.ros.wire.cdr_records import serialize_record
from fracture_collision.ros.wire.conversion import heading, to_message, to_record

ANSWERS = "fracture_collision: answers"
EARLY = STATES._replace(fracture_sequence=0, fragment_ids=np.array([1]), positions=np.array([0.0, 0.0, 0.24]),
                        orientations=np.array([0.0, 0.0, 0.0, 1.0]))  # fmt: skip


def test_answers_equal_those_of_the_library(client: ServiceClient, run_id: int) -> None:
    tell_all(client, run_id)
    first = client.ask(STATES, run_id)
    assert record_bytes(first) == record_bytes(to_record(to_message(expected_contacts(), heading(0.0), run_id)))
    registry = client.await_registry(run_id, 2)
    assert registry.fragment_ids.tolist() == [2, 10, 12, 13] and len(registry.digest) == 64

    # From the same log: an earlier registry, then the current one again.
    assert client.ask(EARLY, run_id).fragment_a.tolist() == [1]
    assert record_bytes(client.ask(STATES, run_id)) == record_bytes(first)


def test_states_are_held_until_their_bodies_and_events_arrive(client: ServiceClient, run_id: int) -> None:
    client.publish("fragment_states", STATES, run_id)
    client.publish("fracture_events", FIRST, run_id)
    client.publish("fracture_events", SECOND, run_id)
    client.publish("bodies", GROUND, run_id)
    client.spin_until(lambda: "are held" in client.diagnostics.get(ANSWERS, ""), "a word on it")
    assert client.answers == []
    client.publish("bodies", BAR, run_id)
    client.spin_until(lambda: len(client.answers) == 1, "the answer to states that were held")
    assert client.answers[0].step == STATES.step and len(client.answers[0].gaps) > 0


def test_states_that_do_not_say_which_bodies_precede_them_are_answered_with_one_warning(
    service: NodeProcess, client: ServiceClient, run_id: int
) -> None:
    client.publish("bodies", GROUND._replace(sequence=1), run_id)
    client.publish("bodies", BAR._replace(sequence=2), run_id)
    words = "have no body_sequence"
    before = service.log_text().count(words)
    assert len(client.ask(EARLY._replace(body_sequence=2), run_id)) > 0
    assert len(client.ask(EARLY._replace(step=6), run_id)) > 0
    client.spin_until(lambda: words in client.diagnostics.get(ANSWERS, ""), "a warning")
    client.spin_until(lambda: client.diagnostics[ANSWERS] == "ready", "only once")
    assert client.details[ANSWERS]["states name the bodies before them"] == "False"
    assert service.log_text().count(words) == before + 1


@pytest.mark.parametrize(
    ("how", "reason"),
    [("a field", "node_fragments"), ("its size", "max_message_bytes"), ("its bytes", "are too few for its field")],
)
def test_a_rejected_event_blocks_nothing_for_ever(
    how: str, reason: str, client: ServiceClient, run_id: int
) -> None:
    """States that need it are rejected at once; the corrected event also applies the events that arrived meanwhile."""
    for body in (BAR, GROUND):
        client.publish("bodies", body, run_id)
    if how == "a field":
        client.publish("fracture_events", FIRST._replace(nodes=FIRST.nodes[1:]), run_id)
    else:
        data = serialize_record(FIRST, heading(0.0), run_id)
        data = data + bytes(LARGEST_MESSAGE) if how == "its size" else data[:-200]
        client.publish_bytes("fracture_events", data)
    client.publish("fracture_events", SECOND, run_id)
    client.publish("fragment_states", STATES, run_id)
    client.spin_until(lambda: len(client.answers) == 1, "an answer to states that need a rejected event")
    assert client.answers[0].status == INVALID_STATES and client.answers[0].step == STATES.step
    truth = "a corrected event with sequence 1 is awaited"
    client.spin_until(lambda: truth in client.diagnostics.get(ANSWERS, ""), "what is awaited")
    assert client.diagnostics[ANSWERS].startswith("event 1 was rejected: ") and reason in client.diagnostics[ANSWERS]
    client.await_refusal("fragment_states: event_rejected", client.diagnostics[ANSWERS])
    assert client.ask(STATES._replace(step=6), run_id).status == INVALID_STATES
    client.publish("fracture_events", FIRST, run_id)
    client.spin_until(lambda: client.diagnostics[ANSWERS] == "ready", "nothing to be awaited")
    contacts = client.ask(STATES, run_id)
    assert record_bytes(contacts) == record_bytes(to_record(to_message(expected_contacts(), heading(0.0), run_id)))


def test_bad_input_is_rejected_with_an_explanation(service: NodeProcess, client: ServiceClient, run_id: int) -> None:
    """Every rule, by its kind alone: test_bad_input_node."""
    tell_all(client, run_id)
    good = client.ask(STATES, run_id)

    refused = client.ask(STATES._replace(positions=STATES.positions * np.nan), run_id)
    assert refused.status == INVALID_STATES and len(refused.gaps) == 0
    client.await_refusal("fragment_states: not_finite", "positions")

    data = serialize_record(STATES, heading(0.0), run_id)
    for wrong, kind, words in (
        (data[:-24], "malformed", f"{len(data) - 24} bytes are too few"),
        (b"\x07\x07" + data[2:], "malformed", "no serialized FragmentStates"),
        (data + bytes(LARGEST_MESSAGE), "limit_exceeded", "max_message_bytes"),
    ):
        client.publish_bytes("fragment_states", wrong)
        client.await_refusal(f"fragment_states: {kind}", words)

    client.publish("bodies", BAR._replace(body_id=9, fragment_id=90, vertices=np.zeros(12_501)), run_id)
    client.await_refusal("bodies: limit_exceeded", "max_message_bytes")
    client.publish("fracture_events", SECOND._replace(sequence=9), run_id)
    client.await_refusal("fracture_events: sequence_gap", "event 9 is held: event 3 has not arrived")

    assert record_bytes(client.ask(STATES, run_id)) == record_bytes(good)
    # at most one line per second is logged, for the first rejection in it
    assert "[collision_node]: rejected, " in service.log_text()


def test_a_signal_while_kernels_load_ends_the_process_at_once() -> None:
    done = run_code(
        "from fracture_collision.ros.service.collision_node import main", "sys.exit(main())",
        order=signal.SIGTERM, environment=loopback_environment(free_domain_id()),
    )  # fmt: skip
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert "ready" not in done.stderr


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_start_up_loads_its_kernels_and_a_signal_ends_it(stage: StageWithClients, order: signal.Signals) -> None:
    """With cached kernels nothing is compiled, neither before "ready" nor by the first answer."""
    client = stage.client()
    tell_all(client, 1)
    service = stage.start("collision_node", threads=1)
    client.await_service()
    client.ask(STATES, 1)
    assert "loading kernels" in service.log_text() and "ready" in service.log_text()
    assert "compil" not in service.log_text()
    service.send_signal(order)
    assert service.wait(10.0) == 0
    assert "Traceback" not in service.log_text()

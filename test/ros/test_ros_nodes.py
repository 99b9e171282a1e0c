"""The service in its own process, over DDS: answers, rejections, startup and shutdown."""

from __future__ import annotations

import signal

import numpy as np
import pytest
from stages.interrupted_loading import run_code
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from worlds.broken_bar import BAR, GROUND, STATES, expected_contacts, tell_all
from worlds.gate_world import FIRST, SECOND, record_bytes

from campaigns.soak import processor_seconds
from fracture_collision.records import BOX, INVALID_STATES, CollisionBody, SolidPrimitive
from fracture_collision.ros.processes.node_process import NodeProcess, loopback_environment
from fracture_collision.ros.wire.cdr_records import serialize_record
from fracture_collision.ros.wire.conversion import heading, to_message, to_record

RUN = 41
LARGEST_MESSAGE = 100_000  # [bytes]


@pytest.fixture
def service(stage: StageWithClients) -> NodeProcess:
    return stage.start("collision_node", threads=1, max_message_bytes=LARGEST_MESSAGE)


@pytest.fixture
def client(service: NodeProcess, stage: StageWithClients) -> ServiceClient:
    client = stage.client()
    client.await_service()
    return client


def test_answers_equal_those_of_the_library(client: ServiceClient) -> None:
    tell_all(client, RUN)
    first = client.ask(STATES, RUN)
    assert record_bytes(first) == record_bytes(to_record(to_message(expected_contacts(), heading(0.0), RUN)))
    registry = client.await_registry(RUN, 2)
    assert registry.fragment_ids.tolist() == [2, 10, 12, 13] and len(registry.digest) == 64

    # From the same log: an earlier registry, then the current one again.
    early = STATES._replace(step=1, fracture_sequence=0, fragment_ids=np.array([1]),
                            positions=np.array([0.0, 0.0, 0.24]), orientations=np.array([0.0, 0.0, 0.0, 1.0]))
    assert client.ask(early, RUN).fragment_a.tolist() == [1]
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(first)


def test_states_are_held_until_their_bodies_and_events_arrive(client: ServiceClient) -> None:
    client.publish("fragment_states", STATES, RUN)
    client.publish("fracture_events", FIRST, RUN)
    client.publish("fracture_events", SECOND, RUN)
    client.publish("bodies", GROUND, RUN)
    client.spin_until(lambda: "are held" in client.diagnostics.get("fracture_collision: answers", ""), "a word on it")
    assert client.answers == []
    client.publish("bodies", BAR, RUN)
    client.spin_until(lambda: len(client.answers) == 1, "the answer to states that were held")
    assert client.answers[0].step == STATES.step and len(client.answers[0].gaps) > 0


def test_states_that_do_not_say_which_bodies_precede_them_are_answered_with_one_warning(
    service: NodeProcess, client: ServiceClient
) -> None:
    client.publish("bodies", GROUND._replace(sequence=1), RUN)
    client.publish("bodies", BAR._replace(sequence=2), RUN)
    early = STATES._replace(fracture_sequence=0, fragment_ids=np.array([1]), positions=np.array([0.0, 0.0, 0.24]))
    early = early._replace(orientations=np.array([0.0, 0.0, 0.0, 1.0]))
    assert len(client.ask(early._replace(body_sequence=2), RUN)) > 0
    assert len(client.ask(early._replace(step=6), RUN)) > 0
    answers = "fracture_collision: answers"
    client.spin_until(lambda: "have no body_sequence" in client.diagnostics.get(answers, ""), "a warning")
    client.spin_until(lambda: client.diagnostics[answers] == "ready", "only once")
    assert client.details[answers]["states name the bodies before them"] == "False"
    assert service.log_text().count("have no body_sequence") == 1


@pytest.mark.parametrize("how", ["a field", "its size", "its bytes"])
def test_a_rejected_event_blocks_nothing_for_ever(how: str, client: ServiceClient) -> None:
    """States that need it are rejected at once; the corrected event also applies the events that arrived meanwhile."""
    for body in (BAR, GROUND):
        client.publish("bodies", body, RUN)
    if how == "a field":
        client.publish("fracture_events", FIRST._replace(nodes=FIRST.nodes[1:]), RUN)
    else:
        data = serialize_record(FIRST, heading(0.0), RUN)
        data = data + bytes(LARGEST_MESSAGE) if how == "its size" else data[:-200]
        client.publish_bytes("fracture_events", data)
    client.publish("fracture_events", SECOND, RUN)
    client.publish("fragment_states", STATES, RUN)
    client.spin_until(lambda: len(client.answers) == 1, "an answer to states that need a rejected event")
    assert client.answers[0].status == INVALID_STATES and client.answers[0].step == STATES.step
    answers = "fracture_collision: answers"
    truth = "a corrected event with sequence 1 is awaited"
    client.spin_until(lambda: truth in client.diagnostics.get(answers, ""), "what is awaited")
    assert client.diagnostics[answers].startswith("event 1 was rejected: ")
    client.await_refusal("fragment_states: event_rejected", truth)
    assert client.ask(STATES._replace(step=6), RUN).status == INVALID_STATES
    client.publish("fracture_events", FIRST, RUN)
    client.spin_until(lambda: client.diagnostics[answers] == "ready", "nothing to be awaited")
    contacts = client.ask(STATES, RUN)
    assert record_bytes(contacts) == record_bytes(to_record(to_message(expected_contacts(), heading(0.0), RUN)))


def test_a_new_run_id_is_a_new_scene(client: ServiceClient) -> None:
    tell_all(client, RUN)
    first = client.ask(STATES, RUN)
    box = CollisionBody(1, 1, primitive=SolidPrimitive(BOX, (1.0, 1.0, 1.0)))
    client.publish("bodies", box, RUN + 1)
    alone = STATES._replace(fracture_sequence=0, fragment_ids=np.array([1]), positions=np.zeros(3),
                            orientations=np.array([0.0, 0.0, 0.0, 1.0]))  # fmt: skip
    assert len(client.ask(alone, RUN + 1).gaps) == 0
    assert client.await_registry(RUN + 1, 0).fragment_ids.tolist() == [1]
    # The first run again, as when a bag is played in a loop.
    tell_all(client, RUN)
    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(first)


def test_bad_input_is_rejected_with_an_explanation(service: NodeProcess, client: ServiceClient) -> None:
    tell_all(client, RUN)
    good = client.ask(STATES, RUN)

    positions = STATES.positions.copy()
    positions[4] = np.nan
    for states, kind, words in (
        (STATES._replace(positions=positions), "not_finite", "positions"),
        (STATES._replace(orientations=STATES.orientations[:-1]), "size_mismatch", "orientations"),
        (STATES._replace(fragment_ids=np.array([2, 10, 11, 13])), "retired_id", "fragment 11"),
    ):
        refused = client.ask(states, RUN)
        assert refused.status == INVALID_STATES and len(refused.gaps) == 0
        client.await_refusal(f"fragment_states: {kind}", words)

    data = serialize_record(STATES, heading(0.0), RUN)
    for wrong, kind, words in (
        (data[:-24], "malformed", f"{len(data) - 24} bytes are too few"),
        (b"\x07\x07" + data[2:], "malformed", "no serialized FragmentStates"),
        (data + bytes(LARGEST_MESSAGE), "limit_exceeded", "max_message_bytes"),
    ):
        client.publish_bytes("fragment_states", wrong)
        client.await_refusal(f"fragment_states: {kind}", words)

    client.publish("bodies", BAR._replace(body_id=9, fragment_id=90, density=-1.0), RUN)
    client.await_refusal("bodies: out_of_range", "density")
    client.publish("bodies", BAR._replace(body_id=9, fragment_id=90, vertices=np.zeros(12_501)), RUN)
    client.await_refusal("bodies: limit_exceeded", "max_message_bytes")
    client.publish("fracture_events", SECOND._replace(sequence=9), RUN)
    client.await_refusal("fracture_events: sequence_gap", "event 9 is held: event 3 has not arrived")
    client.publish("fracture_events", FIRST._replace(sequence=3, body_id=77), RUN)
    client.await_refusal("fracture_events: unknown_id", "no body 77")

    assert record_bytes(client.ask(STATES, RUN)) == record_bytes(good)
    # at most one line per second is logged, for the first rejection in it
    assert "[collision_node]: rejected, " in service.log_text()


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_nodes_end_cleanly_on_signals(service: NodeProcess, client: ServiceClient, order: signal.Signals) -> None:
    client.spin_until(lambda: client.diagnostics.get("fracture_collision: answers") == "ready", "its first words")
    service.send_signal(order)
    assert service.wait(10.0) == 0
    assert "Traceback" not in service.log_text()


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_while_kernels_load_ends_the_process_at_once(stage: StageWithClients, order: signal.Signals) -> None:
    done = run_code(
        "from fracture_collision.ros.service.collision_node import main", "sys.exit(main())",
        order=order, environment=loopback_environment(stage.domain_id),
    )  # fmt: skip
    assert done.returncode == 0 and "Traceback" not in done.stderr, done.stderr
    assert "ready" not in done.stderr


def test_start_up_takes_little_processor_time(stage: StageWithClients) -> None:
    """With cached kernels, at most three seconds of processor time.

    On a busy machine wall time would include the work of other processes.
    """
    client = stage.client()
    tell_all(client, RUN)
    service = stage.start("collision_node", threads=1)
    client.await_service()
    client.ask(STATES, RUN)
    assert 0.0 < processor_seconds(service.pid) < 3.0
    assert "loading kernels" in service.log_text() and "ready" in service.log_text()

"""Hundreds of bad messages to a real node over DDS: each is counted by kind, and the node's state is unchanged."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients
from worlds.gate_world import EARLIER, FIRST, REFERENCE, record_bytes

from campaigns.bad_input.campaign import every_case, picking
from campaigns.bad_input.clean_scene import CLEAN, ENDING, SETTINGS
from campaigns.bad_input.doors import REFUSED, RunDoor, as_bytes
from campaigns.bad_input.serialized import valid_messages
from campaigns.bad_input.trial import Case, spoilt
from fracture_collision.records import INVALID_STATES
from fracture_collision.ros.processes.node_process import NodeProcess

RUN = 41
WAITED_FOR = 4  # /diagnostics is published once a second
LATCHED = ("bodies", "fracture_events")
MORE_MEMORY = 20e6  # [bytes] DDS keeps the received samples of a latched topic
# There is no order across topics: the event is sent once its body is known to have arrived.
BEGINNING = (*CLEAN[:-2], ("fragment_states", EARLIER), *CLEAN[-2:])
LIMITS = {"max_nodes": SETTINGS.max_nodes, "max_fragments": SETTINGS.max_fragments}


def refused_cases(topic: str) -> list[tuple[Case, str]]:
    """Cases that a message can encode and that must be rejected, with the kind of rejection."""
    twin, found = RunDoor(SETTINGS), []
    for door, case in (*every_case(seed=3), *every_case(seed=4)):
        if door == "messages" and case.topic == topic and case.must_fail and case.settings == SETTINGS:
            if len(as_bytes(case.record)) > 50_000:
                continue
            verdict = twin.deliver(topic, case.record)
            if verdict.outcome == REFUSED:
                found.append((case, verdict.kind))
    return found


def counts(client: ServiceClient) -> Counter[str]:
    """Counts on /diagnostics by 'topic: kind'."""
    return Counter({key: int(value.split(",")[0]) for key, value in client._refusals.items()})


def play(client: ServiceClient, messages: tuple) -> list[bytes]:
    """The answers; states that overtake the event which mends a rejected one are rejected, and asked again."""
    answers = []
    for topic, record in messages:
        if topic == "fragment_states":
            answer = client.ask(record, RUN)
            for _ in range(100):
                if answer.status != INVALID_STATES:
                    break
                client.spin_once(timeout_sec=0.05)
                answer = client.ask(record, RUN)
            answers.append(record_bytes(answer))
        else:
            client.publish(topic, record, RUN)
    return answers


def resident(process: NodeProcess) -> int:
    return int(Path(f"/proc/{process.pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGESIZE")


def undisturbed() -> tuple[list[bytes], str]:
    """The library's answers to the clean scene and its ending, and the final digest."""
    door = RunDoor(SETTINGS)
    asked = [record for topic, record in ENDING if topic == "fragment_states"]
    answers = [record_bytes(door.run.answer(REFERENCE))]
    for topic, record in ENDING:
        if topic == "fragment_states":
            answers.append(record_bytes(door.run.answer(record)))
        else:
            assert not door.run.add_fracture(record)
    assert len(answers) == 1 + len(asked)
    return answers, door.world.fragments().digest


def test_a_node_survives_bad_messages_and_counts_them(stage: StageWithClients) -> None:
    node, client = stage.served(**LIMITS)
    answers = play(client, BEGINNING)[1:]
    expected: Counter[str] = Counter()
    before = resident(node)

    for topic in LATCHED:
        for case, kind in refused_cases(topic):
            client.publish(topic, case.record, RUN)
            expected[f"{topic}: {kind}"] += 1
    for case, kind in refused_cases("fragment_states"):
        refused = client.ask(case.record, RUN)
        assert refused.status == INVALID_STATES and len(refused.gaps) == 0
        expected[f"fragment_states: {kind}"] += 1

    # another run without bodies: its event is held and its states are not answered
    client.publish("fracture_events", FIRST, RUN + 1)
    expected["fracture_events: unknown_id"] += 1
    client.publish("fragment_states", EARLIER, RUN + 1)

    client.spin_until(lambda: counts(client) == expected, f"these counts: {expected}")
    assert expected.total() > 300 and len(expected) > 20
    assert node.exit_status() is None

    answers += play(client, ENDING)
    good_answers, digest = undisturbed()
    assert answers == good_answers
    client.spin_until(lambda: client.registries[-1].digest == digest, "the registry that it must have come to")
    assert resident(node) - before < MORE_MEMORY
    assert "Traceback" not in node.log_text()


def malformed(topic: str) -> Iterator[bytes]:
    """Corrupted messages that cannot be deserialized."""
    twin = RunDoor(SETTINGS)
    for number in range(300):
        data = spoilt(topic, picking(11, number)).record
        # DDS drops data shorter than the encapsulation header and pads to a multiple of four bytes
        if len(data) >= 4 and len(data) % 4 == 0 and twin.deliver(topic, data).kind == "malformed":
            yield data
    for data in valid_messages(topic):
        yield from (data[:length] for length in range(4, len(data), 100))


TOPICS_READ_AS_BYTES = ("bodies", "fracture_events", "fragment_states")


def test_a_node_survives_corrupted_bytes_and_counts_them(stage: StageWithClients) -> None:
    node, client = stage.served(**LIMITS)
    first = play(client, BEGINNING)[1:]
    before = resident(node)
    sent: Counter[str] = Counter()
    for topic in TOPICS_READ_AS_BYTES:
        for data in malformed(topic):
            client.publish_bytes(topic, data)
            sent[key := f"{topic}: malformed"] += 1
            # only the newest states are read: wait for the first few, the others may be dropped unread
            if topic not in LATCHED and sent[key] <= WAITED_FOR:
                client.spin_until(lambda key=key: counts(client)[key] == sent[key], f"{key} {sent[key]} times")
    assert min(sent.values()) > 40
    latched = {key: n for key, n in sent.items() if key.split(":")[0] in LATCHED}
    client.spin_until(lambda: all(counts(client)[key] == n for key, n in latched.items()), f"{latched}")
    assert node.exit_status() is None
    assert play(client, CLEAN[-1:]) == first
    assert resident(node) - before < MORE_MEMORY
    assert "Traceback" not in node.log_text()

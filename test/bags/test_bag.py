"""Bags round-trip, also through third-party readers, equal content gives equal bytes, and earlier bags are read."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rclpy.serialization import serialize_message
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability, QosHistory, QosReliability
from stages.bag_of_records import write_bag
from worlds.recorded_pane import write_bag as write

from fracture_collision import msg as messages
from fracture_collision.bag.exchanges import deserialize_record, read_runs, registry_settings, serialize_record
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import (
    SETTINGS,
    BagMessage,
    message_counts,
    read_messages,
    topic_digest,
    without_run_id,
)
from fracture_collision.bag.writer import BagWriter
from fracture_collision.records import SPHERE, CollisionBody, ContactConstraintArray, FragmentStates, SolidPrimitive
from fracture_collision.replay import InProcess, Replay, Report, settings_of
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.runs.scene_recording import TOPICS
from fracture_collision.ros.wire.conversion import heading, to_message
from fracture_collision.ros.wire.qos import STEP_DEPTH
from fracture_collision.world import CollisionWorld, Settings
from fracture_collision.world.settings import settings_text

RANDOM = np.random.default_rng(5)
STEP_NS = 2_500_000


def states(step: int) -> FragmentStates:
    ids = np.arange(3, dtype=np.uint32)
    return FragmentStates(step, 0, ids, np.full(9, 0.1 * step), np.tile([0.0, 0.0, 0.0, 1.0], 3))


def contacts(step: int) -> ContactConstraintArray:
    one, ids = np.full(1, 0.5), np.zeros(1, dtype=np.uint32)
    return ContactConstraintArray(
        step, 0, 0, ids, ids + 1, np.array([0, 1]), one, one, one, np.full(3, step), np.ones(3), np.ones(3), -one,
        np.array([2**64 - 1], dtype=np.uint64),
    )  # fmt: skip


def recording(steps: int = 40) -> list[BagMessage]:
    body = messages.CollisionBody(body_id=1, name="plate")
    result = [BagMessage("/bodies", 0, serialize_message(body))]
    for step in range(steps):
        for name, record in (("/fragment_states", states(step)), ("/contact_constraints", contacts(step))):
            data = serialize_message(to_message(record, heading(step * 0.0025), run_id=9))
            result.append(BagMessage(name, step * STEP_NS, data))
    return result


def shuffled_across_topics(content: list[BagMessage]) -> list[BagMessage]:
    """A possible DDS delivery: in order on each topic, a few messages early or late across topics."""
    keys = [i + RANDOM.uniform(0, 6) * (entry[0] == "/contact_constraints") for i, entry in enumerate(content)]
    latest: dict[str, float] = {}
    for i, (name, _, _) in enumerate(content):
        keys[i] = latest[name] = max(keys[i], latest.get(name, 0.0))
    order = sorted(range(len(content)), key=lambda i: (keys[i], i))
    assert order != sorted(order)
    return [content[i] for i in order]


def test_equal_content_gives_equal_bytes(tmp_path: Path) -> None:
    content = recording()
    one = write(tmp_path / "one" / "bag", content)
    other = write(tmp_path / "other" / "bag", shuffled_across_topics(content))
    files = sorted(path.name for path in one.iterdir())
    assert files == ["bag_0.mcap", "metadata.yaml"]
    for name in files:
        assert (one / name).read_bytes() == (other / name).read_bytes()


def test_messages_are_read_as_they_were_written(tmp_path: Path) -> None:
    content = recording(400)  # more than the sorting buffer holds
    bag = write(tmp_path / "bag", content)
    assert list(read_messages(bag)) == content
    counts = {"/bodies": 1, "/fracture_events": 0, "/fragment_states": 400, "/contact_constraints": 400}
    assert message_counts(bag) == counts
    with pytest.raises(FileExistsError):
        write(bag, [])


def test_digests_differ_by_stream_and_ignore_repeated_messages(tmp_path: Path) -> None:
    content = recording()
    repeated = content[:2] + content[1:]
    changed = [*content[:-1], content[-1]._replace(data=content[-3].data)]
    bags = [write(tmp_path / str(i), each) for i, each in enumerate((content, repeated, changed))]
    plain, twice, other = (topic_digest(bag, "/contact_constraints") for bag in bags)
    assert plain == twice != other
    plain, twice, other = (topic_digest(bag, "/fragment_states") for bag in bags)
    assert plain == twice == other
    assert message_counts(bags[1])["/fragment_states"] == 41


@pytest.mark.parametrize("frame", ["", "w", "world", "a frame"])
def test_digests_ignore_run_ids(frame: str, tmp_path: Path) -> None:
    """Also where the header's frame puts padding before the run id."""
    stamp = heading(0.5)._replace(frame_id=frame)
    answer = contacts(7)
    messages = [
        serialize_record(record, stamp, run_id)
        for record, run_id in ((answer, 9), (answer, 2**62 - 1), (answer._replace(step=8), 9))
    ]
    bags = [
        write(tmp_path / str(i), [BagMessage("/contact_constraints", STEP_NS, data)]) for i, data in enumerate(messages)
    ]
    one, same, other = (topic_digest(bag, "/contact_constraints") for bag in bags)
    assert one == same != other
    assert without_run_id(messages[0]) == without_run_id(messages[1]) != messages[1]


def test_rosbags_reads_it(tmp_path: Path) -> None:
    bag, topics = write(tmp_path / "bag", recording()), [bag_topic(f"/{topic.name}", topic) for topic in TOPICS]
    with AnyReader([bag]) as reader:
        assert (reader.message_count, reader.start_time) == (81, 0)
        assert reader.duration == 39 * STEP_NS + 1  # rosbags counts to the end of the last nanosecond
        by_name = {connection.topic: connection for connection in reader.connections}
        assert {name: c.msgtype for name, c in by_name.items()} == {t.name: t.message_type for t in topics}
        assert all(by_name[t.name].digest == t.type_hash for t in topics)
        latched, each_step = (by_name[name].ext.offered_qos_profiles[0] for name in ("/bodies", "/fragment_states"))
        assert (latched.history, latched.durability) == (QosHistory.KEEP_ALL, QosDurability.TRANSIENT_LOCAL)
        assert (each_step.history, each_step.depth) == (QosHistory.KEEP_LAST, STEP_DEPTH)
        assert each_step.reliability == QosReliability.RELIABLE
        for step, (connection, time, data) in enumerate(reader.messages([by_name["/contact_constraints"]])):
            message = reader.deserialize(data, connection.msgtype)
            assert (message.step, message.run_id, time) == (step, 9, step * STEP_NS)
            assert message.contact_ids.tolist() == [2**64 - 1] and message.gaps.tolist() == [-0.5]
            assert message.points_a.tolist() == [step] * 3
        assert step == 39


def test_mcap_tools_read_it_without_ros(tmp_path: Path) -> None:
    bag = write(tmp_path / "bag", recording())
    with (bag / "bag_0.mcap").open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        decoded = [message for _, _, _, message in reader.iter_decoded_messages(["/fragment_states"])]
    assert [message.step for message in decoded] == list(range(40))
    assert list(decoded[3].positions) == states(3).positions.tolist()


def test_bags_recorded_before_a_field_existed_are_read_with_its_default(tmp_path: Path) -> None:
    body = CollisionBody(7, 7, primitive=SolidPrimitive(SPHERE, (0.5,)), is_static=True, friction=0.25)
    states = FragmentStates(3, 0, np.array([7], np.uint32), np.arange(3.0), np.array([0.0, 0.0, 0.0, 1.0]))
    write_bag(tmp_path / "old", [(0.5, body), (1.0, states)], lacking=frozenset({"sequence", "body_sequence"}))
    write_bag(tmp_path / "new", [(0.5, body), (1.0, states)])
    (old,), (new,) = read_runs(tmp_path / "old"), read_runs(tmp_path / "new")
    assert [message.received.record.friction for message in old.bodies] == [0.25]
    assert old.bodies[0].received.record.sequence == 0
    assert [(q.states, q.time) for q in old.questions] == [(q.states, q.time) for q in new.questions]
    assert deserialize_record(old.questions[0].states, FragmentStates).record.body_sequence == 0
    write_bag(tmp_path / "other", [(0.5, body), (1.0, states)], lacking=frozenset({"positions"}))
    with pytest.raises(BagError, match="another definition of FragmentStates: positions"):
        read_runs(tmp_path / "other")


def test_settings_of_another_version_are_named_and_ignored(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "old", []) as bag:
        bag.note(SETTINGS, json.dumps({"contacts_per_pair": 5, "surfaces": "sampled", "visit_budget": 9}))
    found = settings_of(tmp_path / "old", {})
    assert found.settings == Settings(contacts_per_pair=5)
    (words,) = found.words
    assert words == "the bag has settings of another version, which the replay ignores: 'surfaces', 'visit_budget'"


BALL = CollisionBody(7, 7, primitive=SolidPrimitive(SPHERE, (0.5,)))
BALLS = (BALL._replace(is_static=True), BALL._replace(body_id=8, fragment_id=8))
# The second ball falls, 4 cm above the first: a contact comes within the lookahead.
FALLING = FragmentStates(
    3, 0, np.array([8], np.uint32), np.array([0.0, 0.0, 1.04]), np.array([0.0, 0.0, 0.0, 1.0]),
    np.array([0.0, 0.0, -9.0]),
)  # fmt: skip
AHEAD = Settings(threads=1, lookahead=0.01)


def write_answered(folder: Path, lacking: frozenset[str], changed: bool = False) -> None:
    """A bag of a world with AHEAD; `changed`: the answer is another one."""
    world = CollisionWorld(AHEAD)
    for body in BALLS:
        world.add_body(body)
    answer = world.contacts(FALLING)
    assert len(answer) == 1 and answer.lookahead == 0.01
    if changed:
        answer = answer._replace(gaps=answer.gaps + 1.0)
    write_bag(folder, [(0.5, each) for each in (*BALLS, FALLING, world.fragments(), answer)], lacking=lacking)


def replayed(bag: Path) -> Report:
    replay = Replay(read_runs(bag), InProcess(AHEAD))
    assert list(replay) == [1]
    return replay.report()


def test_answers_recorded_before_they_had_a_lookahead_are_compared_without_it(tmp_path: Path) -> None:
    write_answered(tmp_path / "new", frozenset())
    write_answered(tmp_path / "old", frozenset({"lookahead"}))
    old, new = replayed(tmp_path / "old"), replayed(tmp_path / "new")
    assert old.exact and old.compared == 1 and new.exact and old.digest == old.recorded_digest != new.digest
    recorded = [message.data for message in read_messages(tmp_path / "old", ["/contact_constraints"])]
    (run,) = read_runs(tmp_path / "old")
    (answer,) = run.questions[0].answers
    assert run.as_recorded(answer) == recorded[0] and len(answer) == len(recorded[0]) + 8
    assert deserialize_record(answer, ContactConstraintArray).record.lookahead == 0.0
    write_answered(tmp_path / "changed", frozenset({"lookahead"}), changed=True)
    found = replayed(tmp_path / "changed")
    assert found.differing == 1 and found.difference.field == "gaps"


def test_registries_recorded_before_they_had_settings_name_none(tmp_path: Path) -> None:
    write_answered(tmp_path / "new", frozenset())
    write_answered(tmp_path / "old", frozenset({"settings"}))
    assert registry_settings(tmp_path / "old") == []
    assert registry_settings(tmp_path / "new") == [json.loads(settings_text(AHEAD))]
    lacking = "the bag lacks the settings of the service; the replay uses the defaults"
    assert settings_of(tmp_path / "old", {"contacts_per_pair": 5}) == (Settings(contacts_per_pair=5), [lacking])

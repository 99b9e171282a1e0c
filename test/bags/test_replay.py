"""Replay of recorded runs, the golden bags among them: one digest for any order, rate and thread count; differences."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from worlds.recorded_pane import CLASSES, STEPS, changed_bag, record_pane, replayed, write_bag

from fracture_collision.bag.exchanges import Run, deserialize_record, read_runs, serialize_record
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import SETTINGS, BagMessage, missing_words, read_messages
from fracture_collision.bag.writer import BagWriter
from fracture_collision.records import INVALID_STATES, REMOVE, CollisionBody, ContactConstraintArray, SolidPrimitive
from fracture_collision.replay import AS_RECORDED, Order, settings_of
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.runs.scene_recording import TOPICS
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.conversion import heading
from fracture_collision.simulation.scene.scene import scene_files
from fracture_collision.world import CollisionWorld, PaperSettings, Settings
from fracture_collision.world.settings import settings_text, values_of

STATES, CONTACTS, BODIES, EVENTS = "/fragment_states", "/contact_constraints", "/bodies", "/fracture_events"


@pytest.fixture(scope="module")
def bag(recorded: Path) -> Path:
    return recorded


@pytest.fixture(scope="module")
def runs(bag: Path) -> list[Run]:
    return read_runs(bag)


@pytest.fixture(scope="module")
def digest(runs: list[Run]) -> str:
    report = replayed(runs)
    assert report.exact and report.digest == report.recorded_digest
    assert (report.steps, report.answers, report.unrecorded) == (STEPS, STEPS, 0)
    return report.digest


# --- the same digest ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("threads", [1, 2, 8])
@pytest.mark.parametrize(
    "order",
    [AS_RECORDED, Order(loops=2), Order(backwards=True), Order(backwards=True, loops=3)],
    ids=["plain", "twice", "backwards", "backwards and looped"],
)
def test_digests_do_not_depend_on_order_or_threads(
    runs: list[Run], digest: str, order: Order, threads: int
) -> None:
    report = replayed(runs, order, threads=threads)
    assert report.exact and report.digest == digest
    assert report.answers == STEPS * order.loops


def test_a_replay_may_start_in_the_middle(runs: list[Run], digest: str) -> None:
    """In a service that never received the first half; the digest differs, as it covers the second half only."""
    forwards = replayed(runs, Order(first=STEPS // 2))
    backwards = replayed(runs, Order(first=STEPS // 2, backwards=True), threads=2)
    assert forwards.exact and forwards.steps == STEPS - STEPS // 2
    assert forwards.digest == backwards.digest == forwards.recorded_digest != digest
    some = replayed(runs, Order(first=7, end=9))
    assert some.exact and some.steps == 2


def test_a_replay_takes_the_time_of_the_recording(
    runs: list[Run], digest: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a clock that only sleep advances."""
    now = [100.0]
    monkeypatch.setattr("fracture_collision.replay.time.monotonic", lambda: now[0])
    monkeypatch.setattr("fracture_collision.replay.time.sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    recorded = 1e-9 * (runs[0].questions[-1].time - runs[0].questions[0].time)
    for rate, order in ((0.5, AS_RECORDED), (4.0, Order(backwards=True)), (1.0, Order(loops=3))):
        began = now[0]
        assert replayed(runs, order, rate).digest == digest
        assert now[0] - began == pytest.approx(order.loops * recorded / rate, rel=1e-9)


# --- not as recorded ------------------------------------------------------------------------------------------------


def test_a_flipped_byte_is_found_and_located(bag: Path, tmp_path: Path, digest: str) -> None:
    """In each array field of a step's answer in turn."""
    answers = {m.nanoseconds: m for m in read_messages(bag, [CONTACTS])}
    time, message = list(answers.items())[20]
    heading_, run_id, contacts = deserialize_record(message.data, CLASSES[CONTACTS])
    arrays = {name: value for name, value in contacts._asdict().items() if isinstance(value, np.ndarray)}
    assert len(arrays) == 11
    for name, array in arrays.items():
        index = array.size // 2  # in the flat array of the message
        flipped, array = array.reshape(-1).copy(), array.reshape(-1)
        flipped.view(np.uint8)[index * array.itemsize] ^= 1
        data = serialize_record(contacts._replace(**{name: flipped}), heading_, run_id)
        assert sum(a != b for a, b in zip(data, message.data, strict=True)) == 1

        def change(each: BagMessage, data: bytes = data) -> list[BagMessage]:
            return [each._replace(data=data) if (each.topic, each.nanoseconds) == (CONTACTS, time) else each]

        report = replayed(read_runs(changed_bag(tmp_path / name, bag, change)))
        found = report.difference
        assert not report.exact and report.differing == 1 and report.digest == digest != report.recorded_digest
        assert (found.run_id, found.step, found.field, found.entry) == (run_id, 20, name, index)
        assert (found.recorded, found.answered) == (repr(flipped[index].item()), repr(array[index].item()))
        if name in ("points_a", "points_b", "normals", "gaps", "contact_ids"):
            contact = index // (3 if len(array) == 3 * len(contacts.gaps) else 1)
            pair = int(np.flatnonzero(contacts.pair_begin <= contact)[-1])
            assert found.pair == (contacts.fragment_a[pair], contacts.fragment_b[pair])
            assert f"step 20, pair {found.pair[0]}-{found.pair[1]}, {name}[{index}]: recorded" in found.words()


def test_differing_lengths_numbers_and_headings_are_named(bag: Path, tmp_path: Path) -> None:
    (_, first, second) = list(read_messages(bag, [CONTACTS]))[18:21]
    for name, change, words in (
        ("lengths", lambda h, c: (h, c._replace(gaps=c.gaps[:-1])), "gaps: recorded"),
        ("numbers", lambda h, c: (h, c._replace(status=1)), "status: recorded 1, answered 0"),
        ("headings", lambda h, c: (h._replace(frame_id="map"), c), "heading: recorded Heading"),
    ):

        def changed(each: BagMessage, change=change) -> list[BagMessage]:
            if each not in (first, second):
                return [each]
            stamp, run_id, contacts = deserialize_record(each.data, CLASSES[CONTACTS])
            stamp, contacts = change(stamp, contacts)
            return [each._replace(data=serialize_record(contacts, stamp, run_id))]

        report = replayed(read_runs(changed_bag(tmp_path / name, bag, changed)))
        assert report.differing == 2 and report.difference.step == 19
        assert words in report.difference.words()


def test_padding_bytes_do_not_count_as_differences(bag: Path, tmp_path: Path, digest: str) -> None:
    """Padding bytes, which some recorders do not clear."""

    def noisy(each: BagMessage) -> list[BagMessage]:
        if each.topic != CONTACTS:
            return [each]
        data = bytearray(each.data + b"\x01\x02\x03")
        assert data[4 + 18 : 4 + 24] == bytes(6)  # between "world" and run_id
        data[4 + 18 : 4 + 24] = b"noises"
        return [each._replace(data=bytes(data))]

    report = replayed(read_runs(changed_bag(tmp_path / "noisy", bag, noisy)))
    assert report.exact and report.recorded_digest == digest


# --- recordings as they occur --------------------------------------------------------------------------------------


def test_messages_delivered_again_count_once(bag: Path, tmp_path: Path, digest: str) -> None:
    report = replayed(read_runs(changed_bag(tmp_path / "again", bag, lambda message: [message] * 3)))
    assert report.exact and (report.steps, report.digest) == (STEPS, digest)


def test_one_step_with_different_states_is_rejected_with_an_explanation(bag: Path, tmp_path: Path) -> None:
    states = list(read_messages(bag, [STATES]))[3]
    stamp, run_id, record = deserialize_record(states.data, CLASSES[STATES])
    other = states._replace(data=serialize_record(record._replace(positions=record.positions + 1.0), stamp, run_id))
    with pytest.raises(BagError, match="step 3 was queried twice"):
        read_runs(changed_bag(tmp_path / "two", bag, lambda m: [m, other] if m == states else [m]))


def test_two_runs_in_one_bag_are_replayed(bag: Path, tmp_path: Path, digest: str) -> None:
    """In sequence, and interleaved as no simulator would: runs are independent."""
    other = record_pane(tmp_path / "other", seed=5)
    one, two = list(read_messages(bag)), list(read_messages(other))
    after = [m._replace(nanoseconds=m.nanoseconds + one[-1].nanoseconds + 1) for m in two]
    reports = []
    for name, messages in (("after", one + after), ("mixed", sorted(one + two, key=lambda m: m.nanoseconds))):
        runs = read_runs(write_bag(tmp_path / name, messages))
        assert len(runs) == 2 and runs[0].run_id != runs[1].run_id
        reports += [replayed(runs), replayed(runs, Order(backwards=True, loops=2), threads=2)]
    assert all(report.exact and report.steps == 2 * STEPS for report in reports)
    assert len({report.digest for report in reports}) == 1 and reports[0].digest != digest


def test_a_bag_of_several_services_needs_a_namespace(bag: Path, tmp_path: Path, digest: str) -> None:
    messages = [m._replace(topic=space + m.topic) for m in read_messages(bag) for space in ("/left", "/right/arm")]
    both = write_bag(tmp_path / "both", messages, ("/left", "/right/arm"))
    with pytest.raises(BagError, match="/left, /right/arm; choose one with --namespace"):
        read_runs(both)
    for namespace in ("left", "/right/arm/"):
        assert replayed(read_runs(both, namespace)).recorded_digest == digest


def test_bodies_and_events_recorded_after_their_states_are_used(bag: Path, tmp_path: Path, digest: str) -> None:
    """Recorders do not preserve order across topics."""
    late = [m._replace(nanoseconds=m.nanoseconds + 4 * 2_500_000) if m.topic in (BODIES, EVENTS) else m
            for m in read_messages(bag)]  # fmt: skip
    runs = read_runs(write_bag(tmp_path / "late", late))
    assert runs[0].questions[0].bodies_before == 0
    report = replayed(runs)
    assert report.exact and report.digest == digest


def test_added_and_removed_bodies_are_replayed(tmp_path: Path) -> None:
    """A static block exists for a while; although states do not list it, it takes part in the answers of that time."""
    block = CollisionBody(1, 1, primitive=SolidPrimitive(1, (1.0, 1.0, 0.2)), is_static=True)
    ball = CollisionBody(2, 2, primitive=SolidPrimitive(2, (0.1,)))
    orders = {0: [ball], 3: [block], 6: [block._replace(operation=REMOVE)]}
    world, messages, contacts = CollisionWorld(Settings(threads=1)), [], []
    for step in range(9):
        stamp = heading(0.01 * step)
        for body in orders.get(step, []):
            world.add_body(body)
            messages.append(BagMessage(BODIES, step, serialize_record(body, stamp, 7)))
        states = CLASSES[STATES](step, 0, np.array([2], np.uint32), np.array([0.0, 0.0, 0.199]),
                                 np.array([0.0, 0.0, 0.0, 1.0]))  # fmt: skip
        answer = world.contacts(states)
        contacts.append(len(answer.gaps))
        messages.append(BagMessage(STATES, step, serialize_record(states, stamp, 7)))
        messages.append(BagMessage(CONTACTS, step, serialize_record(answer, stamp, 7)))
    assert [count > 0 for count in contacts] == [False] * 3 + [True] * 3 + [False] * 3
    runs = read_runs(write_bag(tmp_path / "bag", messages))
    digests = set()
    for order in (AS_RECORDED, Order(backwards=True), Order(loops=3), Order(backwards=True, loops=2)):
        report = replayed(runs, order)
        assert report.exact, report.difference
        digests.add(report.digest)
    assert len(digests) == 1
    assert replayed(runs, Order(first=4)).exact


def test_rejected_states_are_rejected_again(bag: Path, tmp_path: Path) -> None:
    def broken(each: BagMessage) -> list[BagMessage]:
        stamp, run_id, record = deserialize_record(each.data, CLASSES[each.topic])
        if each.topic == STATES and record.step == 4:
            nowhere = record._replace(positions=np.full_like(record.positions, np.nan))
            return [each._replace(data=serialize_record(nowhere, stamp, run_id))]
        if each.topic == CONTACTS and record.step == 4:
            empty = {name: value[:0] for name, value in record._asdict().items() if isinstance(value, np.ndarray)}
            refused = record._replace(**{**empty, "pair_begin": np.zeros(1, np.uint32), "status": INVALID_STATES})
            return [each._replace(data=serialize_record(refused, stamp, run_id))]
        return [each]

    assert replayed(read_runs(changed_bag(tmp_path / "broken", bag, broken))).exact


# --- settings -------------------------------------------------------------------------------------------------------


def test_settings_are_read_from_the_bag(tmp_path: Path) -> None:
    settings = Settings("glondu2014", 3, max_work=3000, paper=PaperSettings(tree="plain"))
    bag = record_pane(tmp_path / "bag", settings)
    runs = read_runs(bag)
    assert not replayed(runs).exact
    for path in (bag, bag / "bag_0.mcap"):
        found = settings_of(path, {"threads": 2})
        assert found == (settings._replace(threads=2), [])
        assert replayed(runs, **found.settings._asdict()).exact
    assert settings_of(bag, {"contacts_per_pair": 5}).settings.contacts_per_pair == 5


def with_registries(folder: Path, bag: Path, *texts: str) -> Path:
    """The bag with registries that have these `settings`, and no custom data: as `ros2 bag record` leaves it."""
    topics = [bag_topic(f"/{topic.name}", topic) for topic in (*TOPICS, qos.FRAGMENTS)]
    registry = CollisionWorld(Settings(threads=1)).fragments()
    with BagWriter(folder, topics) as writer:
        for at, text in enumerate(texts):
            data = serialize_record(registry._replace(settings=text), heading(0.0), 7)
            writer.write("/fragments", data, at)
        for message in read_messages(bag):
            writer.write(message.topic, message.data, len(texts) + message.nanoseconds)
    return folder


def test_settings_are_read_from_registries(tmp_path: Path) -> None:
    settings = Settings("glondu2014", contacts_per_pair=3, max_pairs=9)
    recorded = record_pane(tmp_path / "recorded", settings._replace(max_pairs=Settings().max_pairs))
    bag = with_registries(tmp_path / "bag", recorded, "", *[settings_text(settings)] * 2)
    found, words = settings_of(bag, {"threads": 1})
    assert found == settings._replace(threads=1, max_pairs=Settings().max_pairs)
    assert words == ["the bag has the settings that contacts depend on; the replay uses the defaults of all others"]
    assert replayed(read_runs(bag), **found._asdict()).exact and not replayed(read_runs(bag)).exact


def test_settings_other_than_those_of_the_recorded_answers_are_named(tmp_path: Path) -> None:
    bag = record_pane(tmp_path / "noted", Settings(contacts_per_pair=3))
    other = "the replay uses other settings than the recorded answers: "
    assert settings_of(bag, {"contacts_per_pair": 3, "threads": 2, "max_bodies": 9}).words == []
    assert settings_of(bag, {"contacts_per_pair": 5, "lookahead": 0.01}).words == [
        f"{other}contacts_per_pair: 5, recorded 3; lookahead: 0.01, recorded 0.0"
    ]
    first, last = Settings(contacts_per_pair=4), Settings(max_work=7)
    told = with_registries(tmp_path / "told", bag, settings_text(first), settings_text(last))
    found = settings_of(told, {"max_work": 9})
    assert found.settings.contacts_per_pair == 8 and found.words[1:] == [
        "the settings changed during the recording; the replay uses the last ones",
        f"{other}max_work: 9, recorded 7",
    ]
    with BagWriter(tmp_path / "both", []) as writer:
        writer.note(SETTINGS, json.dumps(values_of(Settings(contacts_per_pair=6))))
    (tmp_path / "both" / "metadata.yaml").unlink()
    shutil.copy(next((tmp_path / "told").glob("*.mcap")), tmp_path / "both" / "both_1.mcap")
    assert settings_of(tmp_path / "both", {}).words[-1] == (
        f"{other}contacts_per_pair: 6, recorded 8; max_work: 2000000, recorded 7"
    )


@pytest.mark.parametrize("text", ["contacts_per_pair: 8", "[8]", '{"contacts_per_pair": "many"}'])
def test_registries_with_unreadable_settings_are_rejected_with_an_explanation(
    bag: Path, text: str, tmp_path: Path
) -> None:
    with pytest.raises(BagError, match="setting"):
        settings_of(with_registries(tmp_path / "bag", bag, text), {})


# --- golden bags ----------------------------------------------------------------------------------------------------

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

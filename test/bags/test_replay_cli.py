"""The bag commands as typed: exit status and messages."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from stages.typed_command import begun, call
from worlds.recorded_pane import CLASSES, STEPS, changed_bag, record_pane, write_bag

from fracture_collision.bag.exchanges import deserialize_record, serialize_record
from fracture_collision.bag.reader import BagMessage, read_messages
from fracture_collision.bag.writer import BagWriter
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.runs.scene_recording import TOPICS
from fracture_collision.world import Settings

CONTACTS = "/contact_constraints"


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_pane(tmp_path_factory.mktemp("recorded") / "pane", Settings(contacts_per_pair=6))


def test_a_bag_is_replayed_with_its_settings(bag: Path) -> None:
    done = call("replay", bag)
    assert done.status == 0 and f"all {STEPS} answers equal the recorded ones, byte for byte" in done.output
    assert "note:" not in done.output and "ms median, " in done.output
    digest = next(line for line in done.output.splitlines() if line.endswith(f"{STEPS} steps") and len(line) > 64)
    other = call("replay", bag / "pane_0.mcap", "--threads", 8, "--backwards", "--loop", 2)
    assert other.status == 0 and digest in other.output
    some = call("replay", bag, "--steps", "10:", "--rate", 2)
    assert some.status == 0 and f"all {STEPS - 10} answers" in some.output


def test_differing_answers_give_status_1_and_are_named(bag: Path, tmp_path: Path) -> None:
    done = call("replay", bag, "--settings", "contacts_per_pair=4")
    assert done.status == 1 and "differ from the recorded ones; the first: step" in done.text
    note = "note: the replay uses other settings than the recorded answers: contacts_per_pair: 4, recorded 6"
    assert note in done.output
    last = list(read_messages(bag, [CONTACTS]))[-1]
    stamp, run_id, contacts = deserialize_record(last.data, CLASSES[CONTACTS])
    changed = last._replace(data=serialize_record(contacts._replace(gaps=contacts.gaps * 2.0), stamp, run_id))
    twice = changed_bag(tmp_path / "twice", bag, lambda m: [m, changed] if m == last else [m])
    done = call("replay", twice, "--settings", "contacts_per_pair=6")
    assert done.status == 1 and f"1 step was answered in two ways in the bag, first step {STEPS - 1}" in done.text
    assert "the bag lacks the settings of the service" in done.text


def test_a_step_that_cannot_be_answered_gives_status_4(bag: Path, tmp_path: Path) -> None:
    """Not that of answers that differ."""
    lacking = changed_bag(tmp_path / "lacking", bag, lambda m: [] if m.topic == "/bodies" else [m])
    done = call("replay", lacking)
    assert done.status == 4 and "step 0: body_sequence: 3, but body message 1 has not arrived" in done.text
    assert "the bag lacks bodies or fracture events of its run; record it from its first step" in done.text


ROSBAGS = Path(sys.executable).with_name("rosbags-convert")


@pytest.mark.parametrize(
    ("storage", "words"),
    [
        (("--dst-storage", "sqlite3"), "an SQLite file"),
        (("--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "file"), "a compressed file"),
        pytest.param(
            ("--dst-storage", "mcap", "--compress", "zstd", "--compress-mode", "message"), "compressed messages",
            marks=pytest.mark.slow,
        ),
    ],
)  # fmt: skip
def test_bags_of_other_storage_are_rejected_with_a_command_that_converts_them(
    storage: tuple[str, ...], words: str, bag: Path, tmp_path: Path
) -> None:
    subprocess.run([ROSBAGS, "--src", bag, "--dst", tmp_path / "other", *storage], check=True)
    before = {file: file.read_bytes() for file in (tmp_path / "other").iterdir()}
    for name in ("replay", "digest", "mend", "view"):
        done = call(name, tmp_path / "other")
        assert done.status == 2 and words in done.text and "convert the bag: " in done.text, name
    assert {file: file.read_bytes() for file in (tmp_path / "other").iterdir()} == before
    given = re.findall("`rosbags-convert (.*?)`", done.text)[-1]
    given = given.replace("BAG", str(tmp_path / "other")).replace("NEW", str(tmp_path / "converted"))
    subprocess.run([ROSBAGS, *given.split()], check=True)
    assert list(read_messages(tmp_path / "converted")) == list(read_messages(bag))


def test_what_cannot_be_replayed_gives_status_2(tmp_path: Path, bag: Path) -> None:
    (tmp_path / "empty").mkdir()
    states = write_bag(tmp_path / "nothing", [m for m in read_messages(bag) if m.topic == "/bodies"])
    for words, said in (
        ((tmp_path / "empty",), "neither an .mcap file nor a folder"),
        ((Path(__file__),), "not an MCAP file"),
        ((states,), "holds no"),
        ((tmp_path / "nowhere",), "does not exist"),
        ((bag, "--steps", "30:40"), "steps 0 to 29"),
        ((bag, "--steps", "5"), "pass A:B"),
        ((bag, "--steps", "-1:4"), "pass A:B"),
        ((bag, "--rate", "0"), "--rate"),
        ((bag, "--loop", "0"), "--loop"),
        ((bag, "--settings", "speed=3"), "no setting 'speed'; `fracture-collision settings` lists all"),
        ((bag, "--settings", "contacts_per_pair=0"), "contacts_per_pair"),
    ):
        done = call("replay", *words)
        assert done.status == 2 and said in done.text, words


def test_an_interrupted_replay_reports_the_steps_done(bag: Path, tmp_path: Path) -> None:
    with begun(tmp_path, "replay", bag, "--rate", "1e-6") as process:  # one step in forty minutes
        process.until(lambda: "1/30" in process.text)
        process.stop(signal.SIGTERM)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", process.text)
    assert "stopped after 1 of 30 steps" in text and "all 1 answers equal the recorded ones" in text


def test_a_recorded_bag_is_mended(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    done = call("record", "pane", "--out", out, "--steps", 21, "--every", 5, "--seed", 3, "--curvature", 0.25,
                "--settings", "contacts_per_pair=5")  # fmt: skip
    assert done.status == 0
    times = [m.nanoseconds for m in read_messages(out, [CONTACTS])]
    assert times == [step * 2_500_000 for step in range(0, 21, 5)]
    again = call("record", "pane", "--out", out)
    assert again.status == 2 and "exists already" in again.text
    file = out / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    (out / "metadata.yaml").unlink()
    before = call("replay", out)
    assert before.status == 0 and "has no metadata.yaml" in before.text
    done = call("mend", out)
    assert done.status == 0 and "messages" in done.output
    after = call("replay", out)
    assert after.status == 0 and "note:" not in after.output


def test_a_recording_that_cannot_begin_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object) -> None:
        raise ValueError("no run")

    monkeypatch.setattr("fracture_collision.ros.runs.scene_recording.Lockstep", failing)
    with pytest.raises(ValueError, match="no run"):
        record_pane(tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_digest_takes_a_file_and_a_folder(bag: Path) -> None:
    one, other = call("digest", bag), call("digest", bag / "pane_0.mcap")
    assert one.status == other.status == 0 and one.output == other.output
    assert f"{STEPS:6}  {CONTACTS}" in one.output


def renamed(bag: Path, folder: Path) -> Path:
    """Its answers have another type."""
    topics = [bag_topic(f"/{topic.name}", topic) for topic in TOPICS]
    topics = [t if t.name != CONTACTS else t._replace(message_type="other/msg/Contacts") for t in topics]
    with BagWriter(folder, topics) as writer:
        for message in read_messages(bag):
            writer.write(message.topic, message.data, message.nanoseconds)
    return folder


def without(topic: str, *steps: int) -> Callable[[Path, Path], Path]:
    def made(bag: Path, folder: Path) -> Path:
        lost = [list(read_messages(bag, [topic]))[step] for step in steps]

        def kept(message: BagMessage) -> Iterable[BagMessage]:
            return [message] if message not in lost else []

        return changed_bag(folder, bag, kept)

    return made


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (
            without(CONTACTS, *range(STEPS)),
            (f"no answer to {STEPS} of these steps", "has no answer to any of these steps"),
        ),
        (renamed, ("has no topic of type fracture_collision/msg/ContactConstraintArray",
                   f"{CONTACTS} (other/msg/Contacts)")),
        (
            without(CONTACTS, 12, STEPS - 1),
            (f"all {STEPS - 2} answers equal the recorded ones", "no answer to 2 of these"),
        ),
        (without("/fragment_states", 12, STEPS - 1),
         (f"all {STEPS - 2} answers equal the recorded ones", "answers, but no states, of 2 steps, first step 12")),
    ],
    ids=["no answers", "answers of another type", "two answers are missing", "two states are missing"],
)  # fmt: skip
def test_a_replay_that_cannot_compare_all_fails(
    change: Callable[[Path, Path], Path], words: tuple[str, str], bag: Path, tmp_path: Path
) -> None:
    spoilt = change(bag, tmp_path / "spoilt")
    done = call("replay", spoilt, "--settings", "contacts_per_pair=6")
    assert done.status == 3 and all(each in done.text for each in words), done.text
    if "recorded ones" in words[0]:
        assert call("replay", spoilt, "--settings", "contacts_per_pair=6", "--steps", "13:29").status == 0

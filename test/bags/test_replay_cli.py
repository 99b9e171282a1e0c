"""The bag commands as typed: exit status and messages."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from stages import typed_command
from stages.typed_command import begun
from worlds.recorded_pane import CLASSES, STEPS, changed_bag, record_pane, write_bag

from fracture_collision.bag.exchanges import deserialize_record, serialize_record
from fracture_collision.bag.reader import BagMessage, read_messages
from fracture_collision.bag.writer import BagWriter
from fracture_collision.ros.nodes.recorder_node import bag_topic
from fracture_collision.ros.runs.scene_recording import TOPICS
from fracture_collision.world import Settings

CONTACTS = "/contact_constraints"


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    done = typed_command.run(*words)
    assert "Traceback" not in done.stderr + done.stdout
    return done


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_pane(tmp_path_factory.mktemp("recorded") / "pane", Settings(contacts_per_pair=6))


def test_a_bag_is_replayed_with_its_settings(bag: Path) -> None:
    done = run("replay", bag)
    assert done.returncode == 0 and f"all {STEPS} answers equal the recorded ones, byte for byte" in done.stdout
    assert "note:" not in done.stdout and "ms median, " in done.stdout
    digest = next(line for line in done.stdout.splitlines() if line.endswith(f"{STEPS} steps") and len(line) > 64)
    other = run("replay", bag / "pane_0.mcap", "--threads", "8", "--backwards", "--loop", "2")
    assert other.returncode == 0 and digest in other.stdout
    some = run("replay", bag, "--steps", "10:", "--rate", "2")
    assert some.returncode == 0 and f"all {STEPS - 10} answers" in some.stdout


def test_differing_answers_give_status_1_and_are_named(bag: Path, tmp_path: Path) -> None:
    done = run("replay", bag, "--settings", "contacts_per_pair=4")
    assert done.returncode == 1 and "differ from the recorded ones; the first: step" in done.stdout
    note = "note: the replay uses other settings than the recorded answers: contacts_per_pair: 4, recorded 6"
    assert note in done.stdout
    last = list(read_messages(bag, [CONTACTS]))[-1]
    stamp, run_id, contacts = deserialize_record(last.data, CLASSES[CONTACTS])
    changed = last._replace(data=serialize_record(contacts._replace(gaps=contacts.gaps * 2.0), stamp, run_id))
    twice = changed_bag(tmp_path / "twice", bag, lambda m: [m, changed] if m == last else [m])
    done = run("replay", twice, "--settings", "contacts_per_pair=6")
    assert done.returncode == 1 and f"1 step was answered in two ways in the bag, first step {STEPS - 1}" in done.stdout
    assert "the bag lacks the settings of the service" in done.stdout


def test_a_step_that_cannot_be_answered_gives_status_4(bag: Path, tmp_path: Path) -> None:
    """Not that of answers that differ."""
    lacking = changed_bag(tmp_path / "lacking", bag, lambda m: [] if m.topic == "/bodies" else [m])
    done = run("replay", lacking)
    assert done.returncode == 4 and "step 0: body_sequence: 3, but body message 1 has not arrived" in done.stderr
    assert "the bag lacks bodies or fracture events of its run; record it from its first step" in done.stderr


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
        done = run(name, tmp_path / "other")
        assert done.returncode == 2 and words in done.stderr and "convert the bag: " in done.stderr, name
    assert {file: file.read_bytes() for file in (tmp_path / "other").iterdir()} == before
    given = re.findall("`rosbags-convert (.*?)`", " ".join(done.stderr.split()))[-1]
    given = given.replace("BAG", str(tmp_path / "other")).replace("NEW", str(tmp_path / "converted"))
    subprocess.run([ROSBAGS, *given.split()], check=True)
    assert list(read_messages(tmp_path / "converted")) == list(read_messages(bag))


def test_a_missing_bag_gives_status_2(tmp_path: Path, bag: Path) -> None:
    (tmp_path / "empty").mkdir()
    states = write_bag(tmp_path / "nothing", [m for m in read_messages(bag) if m.topic == "/bodies"])
    for path, words in (
        (tmp_path / "empty", "neither an .mcap file nor a folder"), (Path(__file__), "not an MCAP file"),
        (states, "holds no"), (tmp_path / "nowhere", "does not exist"),
    ):  # fmt: skip
        done = run("replay", path)
        assert done.returncode == 2 and words in " ".join(done.stderr.split())
    done = run("replay", bag, "--steps", "30:40")
    assert done.returncode == 2 and "steps 0 to 29" in done.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--steps", "5"), "pass A:B"),
        (("--steps", "-1:4"), "pass A:B"),
        (("--rate", "0"), "--rate"),
        (("--loop", "0"), "--loop"),
        (("--settings", "speed=3"), "no setting 'speed'; `fracture-collision settings` lists all"),
        (("--settings", "contacts_per_pair=0"), "contacts_per_pair"),
    ],
)
def test_invalid_options_are_rejected(bag: Path, words: tuple[str, ...], said: str) -> None:
    done = run("replay", bag, *words)
    assert done.returncode in (1, 2) and said in done.stderr


@pytest.mark.parametrize("order", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_replay_reports_the_steps_done(bag: Path, tmp_path: Path, order: signal.Signals) -> None:
    with begun(tmp_path, "replay", bag, "--rate", "1e-6") as process:  # one step in forty minutes
        process.until(lambda: "1/30" in process.text)
        process.stop(order)
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", process.text)
    assert "stopped after 1 of 30 steps" in text and "all 1 answers equal the recorded ones" in text


@pytest.mark.slow
def test_a_recorded_bag_is_mended(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    done = run("record", "pane", "--out", out, "--steps", "21", "--every", "5", "--seed", "3", "--curvature", "0.25",
               "--settings", "contacts_per_pair=5")  # fmt: skip
    assert done.returncode == 0
    times = [m.nanoseconds for m in read_messages(out, [CONTACTS])]
    assert times == [step * 2_500_000 for step in range(0, 21, 5)]
    again = run("record", "pane", "--out", out)
    assert again.returncode == 2 and "exists already" in again.stderr
    file = out / "bag_0.mcap"
    file.write_bytes(file.read_bytes()[:-3000])
    (out / "metadata.yaml").unlink()
    before = run("replay", out)
    assert before.returncode == 0 and "has no metadata.yaml" in before.stdout
    done = run("mend", out)
    assert done.returncode == 0 and "messages" in done.stdout
    after = run("replay", out)
    assert after.returncode == 0 and "note:" not in after.stdout


def test_a_recording_that_cannot_begin_leaves_no_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object) -> None:
        raise ValueError("no run")

    monkeypatch.setattr("fracture_collision.ros.runs.scene_recording.Lockstep", failing)
    with pytest.raises(ValueError, match="no run"):
        record_pane(tmp_path / "bag")
    assert not (tmp_path / "bag").exists()


def test_digest_takes_a_file_and_a_folder(bag: Path) -> None:
    one, other = run("digest", bag), run("digest", bag / "pane_0.mcap")
    assert one.returncode == other.returncode == 0 and one.stdout == other.stdout
    assert f"{STEPS:6}  {CONTACTS}" in one.stdout


def test_a_replay_that_compares_nothing_fails(bag: Path, tmp_path: Path) -> None:
    def without_contacts(message: BagMessage) -> list[BagMessage]:
        return [message] if message.topic != CONTACTS else []

    done = run("replay", changed_bag(tmp_path / "bag", bag, without_contacts))
    assert done.returncode == 3 and f"no answer to {STEPS} of these steps" in done.stdout
    assert "has no answer to any of these steps" in " ".join(done.stderr.split())


def test_a_replay_with_answers_of_another_type_fails(bag: Path, tmp_path: Path) -> None:
    renamed = tmp_path / "renamed"
    topics = [bag_topic(f"/{topic.name}", topic) for topic in TOPICS]
    topics = [t if t.name != CONTACTS else t._replace(message_type="other/msg/Contacts") for t in topics]
    with BagWriter(renamed, topics) as writer:
        for message in read_messages(bag):
            writer.write(message.topic, message.data, message.nanoseconds)
    done = run("replay", renamed)
    words = " ".join(done.stderr.split())
    assert done.returncode == 3 and "has no topic of type fracture_collision/msg/ContactConstraintArray" in words
    assert f"{CONTACTS} (other/msg/Contacts)" in words


@pytest.mark.slow
def test_missing_states_and_answers_are_reported(bag: Path, tmp_path: Path) -> None:
    """A bag may lack states or answers: here those of a step in the middle and of the last."""
    for name, topic in (("answers", CONTACTS), ("questions", "/fragment_states")):
        lost = [list(read_messages(bag, [topic]))[step] for step in (12, STEPS - 1)]
        spoilt = changed_bag(tmp_path / name, bag, lambda m, lost=lost: [m] if m not in lost else [])
        done = run("replay", spoilt, "--settings", "contacts_per_pair=6")
        assert done.returncode == 3 and f"all {STEPS - 2} answers equal the recorded ones" in done.stdout
        words = "no answer to 2 of these" if name == "answers" else "answers, but no states, of 2 steps, first step 12"
        assert words in done.stdout
        some = run("replay", spoilt, "--settings", "contacts_per_pair=6", "--steps", "13:29")
        assert some.returncode == 0

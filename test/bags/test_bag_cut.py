"""Bags that are truncated, damaged or written by other programs: the readable part is read, and they are mended."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.writer import CompressionType
from stages.mcap_bytes import CHUNK, mcap_of, records

from fracture_collision.bag.exchanges import read_runs
from fracture_collision.bag.mcap_file import BagError, McapFile
from fracture_collision.bag.metadata import KEY
from fracture_collision.bag.reader import message_counts, missing_words, read_messages
from fracture_collision.bag.writer import mend_bag

FILE = "pane_0.mcap"


@pytest.fixture(scope="module")
def chunky(tmp_path_factory: pytest.TempPathFactory, recorded: Path) -> Path:
    """The same bag in chunks of a few kilobytes."""
    folder = tmp_path_factory.mktemp("chunky") / "pane"
    folder.mkdir()
    shutil.copy(recorded / "metadata.yaml", folder)
    (folder / FILE).write_bytes(mcap_of(list(read_messages(recorded)), recorded / FILE))
    return folder


@pytest.fixture
def bag(chunky: Path, tmp_path: Path) -> Path:
    shutil.copytree(chunky, tmp_path / "pane")
    return tmp_path / "pane"


# --- cut ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("every", "others"), [(4, 10), pytest.param(1, 40, marks=pytest.mark.slow)])
def test_a_bag_cut_anywhere_gives_the_messages_before_the_cut(bag: Path, every: int, others: int) -> None:
    """At the end of records, `every` how many of them, and at `others` places."""
    data = (bag / FILE).read_bytes()
    messages = list(read_messages(bag))
    ends = [begin + size for _, begin, size in records(data)]
    first_chunk = next(begin for opcode, begin, _ in records(data) if opcode == CHUNK) - 9
    random = np.random.default_rng(1)
    read = []
    for length in sorted({*ends[::-every], *random.integers(first_chunk, len(data), others).tolist()}):
        (bag / FILE).write_bytes(data[:length])
        found = list(read_messages(bag))
        assert found == messages[: len(found)]
        assert sum(message_counts(bag).values()) == len(found)
        file = McapFile(bag / FILE)
        assert not file.is_whole and file.lost_bytes == length - max([8, *(end for end in ends if end <= length)])
        assert "is truncated" in missing_words(bag)[0]
        read.append(len(found))
    assert read == sorted(read) and read[0] == 0 and read[-1] == len(messages) and len(set(read)) > 10


@pytest.mark.parametrize("tail", [bytes(4096), b"\xff" * 4096], ids=["zeros", "ones"])
def test_filler_at_the_end_of_a_cut_file_is_ignored(bag: Path, tail: bytes) -> None:
    data = (bag / FILE).read_bytes()
    end = [begin + size for opcode, begin, size in records(data) if opcode == CHUNK][3]
    (bag / FILE).write_bytes(data[:end] + tail)
    assert len(list(read_messages(bag))) > 3
    assert McapFile(bag / FILE).lost_bytes == len(tail)


def test_a_folder_without_valid_metadata_is_read_reported_and_mended(bag: Path) -> None:
    messages = list(read_messages(bag))
    (bag / "metadata.yaml").write_text(f"{KEY}: [odd]")
    assert mend_bag(bag).messages == len(messages)
    assert list(read_messages(bag)) == messages
    (bag / "metadata.yaml").unlink()
    assert list(read_messages(bag)) == messages
    assert missing_words(bag) == [f"{bag}: has no metadata.yaml"]
    mend_bag(bag)
    assert missing_words(bag) == [] and list(read_messages(bag)) == messages
    information = yaml.safe_load((bag / "metadata.yaml").read_text())[KEY]
    assert information["message_count"] == len(messages)
    assert {entry["topic_metadata"]["name"] for entry in information["topics_with_message_count"]} == set(
        message_counts(bag)
    )


def test_mending_omits_damaged_parts_and_reports_where(bag: Path) -> None:
    data = bytearray((bag / FILE).read_bytes())
    messages = list(read_messages(bag))
    begin, size = [(begin, size) for opcode, begin, size in records(bytes(data)) if opcode == CHUNK][4]
    data[begin + size // 2] ^= 0xFF
    (bag / FILE).write_bytes(data[:-2000])  # and truncated
    with pytest.raises(BagError, match=f"damaged at byte {begin}"):
        list(read_messages(bag))
    mended = mend_bag(bag)
    assert len(mended.damaged) == 1 and f"byte {begin}" in mended.damaged[0]
    found = list(read_messages(bag))
    assert missing_words(bag) == [] and 0 < len(messages) - len(found) < len(messages) / 2
    assert [message for message in messages if message in found] == found


def test_files_that_cannot_be_mended_stay_unchanged(bag: Path) -> None:
    (bag / FILE).write_bytes(b"no bag" * 100)
    before = {path.name: path.read_bytes() for path in bag.iterdir()}
    with pytest.raises(BagError, match="not an MCAP file"):
        mend_bag(bag)
    assert {path.name: path.read_bytes() for path in bag.iterdir()} == before


# --- other writers --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "writing",
    [{"use_chunking": False}, {"compression": CompressionType.LZ4}, {"compression": CompressionType.NONE},
     {"repeat_channels": False, "repeat_schemas": False, "use_statistics": False}, {"enable_crcs": False}],
    ids=["no chunks", "lz4", "not compressed", "no summary", "no checksums"],
)  # fmt: skip
def test_bags_of_other_writers_are_read(bag: Path, recorded: Path, writing: dict[str, Any]) -> None:
    messages = list(read_messages(recorded))
    (bag / FILE).write_bytes(mcap_of(messages, recorded / FILE, **writing))
    assert list(read_messages(bag)) == messages and McapFile(bag / FILE).is_whole
    assert len(read_runs(bag)[0].questions) == 30


def test_messages_are_read_in_the_order_of_their_times(bag: Path, recorded: Path) -> None:
    """Even if the file stores them in a different order, across chunks."""
    messages = list(read_messages(recorded))
    random = np.random.default_rng(2)
    shuffled = [messages[i] for i in np.argsort(np.arange(len(messages)) + random.uniform(0, 40, len(messages)))]
    (bag / FILE).write_bytes(mcap_of(shuffled, recorded / FILE))
    found = list(read_messages(bag))
    assert [m.nanoseconds for m in found] == sorted(m.nanoseconds for m in messages)
    assert sorted(found) == sorted(messages)

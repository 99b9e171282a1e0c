"""Malicious bags: rejected with an explanation, within a memory limit, and without reading any other file."""

from __future__ import annotations

import os
import shutil
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame
import numpy as np
import pytest
import yaml
import zstandard
from stages.mcap_bytes import CHANNEL, CHUNK, MESSAGE, SCHEMA, chunk, record, text
from stages.typed_command import call
from worlds.recorded_pane import changed_bag

from fracture_collision import plain_yaml
from fracture_collision.bag import mcap_file
from fracture_collision.bag.exchanges import read_runs
from fracture_collision.bag.mcap_file import MAGIC, BagError, McapFile
from fracture_collision.bag.metadata import KEY, LARGEST
from fracture_collision.bag.reader import mcap_files, missing_words, recorded_settings
from fracture_collision.replay import settings_of

FILE = "pane_0.mcap"


@pytest.fixture
def bag(recorded: Path, tmp_path: Path) -> Path:
    shutil.copytree(recorded, tmp_path / "pane")
    return tmp_path / "pane"


def mcap_files_that_lie() -> dict[str, tuple[bytes, str]]:
    """File contents, and a substring of the error."""
    head = MAGIC + record(0x01, text("ros2") + text("x"))
    schema = record(SCHEMA, struct.pack("<H", 1) + text("fracture_collision/msg/FragmentStates") + text("ros2msg")
                    + text("uint64 run_id"))  # fmt: skip
    channel = record(CHANNEL, struct.pack("<HH", 1, 1) + text("/fragment_states") + text("cdr") + text(""))
    bomb = zstandard.ZstdCompressor().compress(bytes(1 << 28))
    streamed = zstandard.ZstdCompressor().compressobj()
    unsized = streamed.compress(bytes(1 << 26)) + streamed.flush()
    inner = schema + channel + record(MESSAGE, struct.pack("<HIQQ", 1, 0, 0, 0) + b"short")
    lz4_bomb = lz4.frame.compress(bytes(1 << 28))
    huge = struct.pack("<I", 2**32 - 1)
    nested = chunk(inner, "", len(inner))
    empty = record(0xFF, b"") * 1_500_000
    return {
        "empty": (b"", "not an MCAP file"),
        "noise": (np.random.default_rng(0).bytes(100_000), "not an MCAP file"),
        "magic and noise": (MAGIC + np.random.default_rng(0).bytes(100_000), "holds no"),
        "another version": (b"\x89MCAP1\r\n" + head[8:], "not an MCAP file"),
        "magic alone": (MAGIC, "holds no"),
        "a record longer than the file": (head + struct.pack("<BQ", CHUNK, 2**63), "holds no"),
        "a longest possible record": (head + struct.pack("<BQ", SCHEMA, 2**64 - 1), "holds no"),
        "zstd bomb": (head + chunk(bomb, "zstd", 100), "it states 100 bytes"),
        "zstd bomb, size unknown": (head + chunk(unsized, "zstd", 100), "it states 100 bytes"),
        "zstd bomb that admits it": (head + chunk(bomb, "zstd", 1 << 28), "too many"),
        "zstd bomb that boasts": (head + chunk(bomb, "zstd", 2**40), "too many"),
        "lz4 bomb": (head + chunk(lz4_bomb, "lz4", 100), "it states 100 bytes"),
        "more announced than there is": (head + chunk(b"abc", "", 1 << 20), "it states"),
        "no zstd at all": (head + chunk(b"no zstd at all", "zstd", 100), "damaged"),
        "no lz4 at all": (head + chunk(b"no lz4 at all", "lz4", 100), "damaged"),
        "a compression unheard of": (head + chunk(b"x", "rot13", 1), "rot13"),
        "a wrong checksum": (head + chunk(inner, "", len(inner), zlib.crc32(inner) ^ 1), "checksum"),
        "a chunk that is too short": (head + record(CHUNK, bytes(17)), "damaged"),
        "a huge text": (head + record(SCHEMA, struct.pack("<H", 1) + huge), "damaged"),
        "a huge text in a chunk": (head + chunk(record(SCHEMA, bytes(2) + huge), "", 15), "damaged"),
        "a huge record in a chunk": (head + chunk(struct.pack("<BQ", MESSAGE, 2**63), "", 9), "damaged"),
        "a message of no channel": (head + record(MESSAGE, struct.pack("<HIQQ", 9, 0, 0, 0)), "channel 9"),
        "a message in the dark": (head + record(MESSAGE, bytes(14)), "damaged"),
        "no unicode": (head + record(SCHEMA, struct.pack("<HI", 1, 2) + b"\xff\xfe" + text("") + text("")), "damaged"),
        "another definition": (head + schema + channel, "another definition of FragmentStates"),
        "a channel of no schema": (head + channel, "holds no"),
        "empty records": (head + chunk(lz4.frame.compress(empty), "lz4", len(empty)), "records, which is too many"),
        "a chunk in a chunk": (head + chunk(nested, "", len(nested)), "holds no"),
    }


LIES = mcap_files_that_lie()


@pytest.mark.parametrize("name", LIES)
def test_files_with_false_content_are_rejected_with_an_explanation(name: str, tmp_path: Path) -> None:
    content, words = LIES[name]
    path = tmp_path / "lie.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match=words):
        read_runs(path)


def test_files_with_false_content_take_little_memory(tmp_path: Path) -> None:
    """All files in one process; the bombs expand to 64 or 256 MB each."""
    for i, (content, _) in enumerate(LIES.values()):
        (tmp_path / f"{i}.mcap").write_bytes(content)
    code = f"""
import resource
from pathlib import Path
from fracture_collision.bag.exchanges import read_runs
from fracture_collision.bag.mcap_file import BagError
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for path in sorted(Path({str(tmp_path)!r}).glob("*.mcap")):
    try:
        read_runs(path)
    except BagError:
        pass
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) // 1024)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120.0)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout.split()[-1]) < 40, done.stdout  # [MB]


@pytest.mark.parametrize("times", [40, pytest.param(150, marks=pytest.mark.slow)])
def test_bytes_changed_at_random_are_read_or_rejected(bag: Path, times: int) -> None:
    data = (bag / FILE).read_bytes()
    random = np.random.default_rng(4)
    refused = 0
    for _ in range(times):
        garbled = bytearray(data)
        for at in random.integers(0, len(data), random.integers(1, 6)):
            garbled[at] = random.integers(0, 256)
        (bag / FILE).write_bytes(garbled)
        try:
            missing_words(bag)
            recorded_settings(bag)
            read_runs(bag)
        except BagError as error:
            refused += 1
            assert str(bag) in str(error)
    assert refused > times * 2 / 3


METADATA: dict[str, tuple[Any, str]] = {
    "no mapping": ([1, 2], "not the metadata"),
    "nothing": (None, "not the metadata"),
    "another key": ({"bag": {}}, "not the metadata"),
    "a list inside": ({KEY: []}, "not the metadata"),
    "no files": ({KEY: {}}, "relative_file_paths"),
    "files that are none": ({KEY: {"relative_file_paths": "pane_0.mcap"}}, "relative_file_paths"),
    "numbers": ({KEY: {"relative_file_paths": [1, 2]}}, "relative_file_paths"),
    "an empty name": ({KEY: {"relative_file_paths": [""]}}, "not a path inside this folder"),
    "a dot": ({KEY: {"relative_file_paths": ["."]}}, "not a path inside this folder"),
    "upwards": ({KEY: {"relative_file_paths": ["../secret.mcap"]}}, "not a path inside this folder"),
    "down and up": ({KEY: {"relative_file_paths": ["a/../../secret.mcap"]}}, "not a path inside this folder"),
    "absolute": ({KEY: {"relative_file_paths": ["/etc/passwd"]}}, "not a path inside this folder"),
    "a link out": ({KEY: {"relative_file_paths": ["link.mcap"]}}, "leads out of this folder"),
    "not there": ({KEY: {"relative_file_paths": ["else.mcap"]}}, "does not exist"),
    "a folder": ({KEY: {"relative_file_paths": ["folder"]}}, "does not exist"),
    "a pipe": ({KEY: {"relative_file_paths": ["pipe"]}}, "does not exist"),
    "very many": ({KEY: {"relative_file_paths": ["pane_0.mcap"] * 10_001}}, "too many"),
}


@pytest.mark.parametrize("name", METADATA)
def test_metadata_of_wrong_types_or_with_foreign_paths_is_rejected(name: str, bag: Path) -> None:
    content, words = METADATA[name]
    shutil.copy(bag / FILE, bag.parent / "secret.mcap")
    (bag / "link.mcap").symlink_to(bag.parent / "secret.mcap")
    (bag / "folder").mkdir()
    os.mkfifo(bag / "pipe")
    (bag / "metadata.yaml").write_text(yaml.safe_dump(content))
    with pytest.raises(BagError, match=words):
        mcap_files(bag)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"a: [", "not YAML"),
        (b"\xff\xfe\x00", "not text"),
        (b"!!python/object/apply:os.system ['touch /tmp/harm']", "not YAML"),
        (b"a: !!int ''", "'' is not of the type !!int, line 1"),
        (b"a: !!timestamp x", "'x' is not of the type !!timestamp, line 1"),
        (b"[" + b"1," * 400_000 + b"]", "more than 1000 parts"),
        (b"a: &a [x, x]\nb: &b [*a, *a]\nc: &c [*b, *b]", "not the metadata"),
        (b" " * (LARGEST + 1), "more than"),
    ],
)  # fmt: skip
@pytest.mark.timeout(20)
def test_yaml_is_parsed_as_data_only(
    bag: Path, content: bytes, words: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the parser of scene files, whose other faults are in world/test_bad_input_files.py."""
    monkeypatch.setattr(plain_yaml, "MAX_PARTS", 1000)  # the limit itself takes seconds to reach
    (bag / "metadata.yaml").write_bytes(content)
    with pytest.raises(BagError, match=words):
        mcap_files(bag)


def test_definitions_of_a_file_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(mcap_file, "LARGEST_DEFINITION", 1000)
    schemas = [record(SCHEMA, struct.pack("<H", i) + text("x") + text("") + text("y" * 200)) for i in range(1, 6)]
    for content in (b"".join(schemas), b"".join(chunk(each, "", len(each)) for each in schemas)):
        path = tmp_path / "definitions.mcap"
        path.write_bytes(MAGIC + content)
        with pytest.raises(BagError, match="more than 1000 bytes of definitions"):
            McapFile(path).channels()


def test_chunks_without_definitions_are_searched_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each of a hundred chunks has a message of a channel that no chunk defines."""
    path = tmp_path / "undefined.mcap"
    message = record(MESSAGE, struct.pack("<HIQQ", 9, 0, 0, 0))
    path.write_bytes(MAGIC + chunk(message, "", len(message)) * 100)
    opened: list[int] = []
    read = McapFile._messages_in
    monkeypatch.setattr(McapFile, "_messages_in", lambda file, data, piece: opened.append(1) or read(file, data, piece))
    damaged: list[BagError] = []
    assert not list(McapFile(path).messages(on_damage=damaged.append))
    assert len(damaged) == 100 and len(opened) == 200


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ("{", "not JSON"),
        ("[1]", "not a JSON object"),
        ("[" * 100_000, "JSON"),
        (" " * 100_000, "not a JSON object"),
        ('{"contacts_per_pair": "8"}', "contacts_per_pair: '8' is not of type int"),
        ('{"contacts_per_pair": true}', "is not of type int"),
        ('{"contacts_per_pair": 0}', "contacts_per_pair: 0 is less than 1"),
        ('{"penetration_tolerance": NaN}', "penetration_tolerance"),
        ('{"method": "none"}', "method"),
        ('{"method": "glondu2014", "paper": {"tree": "oak"}}', "tree: 'oak' is not one of"),
        ('{"method": "glondu2014", "paper": [1]}', "paper"),
    ],
)  # fmt: skip
def test_invalid_settings_are_rejected(bag: Path, settings: str, words: str) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())
    information[KEY]["custom_data"] = {"collision_settings": settings}
    (bag / "metadata.yaml").write_text(yaml.safe_dump(information))
    with pytest.raises(BagError, match=words):
        settings_of(bag, {})


def test_undecodable_messages_are_reported_with_their_topic(recorded: Path, tmp_path: Path) -> None:
    changes: dict[str, Callable[[bytes], bytes]] = {
        "nothing": lambda data: b"",
        "cut": lambda data: data[:-9],
        "noise": lambda data: np.random.default_rng(1).bytes(len(data)),
        "another byte order": lambda data: b"\x00\x00" + data[2:],
    }
    for topic in ("/bodies", "/fracture_events", "/fragment_states", "/contact_constraints"):
        for name, change in changes.items():
            made = changed_bag(
                tmp_path / f"{topic[1:]} {name}", recorded,
                lambda m, topic=topic, change=change: [m._replace(data=change(m.data)) if m.topic == topic else m],
            )  # fmt: skip
            with pytest.raises(BagError, match=f"{topic}.*no serialized"):
                read_runs(made)


@pytest.mark.parametrize("command", ["replay", "digest", "mend"])
def test_commands_explain_damaged_files(command: str, tmp_path: Path) -> None:
    for name in ("noise", "zstd bomb", "magic and noise"):
        folder = tmp_path / name.replace(" ", "_")
        folder.mkdir()
        (folder / "lie_0.mcap").write_bytes(LIES[name][0])
        done = call(command, folder)
        if command == "replay" or name == "noise":
            assert done.status == 2 and "Error:" in done.output

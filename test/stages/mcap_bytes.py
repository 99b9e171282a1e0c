"""MCAP files byte by byte, and by mcap's own writer. For tests of the bag readers."""

from __future__ import annotations

import struct
from pathlib import Path
from typing import Any

from mcap.writer import Writer

from fracture_collision.bag.mcap_file import MAGIC, McapFile
from fracture_collision.bag.reader import BagMessage

CHUNK, SCHEMA, CHANNEL, MESSAGE = 0x06, 0x03, 0x04, 0x05  # opcodes


def mcap_of(messages: list[BagMessage], like: Path, **writing: Any) -> bytes:
    """An MCAP file by mcap's own writer, with the definitions of the file `like`."""
    path = like.with_name("written.mcap")
    with path.open("wb") as stream:
        writer = Writer(stream, **{"chunk_size": 30_000, **writing})
        writer.start(profile="ros2")
        channels = {}
        for channel, schema in McapFile(like).channels():
            schema_id = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.topic] = writer.register_channel(channel.topic, "cdr", schema_id, channel.metadata)
        for topic, time, data in messages:
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path.read_bytes()


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, start of the content, and size of each record of a complete file."""
    found, at = [], len(MAGIC)
    while at < len(data) - len(MAGIC):
        opcode, size = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at + 9, size))
        at += 9 + size
    return found


def record(opcode: int, content: bytes) -> bytes:
    return struct.pack("<BQ", opcode, len(content)) + content


def text(words: str) -> bytes:
    return struct.pack("<I", len(words)) + words.encode()


def chunk(data: bytes, compression: str, size: int, crc: int = 0) -> bytes:
    head = struct.pack("<QQQI", 0, 0, size, crc) + text(compression)
    return record(CHUNK, head + struct.pack("<Q", len(data)) + data)

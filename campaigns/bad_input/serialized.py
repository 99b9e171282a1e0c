"""Corrupts bytes instead of fields: noise, truncated messages, enlarged lengths, flipped bits, swapped parts."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from struct import pack_into
from typing import Any

import numpy as np
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.serialization import deserialize_message
from worlds.gate_world import EARLIER, FIRST, SECOND, box

from campaigns.bad_input.body_mutations import SHAPES
from campaigns.bad_input.clean_scene import record_bytes
from campaigns.bad_input.mutations import Pick, one_of
from campaigns.bad_input.states_mutations import MOVING
from fracture_collision.records import REMOVE
from fracture_collision.ros.wire.cdr_records import deserialize_record
from fracture_collision.ros.wire.conversion import to_record

HEAD = 24  # bytes: encapsulation, stamp, frame
LENGTHS = (2**32 - 1, 2**31, 2**31 - 1, 2**29, 10**9, 2**24, 0, 1)
ENCAPSULATIONS = (b"\0\0", b"\0\2", b"\0\3", b"\0\6", b"\0\7", b"\0\t", b"\0\x0b", b"\1\0", b"\xff\xff")


@cache
def valid_messages(topic: str) -> tuple[bytes, ...]:
    from campaigns.bad_input.doors import as_bytes

    records: dict[str, tuple[Any, ...]] = {
        "bodies": (*SHAPES, box(4, operation=REMOVE)), "fracture_events": (FIRST, SECOND),
        "fragment_states": (MOVING, EARLIER),
    }  # fmt: skip
    return tuple(as_bytes(record) for record in records[topic])


def spoilt_bytes(topic: str, pick: Pick) -> tuple[str, bytes]:
    """Name of the corruption, and the resulting bytes."""
    spoil = one_of(SPOILERS, pick)
    data = bytearray(one_of(valid_messages(topic), pick))
    return spoil.__name__.strip("_").replace("_", " "), bytes(spoil(data, pick))


def _noise(data: bytearray, pick: Pick) -> bytes:
    """After a valid encapsulation in half of the cases."""
    noise = np.random.default_rng(pick(2**32)).bytes(pick(400))
    return bytes(data[:4]) + noise if pick(2) else noise


def _cut_short(data: bytearray, pick: Pick) -> bytearray:
    return data[: pick(len(data))]


def _bits_flipped(data: bytearray, pick: Pick) -> bytearray:
    for _ in range(1 + pick(8)):
        data[pick(len(data))] ^= 1 << pick(8)
    return data


def _bytes_changed(data: bytearray, pick: Pick) -> bytearray:
    for _ in range(1 + pick(8)):
        data[pick(len(data))] = pick(256)
    return data


def _a_word_enlarged(data: bytearray, pick: Pick) -> bytearray:
    pack_into("<I", data, 4 + 4 * pick(len(data) // 4 - 1), one_of(LENGTHS, pick))
    return data


def _a_number_of_eight_bytes(data: bytearray, pick: Pick) -> bytearray:
    value = one_of((float("nan"), float("inf"), 1e308, 1e-320, -1.0), pick)
    pack_into("<d", data, 4 + 8 * pick((len(data) - 4) // 8), value)
    return data


def _a_part_left_out(data: bytearray, pick: Pick) -> bytearray:
    begin = pick(len(data))
    del data[begin : begin + 1 + pick(64)]
    return data


def _a_part_twice(data: bytearray, pick: Pick) -> bytearray:
    begin = pick(len(data))
    return data[:begin] + data[begin : begin + 1 + pick(64)] + data[begin:]


def _another_encapsulation(data: bytearray, pick: Pick) -> bytearray:
    data[:2] = one_of(ENCAPSULATIONS, pick)
    return data


def _bytes_behind_the_end(data: bytearray, pick: Pick) -> bytearray:
    return data + bytes(one_of((1, 3, 4, 8, 1000, 100_000), pick))


def _head_of_another(data: bytearray, pick: Pick) -> bytes:
    """The first half of one kind of message, the second half of another."""
    other = one_of(valid_messages(one_of(("bodies", "fracture_events", "fragment_states"), pick)), pick)
    return bytes(data[: HEAD + pick(len(data) - HEAD)]) + other[HEAD + pick(len(other) - HEAD) :]


SPOILERS = (
    _noise, _cut_short, _bits_flipped, _bytes_changed, _a_word_enlarged, _a_number_of_eight_bytes, _a_part_left_out,
    _a_part_twice, _another_encapsulation, _bytes_behind_the_end, _head_of_another,
)  # fmt: skip


def compared_with_rclpy(data: bytes, message_class: Any) -> tuple[str, str]:
    """(accepted by: "both", "neither", "ours alone" or "rclpy alone"; description of the fault, if any).

    If both accept it they must have read the same. rclpy's reader is C: a failure there may kill the process.
    """
    try:
        ours = deserialize_record(data, message_class).record
    except ValueError:
        ours = None
    try:
        with _silent():
            theirs = to_record(deserialize_message(data, message_class))
    except rclpy_implementation.RMWError:
        theirs = None
    if ours is None or theirs is None:
        return "neither" if ours is theirs else "rclpy alone" if ours is None else "ours alone", ""
    same = record_bytes(_numbers(ours)) == record_bytes(_numbers(theirs))
    return "both", "" if same else "read otherwise than by rclpy"


def _numbers(record: Any) -> tuple:
    return tuple(np.array(value.dimensions) if hasattr(value, "dimensions") else value for value in record)


@contextmanager
def _silent() -> Iterator[None]:
    """Discards stderr, where rclpy's C code reports errors in a message."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)

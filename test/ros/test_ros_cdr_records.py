"""Direct CDR serialization of records: bytes equal to rclpy's, and nothing is deserialized from invalid data."""

from __future__ import annotations

import tracemalloc
from contextlib import suppress
from struct import Struct
from struct import error as StructError
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point32
from rclpy.serialization import deserialize_message, serialize_message
from test_ros_conversion import EXAMPLES, assert_same, floats, ids

from fracture_collision import msg as messages
from fracture_collision import records
from fracture_collision.bag.exchanges import LAYOUTS, NESTED_LAYOUTS
from fracture_collision.cdr import Heading
from fracture_collision.ros.wire.cdr_padding import zero_padding
from fracture_collision.ros.wire.cdr_records import deserialize_record, layout_of, nested_class, serialize_record
from fracture_collision.ros.wire.conversion import heading, message_class_of, to_message, to_record

RUN = 2**64 - 1
HEADINGS = [heading(1.25), heading(0.0, ""), Heading(-1, 999_999_999, "Küche/Boden"), heading(3.0, "w" * 255)]


def states(count: int) -> records.FragmentStates:
    return records.FragmentStates(7, 2, ids(count), floats(3 * count), floats(4 * count))


def contacts(pairs: int, count: int) -> records.ContactConstraintArray:
    return records.ContactConstraintArray(
        2**64 - 1, 2, records.INVALID_STATES, ids(pairs), ids(pairs), ids(pairs + 1), floats(pairs), floats(pairs),
        floats(pairs), floats(3 * count), floats(3 * count), floats(3 * count), floats(count), ids(count, np.uint64),
    )  # fmt: skip


RECORDS = [
    *(states(count) for count in range(4)),
    *(contacts(pairs, count) for pairs in range(3) for count in range(3)),
    contacts(300, 900),
]


@pytest.mark.parametrize("head", HEADINGS, ids=lambda head: head.frame_id[:12] or "empty")
def test_serialization_and_reading_equal_those_of_rclpy(head: Heading) -> None:
    for record in (*EXAMPLES, *RECORDS):
        message = to_message(record, head, RUN)
        theirs, mine = serialize_message(message), serialize_record(record, head, RUN)
        assert mine == zero_padding(theirs, type(message))
        for data in (theirs, mine, mine + b"\x01\x02\x03"):  # bytes after the last field are ignored
            read_by_rclpy = deserialize_message(data, type(message))
            assert_same(record, to_record(read_by_rclpy))
            assert read_by_rclpy.header == message.header and read_by_rclpy.run_id == RUN
            received = deserialize_record(data, type(message))
            assert_same(record, received.record)
            assert (received.heading, received.run_id) == (head, RUN)
            for array in (field for field in received.record if isinstance(field, np.ndarray)):
                assert array.flags.aligned and array.flags.writeable and array.flags.c_contiguous


def test_bags_are_read_by_the_layouts_of_the_message_classes() -> None:
    nested = set()
    for record_class, layout in LAYOUTS.items():
        assert layout == layout_of(getattr(messages, record_class.__name__))
        nested |= {kind for _, kind in layout if "/" in kind}
    for kind, layout in NESTED_LAYOUTS.items():
        assert layout == layout_of(nested_class(kind))
    assert nested <= set(NESTED_LAYOUTS)


def test_a_string_ends_at_its_first_zero_as_in_rclpy() -> None:
    head, data = heading(0.0, "world"), bytearray(the_bytes(states(1), heading(0.0, "world")))
    at = data.index(b"world\0")
    for text in (b"world!", b"wo\0ld\0", b"\0\0\0\0\0\0", b"wor\xff\xfe\0"):
        data[at : at + 6] = text
        theirs = deserialize_message(bytes(data), message_class_of(states(0))).header.frame_id
        assert deserialize_record(data, message_class_of(states(0))).heading == head._replace(frame_id=theirs)


def test_points_of_a_polygon_are_skipped() -> None:
    message = to_message(EXAMPLES[0], HEADINGS[0], RUN)
    message.primitive.polygon.points = [Point32(x=1.0, y=2.0, z=3.0)] * 5
    assert_same(EXAMPLES[0], deserialize_record(serialize_message(message), type(message)).record)


def the_bytes(record: Any, head: Heading = HEADINGS[0]) -> bytes:
    message = to_message(record, head, RUN)
    return zero_padding(serialize_message(message), type(message))


@pytest.mark.parametrize("record", [states(2), contacts(1, 2), *EXAMPLES], ids=lambda record: type(record).__name__)
def test_truncated_messages_are_rejected_with_an_explanation(record: Any) -> None:
    message_class = message_class_of(record)
    data = the_bytes(record)
    for length in range(len(data)):
        with pytest.raises(ValueError, match=f"no serialized {message_class.__name__}"):
            deserialize_record(data[:length], message_class)


def test_errors_of_truncated_messages_name_the_field() -> None:
    body = EXAMPLES[0]
    data = the_bytes(body)
    for length, field in ((9, "nanosec"), (34, "run_id"), (len(data) - 1, "restitution"), (len(data) - 30, "density")):
        with pytest.raises(ValueError, match=f"{length} bytes are too few for its field {field}$"):
            deserialize_record(data[:length], message_class_of(body))


def test_invalid_booleans_are_rejected() -> None:
    at = len(the_bytes(EXAMPLES[0])) - 32  # offset of is_static, which three numbers follow
    for value in (2, 255):
        data = bytearray(the_bytes(EXAMPLES[0]))
        assert data[at] == 1
        data[at] = value
        with pytest.raises(ValueError, match="CollisionBody: is_static: neither true nor false"):
            deserialize_record(bytes(data), message_class_of(EXAMPLES[0]))
    data = bytearray(the_bytes(EXAMPLES[-1]))
    data[-1] = 2
    with pytest.raises(ValueError, match="FragmentMesh: is_crack: neither true nor false"):
        deserialize_record(bytes(data), message_class_of(EXAMPLES[-1]))


def test_primitives_with_too_many_dimensions_are_rejected() -> None:
    data = the_bytes(EXAMPLES[0])
    at = data.rindex(Struct("<I").pack(3), 0, data.index(Struct("<ddd").pack(1.0, 2.0, 0.5)))
    with pytest.raises(ValueError, match="4 entries, more than 3"):
        deserialize_record(data[:at] + Struct("<I").pack(4) + data[at + 4 :], message_class_of(EXAMPLES[0]))


@pytest.mark.parametrize("record", EXAMPLES, ids=lambda record: type(record).__name__)
def test_no_length_allocates_more_memory_than_the_message_has(record: Any) -> None:
    """Every four-byte word in turn is replaced by a huge count."""
    data, message_class = the_bytes(record), message_class_of(record)
    tracemalloc.start()
    try:
        for at in range(4, len(data) - 3, 4):
            for count in (len(data), 2**31 - 1, 2**32 - 1):
                with suppress(ValueError):
                    deserialize_record(data[:at] + Struct("<I").pack(count) + data[at + 4 :], message_class)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 20 * len(data) + 20_000


def test_random_bytes_are_read_or_rejected() -> None:
    random = np.random.default_rng(5)
    data = serialize_record(contacts(2, 3), HEADINGS[0], RUN)
    refused = 0
    for _ in range(3000):
        garbled = bytearray(data)
        for at in random.integers(0, len(data), 4):
            garbled[at] = random.integers(0, 256)
        try:
            received = deserialize_record(bytes(garbled), message_class_of(contacts(0, 0)))
        except ValueError:
            refused += 1
        else:
            assert sum(getattr(value, "nbytes", 0) for value in received.record) <= len(data)
    assert 100 < refused < 3000


def test_big_endian_messages_are_read() -> None:
    """A hand-written big-endian FragmentStates."""
    head = Struct(">iII4sQQQQII").pack(3, 5, 4, b"map\0", 41, 7, 2, 6, 1, 0xDEADBEEF)
    positions = Struct(">I4xddd").pack(3, 1.0, 2.0, 3.0)
    orientations = Struct(">I4xdddd").pack(4, 0.0, 0.0, 0.0, 1.0)
    data = b"\x00\x00\x00\x00" + head + positions + orientations + Struct(">II").pack(0, 0)
    received = deserialize_record(data, message_class_of(states(0)))
    assert received.heading == Heading(3, 5, "map") and received.run_id == 41
    assert received.record.body_sequence == 6 and received.record.fragment_ids.tolist() == [0xDEADBEEF]
    assert received.record.positions.tolist() == [[1.0, 2.0, 3.0]]
    assert received.record.orientations.tolist() == [[0.0, 0.0, 0.0, 1.0]]
    for wrong in (data[:-6], b"\x07\x07" + data[2:], b"\x00\x07" + data[2:], b""):
        with pytest.raises(ValueError, match="no serialized FragmentStates"):
            deserialize_record(wrong, message_class_of(states(0)))


def test_numbers_that_do_not_fit_and_arrays_of_the_wrong_shape_are_errors() -> None:
    for field, shape in (("positions", (3, 4)), ("fragment_ids", (3, 1))):
        with pytest.raises(ValueError, match="an array of shape"):
            serialize_record(states(3)._replace(**{field: np.zeros(shape)}), HEADINGS[0], 1)
    in_rows = states(3)
    flat = in_rows._replace(positions=in_rows.positions.ravel())
    assert serialize_record(flat, HEADINGS[0], 1) == serialize_record(in_rows, HEADINGS[0], 1)
    body = EXAMPLES[0]
    for wrong, words in (
        (body._replace(plane=np.zeros(3)), "coef: 3 entries, not 4 to 4"),
        (body._replace(primitive=records.SolidPrimitive(1, (1.0,) * 4)), "dimensions: 4 entries, not 0 to 3"),
    ):
        with pytest.raises(ValueError, match=words):
            serialize_record(wrong, HEADINGS[0], 1)
    for record, run_id in ((states(1)._replace(step=2**64), 1), (states(1), -1)):
        with pytest.raises(StructError):
            serialize_record(record, HEADINGS[0], run_id)

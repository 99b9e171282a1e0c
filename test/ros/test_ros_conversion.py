"""Records to messages and back: values are preserved and no array is copied element by element."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import deserialize_message, serialize_message
from truth.counted_work import calls_of, most_memory_of

from fracture_collision import records
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_padding import zero_padding
from fracture_collision.ros.wire.conversion import heading, to_message, to_record
from fracture_collision.world import Settings
from fracture_collision.world.settings import settings_text

RANDOM = np.random.default_rng(11)


def floats(count: int) -> np.ndarray:
    return RANDOM.normal(size=count)


def ids(count: int, dtype: type = np.uint32) -> np.ndarray:
    return RANDOM.integers(0, np.iinfo(dtype).max, count, dtype=dtype)


EXAMPLES = [
    records.CollisionBody(
        body_id=3, fragment_id=2**32 - 1, name="Schüssel",
        primitive=records.SolidPrimitive(records.BOX, (1.0, 2.0, 0.5)),
        plane=np.array([0.0, 0.6, 0.8, -1.5]), vertices=floats(12), triangles=ids(12), tetrahedra=ids(4),
        is_static=True, density=2400.0, friction=0.3, restitution=0.1,
    ),
    records.CollisionBody(body_id=1, fragment_id=1, operation=records.REMOVE),
    records.FractureEvent(
        sequence=2**63 + 1, body_id=1, fragment_id=1, new_fragment_ids=ids(3), nodes=ids(9), node_fragments=ids(9),
        cut_edges=ids(8), cut_planes=floats(16),
    ),
    records.FragmentStates(7, 2, ids(3), floats(9), floats(12), floats(9), floats(9)),
    records.FragmentStates(0, 0, ids(0), floats(0), floats(0)),
    records.ContactConstraintArray(
        7, 2, records.BUDGET_EXHAUSTED, ids(2), ids(2), ids(3), floats(2), floats(2), floats(2), floats(15), floats(15),
        floats(15), np.array([-0.0, np.inf, np.nan, 1e-300, 2.0]), ids(5, np.uint64), 1.0 / 120.0,
    ),
    records.FragmentRegistry(
        2, ids(2), ids(2), ids(2), floats(2), floats(6), floats(12), floats(2), "ab" * 32, settings_text(Settings()),
    ),
    records.FragmentMesh(9, floats(9).astype(np.float32), ids(6), np.array([True, False])),
]  # fmt: skip


def assert_same(a: Any, b: Any) -> None:
    assert type(a) is type(b)
    for name in a._fields:
        mine, other = getattr(a, name), getattr(b, name)
        if isinstance(mine, np.ndarray):
            assert mine.dtype == other.dtype and mine.tobytes() == other.tobytes(), name
        else:
            assert mine == other, name


def test_stamp_is_exact_to_the_nanosecond() -> None:
    for step in (1, 3, 479, 1_000_001):
        stamp = heading(step * 0.0025)
        assert stamp.sec * 10**9 + stamp.nanosec == step * 2_500_000


def serialized_examples() -> list[Any]:
    nested = DiagnosticArray(status=[DiagnosticStatus(name="abc", values=[KeyValue(key="k", value="words")] * 3)] * 2)
    return [to_message(record, heading(1.25), 7) for record in EXAMPLES] + [nested]


@pytest.mark.parametrize("message", serialized_examples(), ids=lambda message: type(message).__name__)
def test_padding_is_zeroed_and_nothing_else(message: Any) -> None:
    zeroed = zero_padding(serialize_message(message), type(message))
    assert zero_padding(zeroed, type(message)) == zeroed
    assert meaning(zeroed, type(message)) == meaning(serialize_message(message), type(message))
    padding = 0
    for i in range(4, len(zeroed)):
        garbled = bytearray(zeroed)
        garbled[i] ^= 255
        if zero_padding_or_none(bytes(garbled), type(message)) == zeroed:
            padding += 1
            assert zeroed[i] == 0
            assert meaning(bytes(garbled), type(message)) == meaning(zeroed, type(message))
    assert padding > 0


def meaning(data: bytes, message_class: Any) -> str:
    return str(deserialize_message(data, message_class))  # as text, in which NaNs compare equal


def zero_padding_or_none(data: bytes, message_class: Any) -> bytes | None:
    try:
        return zero_padding(data, message_class)
    except ValueError:
        return None


def test_undecodable_messages_have_no_padding() -> None:
    data = zero_padding(serialize_message(to_message(EXAMPLES[3], heading(1.25), 7)), qos.FRAGMENT_STATES.message_class)
    for wrong in (b"", data[:-1], data[:30], b"\x00\x00" + data[2:]):
        with pytest.raises(ValueError, match="no serialized FragmentStates"):
            zero_padding(wrong, qos.FRAGMENT_STATES.message_class)


def test_large_arrays_are_converted_in_bulk() -> None:
    """As many calls as for small arrays and less than twice the memory of the data: no object per element."""
    calls = []
    for count in (10, 200_000):
        long = {name: floats(3 * count) for name in ("points_a", "points_b", "normals")}
        contacts = EXAMPLES[5]._replace(**long)

        def convert(contacts: records.ContactConstraintArray = contacts) -> None:
            to_record(to_message(contacts, heading(0.0), 1))

        convert()
        calls.append(calls_of(convert))
    assert calls[0] == calls[1]
    assert most_memory_of(convert) < 2 * sum(values.nbytes for values in long.values())

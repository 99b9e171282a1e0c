"""Makes serialized messages comparable byte for byte.

CDR aligns numbers to their size. The padding, and the bytes after the last field if the buffer is too long, are
uninitialized memory: two serializations of one message may differ there. With zeroed padding and the end cut off,
equal messages have equal bytes.
"""

from __future__ import annotations

from functools import cache
from struct import Struct
from typing import Any

from fracture_collision.cdr import ARRAY, LITTLE_ENDIAN, SEQUENCE
from fracture_collision.ros.wire.cdr_records import layout_of, nested_class

_ENCAPSULATION = 4  # bytes before the body; alignment counts from their end
_COUNT = Struct("<I")
_SIZES = {
    "boolean": 1, "octet": 1, "int8": 1, "uint8": 1, "int16": 2, "uint16": 2, "int32": 4, "uint32": 4, "int64": 8,
    "uint64": 8, "float": 4, "double": 8,
}  # fmt: skip


def zero_padding(data: bytes, message_class: Any) -> bytes:
    """`data` with zeroed padding and nothing after its last field.

    Raises ValueError unless `data` is a little-endian CDR serialization of `message_class`.
    """
    if data[:2] != LITTLE_ENDIAN:
        raise ValueError(f"no serialized {message_class.__name__}: begins with {data[:2].hex()}")
    walk = _Walk(bytearray(data))
    try:
        walk.fields(_types(message_class))
    except IndexError:
        raise ValueError(f"no serialized {message_class.__name__}: {len(data)} bytes are too few") from None
    return bytes(walk.data[: walk.position])


@cache
def _types(message_class: Any) -> tuple[str, ...]:
    return tuple(kind for _, kind in layout_of(message_class))


@cache
def _nested_types(kind: str) -> tuple[str, ...]:
    return _types(nested_class(kind))


class _Walk:
    """Walks through the fields of a message and zeroes the padding between them."""

    def __init__(self, data: bytearray) -> None:
        self.data = data
        self.position = _ENCAPSULATION

    def fields(self, types: tuple[str, ...]) -> None:
        for field_type in types:
            self.field(field_type)

    def field(self, field_type: str) -> None:
        if field_type in _SIZES:
            self._skip(_SIZES[field_type], 1)
        elif field_type == "string":
            self._skip(1, self._count())
        elif match := SEQUENCE.fullmatch(field_type):
            self._elements(match[1], self._count())
        elif match := ARRAY.fullmatch(field_type):
            self._elements(match[1], int(match[2]))
        else:
            self.fields(_nested_types(field_type))

    def _elements(self, element_type: str, count: int) -> None:
        if element_type in _SIZES:
            if count:  # an empty sequence is not aligned
                self._skip(_SIZES[element_type], count)
            return
        for _ in range(count):
            self.field(element_type)

    def _count(self) -> int:
        self._skip(4, 1)
        return _COUNT.unpack_from(self.data, self.position - 4)[0]

    def _skip(self, size: int, count: int) -> None:
        gap = -(self.position - _ENCAPSULATION) % size
        begin = self.position + gap
        if begin + size * count > len(self.data):
            raise IndexError
        self.data[self.position : begin] = bytes(gap)
        self.position = begin + size * count

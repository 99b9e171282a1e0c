"""Records to serialized messages and back, without ROS and without message objects.

For bags, for the messages of every step, and for untrusted messages. rclpy's message objects copy each array four
times, into new memory each time; here it is copied once. A written message has zeroed padding and nothing after its
last field, and otherwise equals rclpy's bytes of the same message: equal messages have equal bytes.

Reading takes no more memory than the message has bytes, whatever lengths it contains. Any fault in it raises one
ValueError with an explanation.

CDR: a number is aligned to a multiple of its size, counted from the end of the four bytes of the encapsulation; a
sequence is its length as uint32, then its elements, and an empty one is not aligned; a string's length includes the
zero at its end.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from operator import itemgetter
from struct import Struct, calcsize
from typing import Any, Literal, NamedTuple

import numpy as np

from fracture_collision.records import WIDTHS, SolidPrimitive

# Name and type of each field, as in the generated message classes' get_fields_and_field_types.
Layout = tuple[tuple[str, str], ...]
ByteOrder = Literal["<", ">"]  # little-endian, big-endian

SEQUENCE = re.compile(r"sequence<([^,>]+)(?:, (\d+))?>")
ARRAY = re.compile(r"([^\[]+)\[(\d+)\]")

# Type -> type code of its numbers in struct, array.array and numpy, and how many numbers an element has.
ELEMENTS = {
    "boolean": ("?", 1), "uint8": ("B", 1), "int32": ("i", 1), "uint32": ("I", 1), "uint64": ("Q", 1),
    "float": ("f", 1), "double": ("d", 1), "geometry_msgs/Point32": ("f", 3),
}  # fmt: skip

LITTLE_ENDIAN = b"\x00\x01"
_BYTE_ORDERS: dict[bytes, ByteOrder] = {LITTLE_ENDIAN: "<", b"\x00\x00": ">"}
_ENCAPSULATION = LITTLE_ENDIAN + b"\x00\x00"  # the last two are options, without meaning in plain CDR
_COUNT = "I"
_UNLIMITED = 2**32 - 1
_WIDEST = 8  # bytes of a number
_GAPS = tuple(map(bytes, range(_WIDEST)))


class Heading(NamedTuple):
    """std_msgs/Header as a record: simulation time and frame."""

    sec: int
    nanosec: int
    frame_id: str


class Received(NamedTuple):
    """A message as it was read: its header, its run, and the record of all other fields."""

    heading: Heading
    run_id: int
    record: Any  # of the class that the Codec was made for


class _Nested(NamedTuple):
    """Converts the fields of a nested message to its value in a record, and back."""

    make: Callable[..., Any]
    fields: Callable[[Any], tuple[Any, ...]]


_NESTED = {
    "std_msgs/Header": _Nested(Heading, tuple),
    "shape_msgs/SolidPrimitive": _Nested(
        lambda kind, dimensions, polygon: SolidPrimitive(kind, tuple(dimensions.tolist())),
        lambda primitive: (primitive.type, primitive.dimensions, ()),  # only a prism has a polygon
    ),
    "shape_msgs/Plane": _Nested(lambda coefficients: coefficients, lambda coefficients: (coefficients,)),
}


class _Variable(NamedTuple):
    """A string, or an array of numbers."""

    name: str
    dtype: np.dtype | None  # as in the message; None: a string
    native: np.dtype | None  # as in memory
    alignment: int
    size: int  # bytes of an element
    element: int  # numbers in an element
    width: int  # of these in a row of the record's array; 0: it has one dimension
    has_length: bool  # in front of its elements
    fewest: int  # elements
    most: int
    is_plain: bool  # in this machine's byte order, and valid with any bits


class _Step(NamedTuple):
    """Consecutive numbers, the last of them the length of the variable that follows, if that has one."""

    packed: tuple[Struct, ...]  # with padding, by their beginning modulo _WIDEST
    places: slice  # of those that are fields, among all values
    place: int  # of the variable
    variable: _Variable | None
    names: tuple[str, ...]
    codes: str


class Codec:
    """Writes and reads the messages of one type.

    A layout is compiled once; writing and reading, which run in every step, are one loop each.
    """

    def __init__(self, record_class: Any, layout: Layout, nested: Callable[[str], Layout]) -> None:
        """Compile `layout`, which has header and run_id besides the fields of `record_class`.

        It may lack fields that have a default value: an earlier definition of the message. `nested` returns the layout
        of another message type by its name; its exceptions are passed on.
        """
        fields = [list(_leaves(name, kind, nested)) for name, kind in layout]
        leaves = [leaf for field in fields for leaf in field]
        self._name = record_class.__name__
        self._make = record_class._make
        self._plans = {mark: tuple(_steps(leaves, order)) for mark, order in _BYTE_ORDERS.items()}
        self._booleans = [(place, name) for place, (name, kind) in enumerate(leaves) if kind == "boolean"]
        self._nested: list[tuple[int, slice, _Nested]] = []  # last first: earlier places stay valid
        begin = 0
        for place, (field, (_, kind)) in enumerate(zip(fields, layout, strict=True)):
            if kind in _NESTED:
                self._nested.insert(0, (place, slice(begin, begin + len(field)), _NESTED[kind]))
            begin += len(field)
        own, theirs = ("header", "run_id", *record_class._fields), [name for name, _ in layout]
        self._in_message_order = itemgetter(*map(own.index, theirs))
        lacking = [name for name in own if name not in theirs]
        self._defaults = [record_class._field_defaults[name] for name in lacking]
        self._in_own_order = itemgetter(*map([*theirs, *lacking].index, own))
        self.is_complete = not lacking

    def write(self, record: NamedTuple, heading: Heading, run_id: int) -> bytes:
        """The serialized message, little-endian.

        Raises ValueError if an array has another shape than in the record or the message, or a length out of its
        limits, struct.error if a number does not fit.
        """
        values = list(self._in_message_order((heading, run_id, *record)))
        for place, _, nested in self._nested:
            values[place : place + 1] = nested.fields(values[place])
        for place, _ in self._booleans:
            values[place] = bool(values[place])
        parts: list[Any] = [_ENCAPSULATION]
        end = 0
        for packed, places, place, variable, _, _ in self._plans[LITTLE_ENDIAN]:
            numbers = values[places]
            if variable is None:
                parts.append(packed[end % _WIDEST].pack(*numbers))
                break
            name, dtype, _, alignment, size, element, width, has_length, fewest, most, _ = variable
            data = values[place].encode() + b"\0" if dtype is None else flat_array(values[place], dtype, width)
            count = len(data) // element
            if not fewest <= count <= most:
                raise ValueError(f"{name}: {count} entries, not {fewest} to {most}")
            if has_length:
                numbers.append(count)
            side_by_side = packed[end % _WIDEST]
            parts.append(side_by_side.pack(*numbers))
            end += side_by_side.size
            if count:  # an empty sequence is not aligned
                parts += (_GAPS[-end % alignment], data)
                end += -end % alignment + count * size
        return b"".join(parts)

    def read(self, data: bytes) -> Received:
        """The message as a record; its arrays are views of one copy of `data` and may be written to.

        Raises ValueError if `data` is not such a message in plain CDR of either byte order. Bytes after its last field
        are ignored, as by rclpy.
        """
        plan = self._plans.get(bytes(data[:2]))
        if plan is None:
            raise self._error(f"begins with {bytes(data[:2]).hex() or 'nothing'}, not plain CDR")
        # A copy, so that the arrays may be written to and are aligned in memory too.
        body = bytearray(memoryview(data)[len(_ENCAPSULATION) :])
        values: list[Any] = []
        available, end = len(body), 0
        for step in plan:
            side_by_side = step.packed[end % _WIDEST]
            begin, end = end, end + side_by_side.size
            if end > available:
                raise self._too_few(data, _first_beyond(step, begin, available))
            values += side_by_side.unpack_from(body, begin)
            if step.variable is None:
                break
            name, dtype, native, alignment, size, element, width, has_length, _, most, is_plain = step.variable
            count = values.pop() if has_length else most
            if count > most:
                raise self._error(f"{name}: {count} entries, more than {most}")
            if not count:
                values.append("" if dtype is None else in_rows(np.empty(0, native), width))
                continue
            begin = end + -end % alignment
            end = begin + count * size
            if end > available:
                raise self._too_few(data, name)
            if dtype is None:
                # up to its zero: as C, and so rclpy, reads it
                values.append(body[begin:end].partition(b"\0")[0].decode(errors="replace"))
                continue
            array = np.frombuffer(body, dtype, count * element, begin)
            if not is_plain:
                if dtype.kind == "b" and array.view(np.uint8).max() > 1:
                    raise self._error(f"{name}: neither true nor false")
                array = array.astype(native)
            values.append(in_rows(array, width))
        for place, name in self._booleans:
            if values[place] > 1:
                raise self._error(f"{name}: neither true nor false")
            values[place] = bool(values[place])
        for _, places, nested in self._nested:
            values[places] = (nested.make(*values[places]),)
        heading, run_id, *record = self._in_own_order(values + self._defaults)
        return Received(heading, run_id, self._make(record))

    def _too_few(self, data: bytes, field: str) -> ValueError:
        return self._error(f"{len(data)} bytes are too few for its field {field}")

    def _error(self, words: str) -> ValueError:
        return ValueError(f"no serialized {self._name}: {words}")


def offset_of_run_id(data: bytes) -> int:
    """Where run_id stands in a little-endian message that begins with header and run_id."""
    begin = len(_ENCAPSULATION)
    length_at = begin + 8  # of the frame's name, after the stamp
    at = length_at + 4 + int.from_bytes(data[length_at : length_at + 4], "little")
    return at + -(at - begin) % 8


def flat_array(value: Any, dtype: Any, width: int = 0) -> np.ndarray:
    """`value`, flat or in rows of `width` numbers, as a flat array of `dtype`; ValueError if it has another shape."""
    array = np.ascontiguousarray(value, dtype=dtype)
    if array.ndim == 1:
        return array
    if array.shape[1:] != (width,):
        raise ValueError(f"an array of shape {array.shape}; pass {f'(n, {width})' if width else 'a flat one'}")
    return array.reshape(-1)


def in_rows(flat: np.ndarray, width: int) -> np.ndarray:
    """A flat array as a record has it; left flat if its numbers are not whole rows, which the gates reject."""
    return flat.reshape(-1, width) if width and len(flat) % width == 0 else flat


def _leaves(name: str, kind: str, nested: Callable[[str], Layout]) -> Iterator[tuple[str, str]]:
    """The field itself or, if it is a message, that message's fields, recursively."""
    if kind == "string" or kind in ELEMENTS or SEQUENCE.fullmatch(kind) or ARRAY.fullmatch(kind):
        yield name, kind
    else:
        for own_name, own_kind in nested(kind):
            yield from _leaves(own_name, own_kind, nested)


def _steps(leaves: list[tuple[str, str]], order: ByteOrder) -> Iterator[_Step]:
    names: list[str] = []
    codes = ""
    for place, (name, kind) in enumerate([*leaves, ("", "")]):
        if kind in ELEMENTS:
            names.append(name)
            # A boolean is read as a byte, which may be neither 0 nor 1.
            codes += ELEMENTS[kind][0].replace("?", "B")
            continue
        if not (kind or names):
            return
        places = slice(place - len(names), place)
        variable = _variable(name, kind, order) if kind else None
        if variable is not None and variable.has_length:
            names.append(name)
            codes += _COUNT
        yield _Step(_packed(codes, order), places, place, variable, tuple(names), codes)
        names, codes = [], ""


def _variable(name: str, kind: str, order: ByteOrder) -> _Variable:
    if kind == "string":
        return _Variable(name, None, None, 1, 1, 1, 0, True, 0, _UNLIMITED, True)
    sequence, array = SEQUENCE.fullmatch(kind), ARRAY.fullmatch(kind)
    match = sequence or array
    assert match is not None  # _leaves yields nothing else
    code, element = ELEMENTS[match[1]]
    native = np.dtype(code)
    dtype, size = native.newbyteorder(order), native.itemsize
    fewest, most = (0, int(match[2] or _UNLIMITED)) if sequence else (int(match[2]),) * 2
    is_plain = dtype.isnative and dtype.kind != "b"
    width = WIDTHS.get(name, 0) if sequence else 0
    return _Variable(name, dtype, native, size, element * size, element, width, array is None, fewest, most, is_plain)


def _packed(codes: str, order: ByteOrder) -> tuple[Struct, ...]:
    return tuple(
        Struct(order + "".join(f"{gap}x{code}" for code, gap, _ in _places(codes, begin))) for begin in range(_WIDEST)
    )


def _first_beyond(step: _Step, begin: int, available: int) -> str:
    """The first field of the step's numbers that ends after the available bytes."""
    places = zip(step.names, _places(step.codes, begin), strict=True)
    return next(name for name, (_, _, end) in places if end > available)


def _places(codes: str, begin: int) -> Iterator[tuple[str, int, int]]:
    """For each number its code, the padding before it, and its end."""
    end = begin
    for code in codes:
        size = calcsize("=" + code)
        gap = -end % size
        end += gap + size
        yield code, gap, end

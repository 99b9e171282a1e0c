"""Ways to corrupt a field, by its type: values, sizes and types, with the expected result of each.

A mutation takes its decisions from a `Pick`, which returns a number below its argument: from a random generator, a
property test or a fuzzer.
"""

from __future__ import annotations

import reprlib
import struct
from collections.abc import Callable, Iterable, Iterator
from typing import Any, NamedTuple

import numpy as np

Pick = Callable[[int], int]
Change = Callable[[Any, Pick], Any]  # maps a record to another

ANY_KIND = frozenset({
    "bad_mesh", "disconnected", "doubled", "empty_fragment", "limit_exceeded", "missed_edge", "no_edge", "no_shape",
    "no_volume", "not_finite", "not_unit", "out_of_range", "retired_id", "rigid_body", "sequence_gap",
    "sequence_repeat", "size_mismatch", "unknown_id", "wrong_cut", "wrong_nodes", "wrong_type",
})  # fmt: skip
FINE: frozenset[str] = frozenset()

HUGE = (1e308, -1e308, 1.7976931348623157e308, -1e200, 1e155, 1e16)
TINY = (1e-320, -1e-320, 5e-324, 2.2250738585072014e-308, -0.0, 0.0)
LARGEST = (2**32 - 1, 2**31, 2**31 - 1)
TOO_LARGE = (2**32, 2**63 - 1, 2**64 - 1)
PLENTY = 200_000  # numbers where about a dozen are expected


class Mutation(NamedTuple):
    field: str
    what: str  # describes the change
    change: Change
    kinds: frozenset[str]  # expected kinds of the refusal; FINE: it is accepted
    names: tuple[str, ...]  # of fields, one of which starts the refusal's text
    may_pass: bool  # accepting it is correct, too
    on_the_wire: bool  # a message can express it

    @property
    def must_fail(self) -> bool:
        return bool(self.kinds) and not self.may_pass


def mutation(
    field: str,
    what: str,
    change: Change,
    kinds: str | frozenset[str],
    names: Iterable[str] = (),
    may_pass: bool = False,
    on_the_wire: bool = True,
) -> Mutation:
    """`kinds`: separated by spaces; `names` in addition to `field`."""
    kinds = frozenset(kinds.split()) if isinstance(kinds, str) else kinds
    return Mutation(field, what, change, kinds, (field, *names), may_pass, on_the_wire)


def one_of(values: tuple, pick: Pick) -> Any:
    return values[pick(len(values))]


def any_float(pick: Pick) -> float:
    """From all bit patterns."""
    return struct.unpack("<d", struct.pack("<Q", pick(2**64)))[0]


class Rules(NamedTuple):
    """Expected results of an array's mutations: kinds separated by spaces. `content` and `other` may also pass."""

    columns: int  # numbers per row
    content: str  # a different number of entries, or different ones, with a valid size
    huge: str = ""  # for floats; for indices: one that is too large for all uses
    other: str = ""  # for floats: one that is tiny; for indices: one that already occurs
    empty: str = "size_mismatch"
    empty_passes: bool = False
    names: tuple[str, ...] = ()  # fields that refusals of content may name


def _array(record: Any, field: str) -> np.ndarray:
    return np.array(getattr(record, field)).ravel()


def _with(record: Any, field: str, change: Callable[[np.ndarray], Any]) -> Any:
    return record._replace(**{field: change(_array(record, field))})


def _put(values: tuple, dtype: Any = None, all_of_them: bool = False) -> Callable[[str], Change]:
    def for_field(field: str) -> Change:
        def change(record: Any, pick: Pick) -> Any:
            array = _array(record, field).astype(dtype if dtype is not None else _array(record, field).dtype)
            array[slice(None) if all_of_them else pick(len(array))] = one_of(values, pick)
            return record._replace(**{field: array})

        return change

    return for_field


def _sizes(field: str, rules: Rules) -> Iterator[Mutation]:
    c, rows = rules.columns, rules.content
    passes = {"names": rules.names, "may_pass": True}
    if c > 1:
        yield mutation(field, "one number missing", lambda r, p: _with(r, field, lambda a: np.delete(a, p(len(a)))),
                       "size_mismatch")  # fmt: skip
        yield mutation(field, "one number more", lambda r, p: _with(r, field, lambda a: np.append(a, a[p(len(a))])),
                       "size_mismatch")  # fmt: skip
    yield mutation(field, "one row missing", lambda r, p: _with(r, field, lambda a: a[c:] if p(2) else a[:-c]), rows,
                   **passes)  # fmt: skip
    yield mutation(field, "one row more", lambda r, p: _with(r, field, lambda a: np.append(a, a[-c:])), rows, **passes)
    yield mutation(field, "all rows twice", lambda r, p: _with(r, field, lambda a: np.tile(a, 2)), rows, **passes)
    yield mutation(field, "empty", lambda r, p: _with(r, field, lambda a: a[:0]), rules.empty, rules.names,
                   rules.empty_passes)  # fmt: skip
    yield mutation(field, "huge", lambda r, p: _with(r, field, lambda a: np.resize(a, c * (PLENTY // c))), rows,
                   **passes)  # fmt: skip
    yield mutation(field, "rows in another order", lambda r, p: _with(r, field, lambda a: _turned(a, c, p)), rows,
                   **passes)  # fmt: skip


def _turned(array: np.ndarray, columns: int, pick: Pick) -> np.ndarray:
    rows = array.reshape(-1, columns)
    return np.roll(rows, 1 + pick(max(len(rows) - 1, 1)), axis=0).ravel()


def _types(field: str, integers: bool) -> Iterator[Mutation]:
    """Values that exist only in Python, not in a message."""
    wrong = (
        ("nothing", None), ("text", "abc"), ("texts", ["a", "b", "c"]), ("a ragged list", [[0.0, 1.0], [2.0]]),
        ("objects", [None, None, None]), ("complex numbers", np.full(12, 1j)), ("truth", np.ones(12, bool)),
        ("dates", np.zeros(12, "datetime64[s]")), ("a mapping", {"x": 1.0}), ("bytes", b"\0" * 96),
        ("a record array", np.zeros(3, [("x", "f8"), ("y", "f8")])), ("integers beyond 64 bits", [2**70, 1, 2, 3]),
    )  # fmt: skip
    for what, value in wrong:
        yield mutation(
            field, what, lambda r, p, v=value: r._replace(**{field: v}), "wrong_type", on_the_wire=False
        )
    if integers:
        yield mutation(field, "floats", lambda r, p: _with(r, field, lambda a: a.astype(float)), "wrong_type",
                       on_the_wire=False)  # fmt: skip
    for what, change in (
        ("a list", lambda a: a.tolist()), ("two dimensions", lambda a: a.reshape(-1, 1)),
        ("a strided view", lambda a: np.repeat(a, 2)[::2]),
        ("big-endian", lambda a: a.astype(a.dtype.newbyteorder(">"))),
    ):  # fmt: skip
        yield mutation(field, what, lambda r, p, change=change: _with(r, field, change), FINE, on_the_wire=False)


def float_mutations(field: str, rules: Rules) -> list[Mutation]:
    def other(record: Any, pick: Pick) -> Any:
        return _put((any_float(pick),))(field)(record, pick)

    names, huge_passes = rules.names, not rules.huge
    return [
        mutation(field, "an entry is NaN", _put((np.nan, -np.nan))(field), "not_finite"),
        mutation(field, "an entry is infinite", _put((np.inf, -np.inf))(field), "not_finite"),
        mutation(field, "all are NaN", _put((np.nan,), all_of_them=True)(field), "not_finite"),
        mutation(field, "an entry is huge", _put(HUGE)(field), rules.huge, names, huge_passes),
        mutation(field, "all are huge", _put(HUGE, all_of_them=True)(field), rules.huge, names, huge_passes),
        mutation(field, "an entry is tiny", _put(TINY)(field), rules.other, names, True),
        mutation(field, "all are tiny", _put(TINY, all_of_them=True)(field), rules.other or FINE, names, True),
        mutation(field, "an entry is any float", other, f"not_finite {rules.huge} {rules.other}", names, True),
        mutation(field, "an entry beyond doubles",
                 lambda r, p: _with(r, field, lambda a: _long_double(a, p)), "not_finite", on_the_wire=False),
        *_sizes(field, rules), *_types(field, integers=False),
    ]  # fmt: skip


def _long_double(array: np.ndarray, pick: Pick) -> np.ndarray:
    longer = array.astype(np.longdouble)
    longer[pick(len(longer))] = np.ldexp(np.longdouble(1.0), 5000)
    return longer


def index_mutations(field: str, rules: Rules) -> list[Mutation]:
    def copied(record: Any, pick: Pick) -> Any:
        array = _array(record, field)
        array[pick(len(array))] = array[pick(len(array))]
        return record._replace(**{field: array})

    def near(record: Any, pick: Pick) -> Any:
        array = _array(record, field)
        array[pick(len(array))] = pick(2 * len(array) + 4)
        return record._replace(**{field: array})

    names = rules.names
    return [
        mutation(field, "an index is huge", _put(LARGEST, np.int64)(field), rules.huge, names, not rules.huge),
        mutation(field, "all are huge", _put(LARGEST, np.int64, True)(field), f"{rules.huge} {rules.other}", names),
        mutation(field, "an index is another's", copied, rules.other, names, True),
        mutation(field, "all are the same", lambda r, p: _with(r, field, lambda a: np.full_like(a, a[p(len(a))])),
                 rules.other, names, True),
        mutation(field, "an index is any small one", near, f"{rules.huge} {rules.other} {rules.content}", names, True),
        mutation(field, "an index beyond 32 bits", _put(TOO_LARGE, np.uint64)(field), "out_of_range",
                 on_the_wire=False),
        mutation(field, "an index is negative", _put((-1, -(2**31), -(2**63)), np.int64)(field), "out_of_range",
                 on_the_wire=False),
        *_sizes(field, rules), *_types(field, integers=True),
    ]  # fmt: skip


def value_mutations(
    field: str, values: tuple, kinds: str, names: Iterable[str] = (), what: str = "", may_pass: bool = False
) -> list[Mutation]:
    """A scalar field with one of `values`, all of which a message can express."""
    what = what or f"is one of {reprlib.repr(values)}"
    change = lambda record, pick: record._replace(**{field: one_of(values, pick)})  # noqa: E731
    return [mutation(field, what, change, kinds, names, may_pass)]


def scalar_type_mutations(field: str, values: tuple, kinds: str = "wrong_type") -> list[Mutation]:
    """Values that no message can express."""
    return [
        mutation(field, f"is {value!r}", lambda r, p, v=value: r._replace(**{field: v}), kinds, on_the_wire=False)
        for value in values
    ]


def identifier_type_mutations(field: str, bits: int) -> list[Mutation]:
    return [
        *scalar_type_mutations(field, (None, 1.0, "1", True, np.nan, [1], np.zeros(1), np.float64(1), b"1", {})),
        *scalar_type_mutations(field, (-1, 2**bits, 2**70, -(2**70)), "out_of_range"),
    ]

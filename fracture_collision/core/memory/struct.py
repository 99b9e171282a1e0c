"""Structures that kernels take by reference: one pointer, however many arrays they have.

numba passes a NamedTuple by value: each array of it as seven numbers or more, in every call between kernels, and so it
reads it from Python. The arrays of a world are some five hundred numbers. Compiling calls that carry them took half of
the compile time, and reading them 30 us a step.

A Struct keeps the same numbers in a block of memory that is written once. A kernel takes its address and loads what it
uses: attributes are written as those of a NamedTuple, and a field may be an array, a number, a Struct, or a tuple of
these. Kernels write to the arrays, never to the fields, and make no Structs; so loads need not be repeated.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from llvmlite import ir
from numba import typeof, types
from numba.core import cgutils
from numba.core.imputils import lower_getattr_generic
from numba.core.typing.templates import AttributeTemplate, infer_getattr
from numba.extending import NativeValue, models, register_model, unbox

if TYPE_CHECKING:
    from typing_extensions import dataclass_transform
else:

    def dataclass_transform(**_: bool) -> Any:
        """Only type checkers read it."""
        return lambda decorated: decorated


WORD = ir.IntType(64)
ADDRESS = WORD.as_pointer()
# Words of an array before its shape and strides: number of items, address.
BEFORE_SHAPE = 2
# numba takes some 50 us to find a type, and each event changes some dozen structures.
_types_of_arrays: dict[tuple, types.Type] = {}
_types_of_numbers: dict[type, types.Type] = {}
_struct_types: dict[tuple, StructType] = {}
_by_members: dict[tuple, StructType] = {}
_kept: list[tuple] = []


@dataclass_transform(eq_default=False, frozen_default=True)
class Struct:
    """Base of structures that kernels take by reference; fields are declared as those of a NamedTuple."""

    def __init_subclass__(cls) -> None:
        dataclass(frozen=True, eq=False)(cls)
        cls._fields = tuple(field.name for field in fields(cls))  # type: ignore[arg-type, attr-defined]

    @cached_property
    def _numba_type_(self) -> StructType:
        names = type(self)._fields  # type: ignore[attr-defined]
        return _struct_type(type(self), tuple((name, _type_of(getattr(self, name))) for name in names))

    @cached_property
    def _block(self) -> np.ndarray:
        words: list[int] = []
        for name, kind in self._numba_type_.members:
            _put_words(kind, getattr(self, name), words)
        return np.array(words, np.int64)

    @cached_property
    def _address(self) -> int:
        return int(self._block.ctypes.data)


class StructType(types.Type):
    """numba's type of a Struct: its class, and the types of its fields."""

    def __init__(self, of: type, members: tuple[tuple[str, types.Type], ...]) -> None:
        """Raises TypeError if a field cannot be kept in words."""
        for name, kind in members:
            if not _is_words(kind):
                raise TypeError(f"{of.__name__}.{name}: a field of a Struct can't be of type {kind}")
        self.of, self.members = of, members
        # part of the names of compiled functions, which a list of all members would make very long
        digest = hashlib.sha256(repr(members).encode()).hexdigest()[:12]
        super().__init__(f"{of.__module__}.{of.__qualname__}.{digest}")

    def place_of(self, name: str) -> tuple[types.Type, int] | None:
        """Type and first word of a field; None: there is no such field."""
        at = 0
        for member, kind in self.members:
            if member == name:
                return kind, at
            at += _words_of(kind)
        return None


def _struct_type(of: type, members: tuple[tuple[str, types.Type], ...]) -> StructType:
    """The only one of its kind. Known by its members' identities, which are quicker than numba's hashes."""
    key = (of, *(id(kind) for _, kind in members))
    found = _struct_types.get(key)
    if found is None:
        found = _by_members.setdefault((of, members), StructType(of, members))
        _struct_types[key] = found
        _kept.append(members)  # or the identities might be given to others
    return found


def _type_of(value: Any) -> types.Type:
    if isinstance(value, Struct):
        return value._numba_type_
    if isinstance(value, (bool, int, float)):
        if type(value) not in _types_of_numbers:
            _types_of_numbers[type(value)] = typeof(value)
        return _types_of_numbers[type(value)]
    if not isinstance(value, np.ndarray):
        return typeof(value)
    key = value.dtype, value.ndim, value.flags.num
    if key not in _types_of_arrays:
        _types_of_arrays[key] = typeof(value)
    return _types_of_arrays[key]


def _is_words(kind: types.Type) -> bool:
    if isinstance(kind, types.BaseTuple):
        return all(map(_is_words, kind))
    return isinstance(kind, (types.Array, StructType, types.Integer, types.Boolean)) or kind == types.float64


def _words_of(kind: types.Type) -> int:
    if isinstance(kind, types.Array):
        return BEFORE_SHAPE + 2 * kind.ndim
    return sum(map(_words_of, kind)) if isinstance(kind, types.BaseTuple) else 1


def _put_words(kind: types.Type, value: Any, words: list[int]) -> None:
    if isinstance(kind, types.Array):
        words += [value.size, value.__array_interface__["data"][0], *value.shape, *value.strides]
    elif isinstance(kind, types.BaseTuple):
        for each, part in zip(kind, value, strict=True):
            _put_words(each, part, words)
    elif isinstance(kind, StructType):
        words.append(value._address)
    elif isinstance(kind, types.Float):
        words.append(int(np.float64(value).view(np.int64)))
    else:
        words.append(int(value))


@register_model(StructType)
class _StructModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: StructType) -> None:
        super().__init__(manager, kind, ADDRESS)


@infer_getattr
class _StructAttributes(AttributeTemplate):
    key = StructType

    def generic_resolve(self, kind: StructType, name: str) -> types.Type | None:
        place = kind.place_of(name)
        return None if place is None else place[0]


@lower_getattr_generic(StructType)
def _load_field(context: Any, builder: Any, kind: StructType, value: Any, name: str) -> Any:
    place = kind.place_of(name)
    assert place is not None
    return _load(context, builder, value, *place)


def _load(context: Any, builder: Any, block: Any, kind: types.Type, at: int) -> Any:
    if isinstance(kind, types.Array):
        array, dims = context.make_array(kind)(context, builder), at + BEFORE_SHAPE
        array.meminfo = cgutils.get_null_value(array.meminfo.type)
        array.parent = cgutils.get_null_value(array.parent.type)
        array.itemsize = ir.Constant(WORD, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
        array.nitems = _load_word(builder, block, at)
        array.data = builder.inttoptr(_load_word(builder, block, at + 1), array.data.type)
        array.shape, array.strides = (
            cgutils.pack_array(builder, [_load_word(builder, block, first + k) for k in range(kind.ndim)])
            for first in (dims, dims + kind.ndim)
        )
        return array._getvalue()
    if isinstance(kind, types.BaseTuple):
        parts = []
        for each in kind:
            parts.append(_load(context, builder, block, each, at))
            at += _words_of(each)
        return context.make_tuple(builder, kind, parts)
    word = _load_word(builder, block, at)
    if isinstance(kind, StructType):
        return builder.inttoptr(word, ADDRESS)
    if isinstance(kind, types.Float):
        return builder.bitcast(word, context.get_value_type(kind))
    value_type = context.get_value_type(kind)
    return word if value_type == WORD else builder.trunc(word, value_type)


def _load_word(builder: Any, block: Any, at: int) -> Any:
    word = builder.load(builder.gep(block, [ir.Constant(ir.IntType(32), at)], inbounds=True))
    word.set_metadata("invariant.load", builder.module.add_metadata([]))
    return word


@unbox(StructType)
def _address_of(kind: StructType, value: Any, c: Any) -> NativeValue:
    attribute = c.pyapi.object_getattr_string(value, "_address")
    address = c.pyapi.long_as_longlong(attribute)
    c.pyapi.decref(attribute)
    return NativeValue(c.builder.inttoptr(address, ADDRESS), is_error=c.pyapi.c_api_error())

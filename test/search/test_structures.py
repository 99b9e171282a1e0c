"""Structures that kernels take by reference, and the tables behind them."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
import pytest

from fracture_collision.core.memory.compiled import kernel
from fracture_collision.core.memory.struct import Struct
from fracture_collision.core.memory.tables import Column, Moves, Table, check_references, moves_of


class Inner(Struct):
    """Within another."""

    words: np.ndarray


class Pair(NamedTuple):
    """By value within a structure."""

    left: np.ndarray
    share: float


class Outer(Struct):
    """All kinds of fields."""

    cube: np.ndarray
    flags: np.ndarray
    size: float
    count: int
    is_new: bool
    pair: Pair
    inner: Inner


@kernel
def read(given, k):
    total = given.cube[k, 1, 2] + given.size + given.count + given.pair.left[k] * given.pair.share
    if given.is_new and given.flags[k]:
        total += given.inner.words[k] + len(given.inner.words) + given.cube.shape[2]
    given.inner.words[k] += 1
    return total


def test_a_kernel_reads_each_kind_of_field_and_writes_to_arrays() -> None:
    random = np.random.default_rng(1)
    for flag in (True, False):
        given = Outer(
            random.normal(size=(4, 2, 3)), np.array([True, False, True, True]), 0.25, -7, flag,
            Pair(random.integers(0, 9, 4).astype(np.int32), 1.5), Inner(np.arange(4, dtype=np.uint8)),
        )  # fmt: skip
        for k in range(4):
            expected = read.py_func(given, k)
            given.inner.words[k] -= 1
            assert read(given, k) == expected
        assert given.inner.words.tolist() == [1, 2, 3, 4]


def test_a_structure_is_not_changed_and_knows_its_fields() -> None:
    given = Inner(np.zeros(2))
    with pytest.raises(AttributeError):
        given.words = np.ones(2)
    with pytest.raises(TypeError, match="can't be of type"):
        read(Outer(*[np.zeros((1, 2, 3))] * 2, 0.0, 0, "new", Pair(np.zeros(1), 0.0), given), 0)


class Bodies(NamedTuple):
    """A table within one; some corners of a body."""

    first: Annotated[np.ndarray, Column("body", np.int32, 2, "corner")]  # and the end


class Shared(Struct):
    """Corners, and what refers to them."""

    places: Annotated[np.ndarray, Column("corner", np.float64, 3)]
    next_one: Annotated[np.ndarray, Column("corner", np.int32, 0, "corner")]  # -1: none
    bits: Annotated[np.ndarray, Column("corner", np.uint64, seen_in="places_bits")]
    places_bits: Annotated[np.ndarray, Column("corner", np.float64)]
    bodies: Bodies


def test_rows_that_nothing_refers_to_go_and_references_stay_true() -> None:
    random, table = np.random.default_rng(2), Table(Shared)
    for _ in range(20):
        begin, count = table["places"].used, int(random.integers(1, 6))
        table["places"].append(random.normal(size=(count, 3)))
        table["places_bits"].append(random.normal(size=count))
        table["next_one"].append(np.append(np.arange(begin + 1, begin + count), -1))
        table.tables["bodies"]["first"].append(np.array([[begin, begin + count]]))
    before = table.view
    assert table.view is before and before.bits.tobytes() == before.places_bits.tobytes()
    chains = [before.places[slice(*row)].copy() for row in before.bodies.first]
    check_references(table)
    kept = random.random(20) < 0.5
    stays = np.repeat(kept, [len(chain) for chain in chains])
    moves: dict[str, Moves] = {"body": moves_of(kept), "corner": moves_of(stays)}
    size = table.bytes_used
    table.move(moves)
    check_references(table)
    assert table.view is not before and table.bytes_used < size
    after = table.view
    for row, chain in zip(after.bodies.first, [c for c, k in zip(chains, kept, strict=True) if k], strict=True):
        at, found = int(row[0]), []
        while at >= 0:
            found.append(after.places[at])
            at = int(after.next_one[at])
        np.testing.assert_array_equal(found, chain)
    table["next_one"].view[0] = len(after.places) + 1
    with pytest.raises(AssertionError, match="that there is not"):
        check_references(table)

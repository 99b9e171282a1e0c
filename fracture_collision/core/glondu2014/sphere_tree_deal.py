"""The entries of a broken fragment's sphere tree that each new fragment keeps: Glondu 2014, section 6.2, the splitting.

A node with descendants in several fragments is replicated once for each; a copy with a single child is omitted. A
preorder tree stays one when entries are removed, so one walk over the old tree deals its entries out to all fragments;
a subtree of one fragment is copied in one run.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fracture_collision.core.glondu2014.paper_pools import SIZE
from fracture_collision.core.memory.compiled import kernel, query_kernel

BATCH = 64  # fragments per walk: one bit each of an unsigned 64-bit mask
UNKNOWN, MIXED = -2, -1
NOBODYS = -1  # of an entry whose point no fragment keeps
# The position of a lone bit, by the top six bits of its product with a de Bruijn sequence (Leiserson, Prokop, Randall,
# "Using de Bruijn Sequences to Index a 1 in a Computer Word", 1998).
DE_BRUIJN = np.uint64(0x03F79D71B4CB0A89)
BIT_POSITION = np.zeros(64, np.int64)
BIT_POSITION[[((0x03F79D71B4CB0A89 << b) & 0xFFFFFFFFFFFFFFFF) >> 58 for b in range(64)]] = np.arange(64)


class Deal(NamedTuple):
    """The part of a tree that each fragment keeps: fragment f has rows first[f] .. last[f] - 1 of `kept` and `size`."""

    kept: np.ndarray  # (k,) int32 entries of the old tree, ascending
    size: np.ndarray  # (k,) int32 their sizes in the fragment's tree
    first: np.ndarray  # (fragments,) int64
    last: np.ndarray  # (fragments,) int64


class _Walk(NamedTuple):
    """Working space for the walk over the old tree."""

    size: np.ndarray  # (n,) int32
    parent: np.ndarray  # (n,) int32
    owner: np.ndarray  # (n,) int32: the fragment that has all points of the subtree, else MIXED
    once: np.ndarray  # (n,) uint64: fragments with points in the subtree, a bit each
    twice: np.ndarray  # (n,) uint64: fragments with points below two or more children, a bit each
    open_row: np.ndarray  # (2n,) int32, stack of open entries: row in `kept`,
    open_fragment: np.ndarray  # (2n,) int32: its fragment,
    open_end: np.ndarray  # (2n,) int32: where its subtree ends in the old tree


@query_kernel
def find_parents(size, parent):
    """Fill parent (n,) from size (n,): -1 for the root."""
    parent[0] = -1
    for i in range(len(size)):
        child = i + 1
        while child < i + size[i]:
            parent[child] = i
            child += size[child]


@kernel
def deal_tree(entries, fragment_of_entry, fragments):
    """The entries that each fragment keeps: those with its points below two or more children, and its leaves."""
    n = len(entries)
    walk = _Walk(
        np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.int32), np.empty(n, np.uint64),
        np.empty(n, np.uint64), np.empty(2 * n, np.int32), np.empty(2 * n, np.int32), np.empty(2 * n, np.int32),
    )  # fmt: skip
    deal = Deal(
        np.empty(2 * n, np.int32), np.empty(2 * n, np.int32), np.zeros(fragments, np.int64),
        np.zeros(fragments, np.int64),
    )  # fmt: skip
    _find_owners(entries, fragment_of_entry, walk, deal)
    for low in range(0, fragments, BATCH):
        _find_presence(fragment_of_entry, low, walk)
        _deal_out(low, walk, deal)
    return deal


@query_kernel
def _find_owners(entries, fragment_of_entry, walk, deal):
    size, parent, owner, first = walk.size, walk.parent, walk.owner, deal.first
    for i in range(len(size)):
        is_leaf = entries[i, SIZE] == 1
        f = fragment_of_entry[i]
        if is_leaf and f != NOBODYS:
            first[f] += 1
        # a point that no fragment keeps makes its ancestors MIXED
        size[i], owner[i] = entries[i, SIZE], f if is_leaf else UNKNOWN
    # capacity for a fragment's leaves and its inner nodes, which are fewer
    room = 0
    for f in range(len(first)):
        leaves = first[f]
        first[f] = deal.last[f] = room
        room += 2 * leaves
    find_parents(size, parent)
    for i in range(len(size) - 1, 0, -1):
        own, so_far = owner[i], owner[parent[i]]
        owner[parent[i]] = own if so_far == UNKNOWN else so_far if so_far == own else MIXED


@query_kernel
def _deal_out(low, walk, deal):
    """One walk over the tree for fragments low .. low + 63."""
    size, owner, kept, new_size, last = walk.size, walk.owner, deal.kept, deal.size, deal.last
    n, i, depth = len(size), 0, 0
    while True:
        while depth and walk.open_end[depth - 1] <= i:
            depth -= 1
            row = walk.open_row[depth]
            new_size[row] = last[walk.open_fragment[depth]] - row
        if i == n:
            return
        f, behind = owner[i], i + size[i]
        if f >= 0:
            # the whole subtree belongs to one fragment
            if low <= f < low + BATCH:
                shift = last[f] - i
                for j in range(i, behind):
                    kept[j + shift], new_size[j + shift] = j, size[j]
                last[f] = behind + shift
            i = behind
        elif walk.once[i] == 0:
            i = behind
        else:
            bits = walk.twice[i]
            while bits:
                bit = bits & (~bits + np.uint64(1))
                f = low + BIT_POSITION[(bit * DE_BRUIJN) >> np.uint64(58)]
                walk.open_row[depth], walk.open_fragment[depth], walk.open_end[depth] = last[f], f, behind
                kept[last[f]] = i
                last[f] += 1
                depth += 1
                bits ^= bit
            i += 1


@query_kernel
def _find_presence(fragment_of_entry, low, walk):
    """Find which fragments low .. low + 63 each entry's subtree holds, and which at least two of its children hold."""
    size, parent, once, twice = walk.size, walk.parent, walk.once, walk.twice
    one = np.uint64(1)
    for i in range(len(size)):
        once[i], twice[i] = 0, 0
    for i in range(len(size) - 1, -1, -1):
        k = fragment_of_entry[i] - low
        if size[i] == 1 and 0 <= k < BATCH:
            once[i] = one << np.uint64(k)
        if i:
            p = parent[i]
            twice[p] |= once[p] & once[i]
            once[p] |= once[i]

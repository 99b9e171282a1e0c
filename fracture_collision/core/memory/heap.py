"""A binary min-heap in two arrays: keys, and the items that they belong to."""

from __future__ import annotations

from fracture_collision.core.memory.compiled import query_kernel


@query_kernel
def push(keys, items, count, key, item):
    """Add an entry to a heap of `count` entries."""
    i = count
    while i > 0:
        parent = (i - 1) >> 1
        if keys[parent] <= key:
            break
        keys[i], items[i] = keys[parent], items[parent]
        i = parent
    keys[i], items[i] = key, item


@query_kernel
def pop(keys, items, count):
    """Remove the root of a heap of `count` entries; the caller reads it first."""
    last = count - 1
    key, item = keys[last], items[last]
    i = 0
    while True:
        child = 2 * i + 1
        if child >= last:
            break
        if child + 1 < last and keys[child + 1] < keys[child]:
            child += 1
        if keys[child] >= key:
            break
        keys[i], items[i] = keys[child], items[child]
        i = child
    keys[i], items[i] = key, item

"""Sorting of contact rows by sample or by depth; ties are broken by side and sample.

For the order by depth, the first rows form a heap whose root comes last.
"""

from __future__ import annotations

from fracture_collision.core.contacts.known_samples import ID_SAMPLE, ID_SIDE
from fracture_collision.core.memory.compiled import query_kernel

GAP = 9  # column of contacts


@query_kernel
def _is_before(row, row_ids, other, other_ids):
    if row[GAP] != other[GAP]:
        return row[GAP] < other[GAP]
    if row_ids[ID_SIDE] != other_ids[ID_SIDE]:
        return row_ids[ID_SIDE] < other_ids[ID_SIDE]
    return row_ids[ID_SAMPLE] < other_ids[ID_SAMPLE]


@query_kernel
def swap_contacts(contacts, ids, i, j):
    """Swap rows i and j of contacts and ids, see Sink."""
    for c in range(contacts.shape[1]):
        contacts[i, c], contacts[j, c] = contacts[j, c], contacts[i, c]
    for c in range(ids.shape[1]):
        ids[i, c], ids[j, c] = ids[j, c], ids[i, c]


@query_kernel
def copy_contact(source, k, sink, c):
    """Copy row k of a Sink, or of Results, to row c of a Sink."""
    for column in range(sink.contacts.shape[1]):
        sink.contacts[c, column] = source.contacts[k, column]
    for column in range(sink.ids.shape[1]):
        sink.ids[c, column] = source.ids[k, column]


@query_kernel
def _sift(contacts, ids, root, end):
    """Sink row `root` to its place in the heap of rows 0 .. end - 1."""
    while 2 * root + 1 < end:
        child = 2 * root + 1
        if child + 1 < end and _is_before(contacts[child], ids[child], contacts[child + 1], ids[child + 1]):
            child += 1
        if not _is_before(contacts[root], ids[root], contacts[child], ids[child]):
            return
        swap_contacts(contacts, ids, root, child)
        root = child


@query_kernel
def make_heap(contacts, ids, count):
    """Make rows 0 .. count - 1 a heap."""
    for root in range(count // 2 - 1, -1, -1):
        _sift(contacts, ids, root, count)


@query_kernel
def sort_heap(contacts, ids, count):
    """Sort rows 0 .. count - 1, a heap, by depth, deepest first."""
    for end in range(count - 1, 0, -1):
        swap_contacts(contacts, ids, 0, end)
        _sift(contacts, ids, 0, end)


@query_kernel
def sort_by_sample(contacts, ids, count):
    """Sort the first `count` rows by side and sample; insertion sort, for few rows."""
    for i in range(1, count):
        k = i
        while k > 0 and (ids[k - 1, ID_SIDE], ids[k - 1, ID_SAMPLE]) > (ids[k, ID_SIDE], ids[k, ID_SAMPLE]):
            swap_contacts(contacts, ids, k - 1, k)
            k -= 1

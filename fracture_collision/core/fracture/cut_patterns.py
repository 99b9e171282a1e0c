"""Tables of how a tetrahedron is divided, indexed by its cut edges: one per query, so that the passes are branchless.

*Points* are numbered as in cut_tetrahedron.py. A *pattern* groups the nodes by fragment: there are fifteen, numbered by
PATTERN_OF_CUTS. A *side* is a bit mask of the nodes of the first of two fragments.
"""

from __future__ import annotations

import numpy as np

from fracture_collision.core.mesh.cut_tetrahedron import (
    CROSSING,
    EDGE_BETWEEN,
    EDGE_FIRST,
    EDGE_SECOND,
    FACE_POINT,
    FACE_VERTICES,
)

# Pattern of a tetrahedron owned by one fragment; and of impossible combinations of cuts.
WHOLE, NO_PATTERN = 0, 255


def _crossing(i: int, j: int) -> int:
    return CROSSING + int(EDGE_BETWEEN[i, j])


def _lone_first(group: tuple[int, ...], face: int) -> tuple[int, tuple[int, int, int]]:
    """(number of fragments in the face, its nodes): counter-clockwise from outside; with two, the lone node first."""
    i, j, k = FACE_VERTICES[face].tolist()
    a, b, c = group[i], group[j], group[k]
    if a == c and a != b:
        i, j, k = j, k, i
    elif a == b and a != c:
        i, j, k = k, i, j
    return len({a, b, c}), (i, j, k)


def _sector(fragments: int, face: int, i: int, j: int, k: int) -> list[tuple[int, ...]]:
    """(a, b, c, node): the parts (hub, a, b, c) between hub and face, each owned by the fragment of its node."""
    if fragments == 1:
        return [(i, j, k, i)]
    ij, jk, ik, m = _crossing(i, j), _crossing(j, k), _crossing(i, k), FACE_POINT + face
    if fragments == 2:
        return [(i, ij, ik, i), (ij, j, k, j), (ij, k, ik, j)]
    return [(i, ij, m, i), (i, m, ik, i), (j, jk, m, j), (j, m, ij, j), (k, ik, m, k), (k, m, jk, k)]


def _fan(fragments: int, face: int, i: int, j: int, k: int) -> list[tuple[int, ...]]:
    """(b, c, samples, node, node, face): the triangles (hub, b, c) between the fragments of two nodes.

    The last `samples` corners are samples.
    """
    ij, jk, ik, m = _crossing(i, j), _crossing(j, k), _crossing(i, k), FACE_POINT + face
    if fragments == 2:
        return [(ik, ij, 2, i, j, face)]
    if fragments == 3:
        return [(m, ij, 1, i, j, face), (m, jk, 1, j, k, face), (m, ik, 1, k, i, face)]
    return []


def _pieces(fragments: int, face: int, i: int, j: int, k: int) -> list[tuple[int, ...]]:
    """(a, b, c, samples, node): the fragments' shares of the face."""
    ij, jk, ik, m = _crossing(i, j), _crossing(j, k), _crossing(i, k), FACE_POINT + face
    if fragments == 1:
        return [(i, j, k, 3, i)]
    if fragments == 2:
        return [(i, ij, ik, 3, i), (ij, j, k, 3, j), (ij, k, ik, 3, j)]
    return [(m, i, ij, 2, i), (m, ik, i, 2, i), (m, j, jk, 2, j), (m, ij, j, 2, j), (m, k, ik, 2, k), (m, jk, k, 2, k)]


def _section(side: int) -> tuple[list[tuple[int, ...]], list[tuple[int, ...]], int]:
    """Section of a tetrahedron by one plane; its nodes in `side` belong to the first of two fragments.

    Returns the section's triangles, right-handed about the normal out of the part that the solids add up to; these
    solids; and the owner of that part, 0 for the first fragment or 1 for the second.
    """
    own = [i for i in range(4) if side >> i & 1]
    others = [i for i in range(4) if not side >> i & 1]
    if len(own) == 2:
        (a, b), (c, d) = own, others
        ac, ad, bc, bd = _crossing(a, c), _crossing(a, d), _crossing(b, c), _crossing(b, d)
        # the orientation follows from the order of the nodes: a tetrahedron has positive volume
        q, s = (bc, ad) if (a + b) % 2 == 0 else (ad, bc)
        return [(ac, q, bd), (ac, bd, s)], [(a, ac, ad, b), (ac, ad, b, bc), (ad, b, bc, bd)], 0
    lone = own[0] if len(own) == 1 else others[0]
    p, q, r = (_crossing(lone, int(f)) for f in FACE_VERTICES[lone])
    return [(p, q, r)], [(lone, p, q, r)], 0 if len(own) == 1 else 1


def _table(rows: list[list[tuple[int, ...]]], shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Pack lists of different lengths into one array; also returns their lengths."""
    table = np.zeros((len(rows), *shape), np.uint8)
    for i, row in enumerate(rows):
        if row:
            table[i, : len(row)] = row
    return table, np.array([len(row) for row in rows])


def _cuts(group: tuple[int, ...]) -> list[int]:
    return [e for e in range(6) if group[EDGE_FIRST[e]] != group[EDGE_SECOND[e]]]


# For each pattern, by node: the smallest node of the same fragment. All patterns, WHOLE first.
_GROUPS = [(0, b, c, d) for b in (0, 1) for c in sorted({0, b, 2}) for d in sorted({0, b, c, 3})]
_FACES = [[_lone_first(group, face) for face in range(4)] for group in _GROUPS]
GROUP = np.array(_GROUPS)
GROUPS = np.array([len(set(group)) for group in _GROUPS])
CUT_EDGES, CUT_COUNT = _table([[(e,) for e in _cuts(group)] for group in _GROUPS], (6, 1))
CUT_EDGES = np.ascontiguousarray(CUT_EDGES[:, :, 0])
PATTERN_OF_CUTS = np.full(64, NO_PATTERN, np.uint8)
PATTERN_OF_CUTS[[sum(1 << e for e in _cuts(group)) for group in _GROUPS]] = np.arange(len(_GROUPS))

PARTS, PART_COUNT = _table(
    [[part for face, (n, v) in enumerate(faces) for part in _sector(n, face, *v)] for faces in _FACES], (24, 4)
)
FAN, FAN_COUNT = _table(
    [[row for face, (n, v) in enumerate(faces) for row in _fan(n, face, *v)] for faces in _FACES], (12, 6)
)
FACE_NODES = np.array([[v for _, v in faces] for faces in _FACES])
_PIECES = [_table([_pieces(n, face, *v) for face, (n, v) in enumerate(faces)], (6, 5)) for faces in _FACES]
PIECES, PIECE_COUNT = (np.array(column) for column in zip(*_PIECES, strict=True))

_SIDES = [_section(side) if 0 < side < 15 else ([], [], 0) for side in range(16)]
SECTION, SECTION_COUNT = _table([section for section, _, _ in _SIDES], (2, 3))
SOLIDS, SOLID_COUNT = _table([solids for _, solids, _ in _SIDES], (3, 4))
PART_OF_SIDE = np.array([part for _, _, part in _SIDES])
PATTERN_OF_SIDE = PATTERN_OF_CUTS[
    [sum(1 << e for e in range(6) if (side >> EDGE_FIRST[e] ^ side >> EDGE_SECOND[e]) & 1) for side in range(16)]
]

"""What the users of the page hold with the mouse, and which piece they hold when it breaks.

A browser ends a drag when the node under the mouse disappears. So the node of a held fragment that breaks stays, too
small to be seen, and moves with the piece at the grip: the user keeps hold of that, as the simulator's hand does.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
import viser

UNSEEN = 1e-6  # scale of a node


class _Grip(NamedTuple):
    node: viser.GlbHandle
    place: np.ndarray  # (3,) [m] in the body's frame
    body_id: int


class Piece(NamedTuple):
    """A fragment that may take the place of the one that broke."""

    fragment_id: int
    body_id: int
    corners: np.ndarray  # (n, 3) [m] of its surface, in the body's frame


class Grips:
    """By fragment; the browsers' events and the page's frames may come from two threads."""

    def __init__(self) -> None:
        self._grips: dict[int, _Grip] = {}
        self._heirs: dict[int, int] = {}  # piece held instead of a broken fragment

    def take(self, fragment_id: int, node: viser.GlbHandle, place: np.ndarray, body_id: int) -> None:
        """A user has taken hold of a fragment at `place` (3,) [m] of its body's frame."""
        self._grips[fragment_id] = _Grip(node, place, body_id)

    def release(self, fragment_id: int) -> None:
        """The user has let go."""
        grip = self._grips.pop(fragment_id, None)
        if self._heirs.pop(fragment_id, None) is not None and grip is not None:
            grip.node.visible = False
            grip.node.scale = 1.0

    def keep(self, fragment_id: int, pieces: Iterable[Piece]) -> bool:
        """A fragment has gone; returns whether its node stays, as it is held and has broken into some of `pieces`."""
        grip = self._grips.get(fragment_id)
        if grip is None or (heir := self._nearest(grip, pieces)) is None:
            return False
        self._heirs[fragment_id] = heir
        grip.node.scale = UNSEEN
        return True

    def followers(self, poses: dict[int, np.ndarray], pieces: Iterable[Piece]) -> list[tuple[str, np.ndarray]]:
        """The nodes that stayed, by name, and where they are now."""
        placed = []
        for fragment_id, heir in list(self._heirs.items()):
            grip = self._grips.get(fragment_id)
            if grip is None:
                continue
            if heir not in poses:  # it has broken, too
                next_heir = self._nearest(grip, pieces)
                if next_heir is None:
                    continue
                heir = self._heirs[fragment_id] = next_heir
            placed.append((grip.node.name, poses[heir]))
        return placed

    def _nearest(self, grip: _Grip, pieces: Iterable[Piece]) -> int | None:
        distances = {
            piece.fragment_id: float(np.min(np.sum((piece.corners - grip.place) ** 2, axis=1)))
            for piece in pieces
            if piece.body_id == grip.body_id and len(piece.corners)
        }
        return min(distances, key=distances.__getitem__) if distances else None

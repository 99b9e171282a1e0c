"""Whether the service looks ahead as the simulation counts on, by what its answers say."""

from __future__ import annotations

import math

# relative; a lookahead that was written with four digits is meant to be the time step
NEARLY = 1e-3


class LookaheadCheck:
    """Compares the `lookahead` of answers with the one expected [s]; None: any will do."""

    def __init__(self, expected: float | None) -> None:
        self._expected = expected
        self._last = expected

    def unexpected(self, lookahead: float) -> str:
        """What is wrong with the `lookahead` [s] of an answer, and what to do; "": nothing, or nothing new."""
        expected, last, self._last = self._expected, self._last, lookahead
        if expected is None or lookahead == last or math.isclose(lookahead, expected, rel_tol=NEARLY):
            return ""
        effect = "contacts are listed that do not come about within a step"
        if lookahead < expected:
            effect = "fast bodies may pass through others"
        return (
            f"the service's answers have a lookahead of {lookahead:g} s, but this simulation counts on its time step,"
            f" {expected:g} s: {effect}. Set the service's parameter lookahead:={expected:g}, in Python"
            f" Settings(lookahead={expected:g}), or simulate with looks_ahead false"
        )

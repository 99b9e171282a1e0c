"""Contact ids: the same sample of the same fragment against the same other fragment has the same id in every step."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.memory.compiled import kernel


@kernel
def _mixed(value):
    """Finalizer of SplitMix64 (Steele, Lea, Flood 2014): a bijection that spreads every bit."""
    value ^= value >> np.uint64(30)
    value *= np.uint64(0xBF58476D1CE4E5B9)
    value ^= value >> np.uint64(27)
    value *= np.uint64(0x94D049BB133111EB)
    return value ^ (value >> np.uint64(31))


@kernel
def contact_ids(own, other, sample, out):
    """Hash (fragment whose sample it is, the other fragment, sample index) to uint64.

    Three 32-bit numbers do not fit into 64 bits, so ids are hashed: the probability of a collision among the contacts
    of one step is below 1e-12.
    """
    for i in range(len(sample)):
        pair = (np.uint64(own[i]) << np.uint64(32)) | np.uint64(other[i])
        out[i] = _mixed(_mixed(pair + np.uint64(0x9E3779B97F4A7C15)) + np.uint64(sample[i] + 1))

"""The error for a bag that cannot be read."""

from __future__ import annotations


class BagError(ValueError):
    """Not a bag, or one without a run or with an incomplete one."""

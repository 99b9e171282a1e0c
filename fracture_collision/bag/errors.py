"""What is said of a bag that cannot be read."""

from __future__ import annotations


class BagError(ValueError):
    """Not a bag, or one that holds no run, or not all of it."""

"""Which of our settings trade time for error, and what the methods that have them are called."""

from __future__ import annotations

DEFAULTS = "ours"
EVERY_CONTACT = 100_000  # a pair: more than any has samples
# Beside the default of each.
SETTINGS = {
    "contacts_per_pair": (1, 2, 4, 32, EVERY_CONTACT),
    "penetration_tolerance": (0.01, 0.02, 0.05),
    "visit_budget": (5_000, 10_000, 20_000, 30_000),
    "selection": ("sufficient",),  # the service's default; `ours` lists by the paper's rule, `complete`
    "normals": ("nearest",),
    "field": ("averaged",),
    "tree": ("rebuilt",),
}
RESOLUTION = "resolution"  # not a setting of the service: of the body that it is given


def named(setting: str, value: float | str) -> str:
    """The name of the method that has all but `setting` at its default."""
    return f"{DEFAULTS}, {setting}={value}"

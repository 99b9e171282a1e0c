"""Our settings that trade accuracy for time, and the names of our methods."""

from __future__ import annotations

DEFAULTS = "ours"
SAME_MESHES = f"{DEFAULTS}, same meshes"
EVERY_CONTACT = 100_000  # per pair: more than any pair has samples
# In addition to the default of each.
SETTINGS = {
    "contacts_per_pair": (1, 2, 4, 32, EVERY_CONTACT),
    "penetration_tolerance": (0.01, 0.02, 0.05),
    "method": ("glondu2014",),
}
RESOLUTION = "resolution"  # not a setting of the service but of its input body


def named(setting: str, value: float | str) -> str:
    """The name of the method with all settings but `setting` at their defaults."""
    return f"{DEFAULTS}, {setting}={value}"

"""The service's settings: the one place of their names, defaults, ranges, units and meaning.

config/collision.yaml, the parameters of the node, the page and docs/api.md take them from here. All may change while
the service runs, between two answers (CollisionWorld.change_settings). Imports nothing of core, so that a node has its
settings before kernels are loaded.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import lru_cache
from typing import Any, NamedTuple

from fracture_collision.records import documented

EXACT, GLONDU2014 = "exact", "glondu2014"


@documented
class PaperSettings(NamedTuple):
    """Variants of the method glondu2014, as the paper compares them: for studies in Python, not for a service.

    Fields:
      field: `averaged`: the paper's front propagation (eq. 1-2); `exact`: local flood, no error.
      tree: `restructured`: trees are split, restructured and extended at a fracture (6.2, 6.3); `plain`: as in the
        paper's earlier version [27], ignoring the maximum-distance order; `rebuilt`: from scratch (Fig. 15).
      traversal: `alternating`: children of different parents first (5.3); `queue`: a parent's children in a row, as in
        [27].
    """

    field: str = "averaged"
    tree: str = "restructured"
    traversal: str = "alternating"


@documented
class Settings(NamedTuple):
    """All settings with their defaults; `check_settings` has their ranges.

    Fields:
      method: How contacts are found. `exact`: with exact distances, along one direction for each pair or patch.
        `glondu2014`: the paper's method, for comparison: averaged distances, sphere trees, Algorithm 1, contacts at
        samples alone with the nearest normals; it does not look ahead. A change rebuilds all trees and surfaces, which
        takes as long as adding the bodies did.
      contacts_per_pair: Contacts of a pair before only those deeper than penetration_tolerance count (m of Glondu 2014,
        5.2). Six constraints lock a rigid body; the paper found no better contact beyond eight (Fig. 16). Method
        `exact` lists up to twice as many where more are that deep, spread over all of them; `glondu2014` lists all that
        are.
      penetration_tolerance: [share of R, half the longest side of the smaller of the two bodies] Penetrations up to
        this may stay unlisted once a pair has its contacts (epsilon of 5.2).
      detection_tolerance: [share of R] Contacts are listed up to this gap (delta of 5.2), so that the solver has
        constraints for surfaces that are about to touch.
      lookahead: [s] Contacts are listed, too, of pairs that do not touch and will penetrate by more than the tolerance
        within this time, by the velocities of the states, with positive gaps: fast bodies do not pass through thin ones
        between two steps. The package's simulators set it to their time step, others should; 0.0: off.
      threads: Threads of the narrow phase; 0: one per core. The answer is the same bytes for any number.
      max_work: Samples in the boxes of other fragments that one answer may query. Where there are more, all pairs are
        searched more coarsely by the same factor, and their bounds say what that may miss. Far above the need of bodies
        that push each other apart; without it, bodies at one place would have millions of contacts.
      max_pairs: Pairs of fragments whose boxes overlap; states with more are rejected.
      max_contacts: Contacts in one answer; of more, the pairs with most lose their shallowest.
      max_bodies: A further body is rejected.
      max_nodes: Vertices of all bodies together; a body beyond is rejected.
      max_fragments: Fragments ever made in one run; an event beyond is rejected.
      max_message_bytes: [bytes] Serialized size of a message to the service; larger ones are rejected.
      paper: Variants of glondu2014, in Python only.
    """

    method: str = EXACT
    contacts_per_pair: int = 8
    penetration_tolerance: float = 0.002
    detection_tolerance: float = 0.002
    lookahead: float = 0.0
    threads: int = 0
    max_work: int = 2_000_000
    max_pairs: int = 100_000
    max_contacts: int = 200_000
    max_bodies: int = 10_000
    max_nodes: int = 2_000_000
    max_fragments: int = 100_000
    max_message_bytes: int = 256 * 1024 * 1024
    paper: PaperSettings = PaperSettings()


@documented
class Range(NamedTuple):
    """What a setting may be.

    Fields:
      low: the lowest value
      high: the highest value
    """

    low: float
    high: float


# Of a service: all but the variants of the paper.
OF_SERVICE = tuple(name for name in Settings._fields if name != "paper")
RANGES = {
    "contacts_per_pair": Range(1, 1 << 31), "penetration_tolerance": Range(0, 1), "detection_tolerance": Range(0, 1),
    "lookahead": Range(0, 1),  # longer than any time step
    "threads": Range(0, 256), "max_work": Range(1, 1 << 40),
    "max_pairs": Range(1, 1 << 31), "max_contacts": Range(1, 1 << 31),
    "max_bodies": Range(1, 1 << 31), "max_nodes": Range(1, 1 << 31), "max_fragments": Range(1, 1 << 31),
    "max_message_bytes": Range(1024, 1 << 32),
}  # fmt: skip
CHOICES = {
    "method": (EXACT, GLONDU2014),
    "field": ("exact", "averaged"), "tree": ("restructured", "plain", "rebuilt"),
    "traversal": ("alternating", "queue"),
}  # fmt: skip
# Contacts depend on these, if no limit on messages rejects what they come from.
OF_CONTACTS = (
    "method", "contacts_per_pair", "penetration_tolerance", "detection_tolerance", "lookahead", "max_work",
    "max_contacts",
)  # fmt: skip


def meaning(name: str) -> str:
    """What a setting is, with its unit in brackets."""
    return str(getattr(Settings, name).__doc__)


def values_of(settings: Settings, names: tuple[str, ...] = OF_SERVICE) -> dict[str, Any]:
    """Settings by name, as JSON has them; with the variants of the paper's method where it is that."""
    values = {name: getattr(settings, name) for name in names}
    return values | ({"paper": settings.paper._asdict()} if settings.method == GLONDU2014 else {})


@lru_cache(maxsize=8)
def settings_text(settings: Settings) -> str:
    """The settings that contacts depend on, as one line of JSON: `settings` of a FragmentRegistry."""
    defaults = Settings._field_defaults
    # a number has its setting's type, so that equal settings have equal texts
    typed = {name: type(defaults[name])(getattr(settings, name)) for name in OF_CONTACTS}
    return json.dumps(values_of(settings._replace(**typed), OF_CONTACTS))


def for_step(time_step: float, given: Mapping[str, Any]) -> Settings:
    """Settings for a simulation with this time step [s]: those `given`, and the lookahead of a step if not given.

    Raises ValueError as check_settings does.
    """
    settings = Settings(**given)
    if settings.method == EXACT and "lookahead" not in given:
        settings = settings._replace(lookahead=time_step)
    check_settings(settings)
    return settings


def check_settings(settings: Settings) -> None:
    """Raise ValueError, naming the field, unless every setting is valid and has an effect."""
    for name, choices in CHOICES.items():
        value = getattr(settings if name == "method" else settings.paper, name)
        if value not in choices:
            raise ValueError(f"{name}: {value!r} is not one of {', '.join(choices)}")
    for name, limits in RANGES.items():
        value = getattr(settings, name)
        if value < limits.low:
            raise ValueError(f"{name}: {value} is less than {limits.low:g}")
        if not value <= limits.high:  # NaN, too
            raise ValueError(f"{name}: {value} is not in [{limits.low:g}, {limits.high:.15g}]")
    if settings.method == GLONDU2014 and settings.lookahead:
        raise ValueError(f"lookahead: {settings.lookahead} has no effect, method {GLONDU2014} does not look ahead")
    if settings.method == EXACT and settings.paper != PaperSettings():
        raise ValueError(f"paper: its variants are those of method {GLONDU2014}, and the method is {EXACT}")

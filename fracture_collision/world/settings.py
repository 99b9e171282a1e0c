"""The service's settings: one place, with meaning, unit and why. config/collision.yaml carries the same names.

All may change while the service runs, between two answers (CollisionWorld.change_settings). Imports nothing of core, so
that a node has its settings before kernels are loaded; world/registry.py maps each choice to core's constant.
"""

from __future__ import annotations

import json
from functools import lru_cache
from typing import NamedTuple

from fracture_collision.records import documented


@documented
class Settings(NamedTuple):
    """All settings with their defaults; `check_settings` has their ranges.

    max_visits to max_contacts limit the work for one answer, far above the need of bodies that push each other apart;
    without them, bodies at one place would have millions of contacts. missed_depth_bound covers what they leave out,
    with BUDGET_EXHAUSTED.

    Fields:
      contacts_per_pair: Contacts listed per pair before only those deeper than penetration_tolerance count, at least 1;
        m of Glondu 2014, 5.2. Six constraints lock a rigid body; the paper found no better contact beyond eight (Fig.
        16).
      selection: Which contacts of a pair are listed if more samples are near. `sufficient`: contacts_per_pair, spread
        over all of them; all that are deeper than the penetration tolerance, but if these exceed contacts_per_pair the
        deepest and others spread over them, up to deep_contacts_per_pair. It depends on the samples' depths and
        positions alone. `complete`: the paper's rule: the first ones found, then all that are deeper than the
        tolerance; without neighbour_lists by the paper's algorithm alone. A visit_budget uses the paper's rule too.
      deep_contacts_per_pair: Most contacts per pair with selection `sufficient`, where more than contacts_per_pair are
        deep; at least 1.
      penetration_tolerance: A share of R, half the longest side of the smaller of the two bodies, 0 to 1; epsilon of
        5.2: penetrations up to this may stay unlisted once a pair has its contacts.
      detection_tolerance: A share of R, 0 to 1; delta of 5.2: contacts are listed up to this gap, so that the solver
        has constraints for surfaces about to touch and the traversal can end.
      lookahead: [s], 0 to 1. For pairs that do not touch, also list contacts that will be deeper than the penetration
        tolerance within this time, by the velocities of the states, with positive gaps. This keeps fast bodies from
        tunnelling through thin ones between two steps. The package's simulators set their time step, others should;
        0: only contacts that are near now are listed.
      field: `exact`: local flood, no error; `averaged`: the paper's front propagation (eq. 1-2): depths and normals
        inside a broken body are approximate, the missed depth bound is as certain and looser.
      normals: `facing`: two fragments of one body are separated along the crack they share, other bodies along a
        surface that faces the sample, if one is near; `nearest`: along the shortest way to any surface, as in the
        paper, which at rims often points along the surface between the two.
      surfaces: `edges`: contacts are searched at samples, and where edges of the two cross between their samples, with
        the normal across both (not in the paper's rule: `complete` and a visit_budget search samples alone);
        missed_depth_bound holds for samples. `sampled`: at samples alone, as in the paper: crossed bars pass through
        each other. A query takes 0.7 to 0.8 times as long, an update down to half. `searched`: the bound holds for all
        points of both surfaces, and deeper points between samples are listed. For checking what samples miss: it takes
        30 to 100 times as long (docs/numerics.md), and needs field `exact`.
      tree: `restructured`: trees are split, restructured and extended at a fracture (6.2, 6.3); `plain`: as in the
        paper's earlier version [27], ignoring the maximum-distance order; `rebuilt`: from scratch (Fig. 15).
      traversal: `alternating`: children of different parents first (5.3); `queue`: a parent's children in a row, as in
        [27].
      neighbour_lists: Whether to cache, from one step to the next, which samples of slow pairs are near, how far apart
        others are, and the contacts of pairs that do not move (core/search: neighbour_lists, kept_answer). The answer
        does not depend on it; without it every step costs as much as the first.
      threads: Threads of the narrow phase; 0: all cores. The answer does not depend on it.
      visit_budget: Tree nodes a step may test, shared evenly by its pairs; 0: no limit. The bound covers what a limit
        leaves out.
      max_pairs: Pairs of fragments whose boxes overlap; states with more are rejected with a reason.
      max_visits: Tree nodes of pairs whose boxes coincide, in total; for the other pairs 25 times as many
        (core/pair/crowds.py).
      max_further_visits: Tree nodes of pairs with contacts_per_pair contacts, for deeper ones.
      max_contacts_per_pair: Of more contacts, a pair keeps the deepest; never fewer than contacts_per_pair.
      max_contacts: Contacts in one answer; of more, the pairs with most lose their shallowest.
      max_bodies: A further body is rejected with a reason.
      max_nodes: Tetrahedral-mesh and surface vertices of all bodies together; a body beyond is rejected.
      max_fragments: Fragments made in one run; an event beyond is rejected.
      max_message_bytes: Serialized size of a message of the service; larger ones are rejected.
    """

    contacts_per_pair: int = 8
    selection: str = "sufficient"
    deep_contacts_per_pair: int = 16
    penetration_tolerance: float = 0.002
    detection_tolerance: float = 0.002
    lookahead: float = 0.0
    field: str = "exact"
    normals: str = "facing"
    surfaces: str = "edges"
    tree: str = "restructured"
    traversal: str = "alternating"
    neighbour_lists: bool = True
    threads: int = 0
    visit_budget: int = 0
    max_pairs: int = 100_000
    max_visits: int = 4_000_000
    max_further_visits: int = 2_000_000
    max_contacts_per_pair: int = 1_000
    max_contacts: int = 200_000
    max_bodies: int = 10_000
    max_nodes: int = 2_000_000
    max_fragments: int = 100_000
    max_message_bytes: int = 256 * 1024 * 1024


@documented
class Range(NamedTuple):
    """What a setting may be.

    Fields:
      low: the lowest value
      high: the highest value
    """

    low: float
    high: float


# Of every number among the settings: for the command line, the service's parameters and the page.
RANGES = {
    "contacts_per_pair": Range(1, 1 << 31), "deep_contacts_per_pair": Range(1, 1 << 31),
    "penetration_tolerance": Range(0, 1), "detection_tolerance": Range(0, 1),
    "lookahead": Range(0, 1),  # longer than any time step
    "threads": Range(0, 256), "visit_budget": Range(0, 1 << 40),
    "max_pairs": Range(1, 1 << 31), "max_visits": Range(1, 1 << 40), "max_further_visits": Range(1, 1 << 40),
    "max_contacts_per_pair": Range(1, 1 << 31), "max_contacts": Range(1, 1 << 31),
    "max_bodies": Range(1, 1 << 31), "max_nodes": Range(1, 1 << 31), "max_fragments": Range(1, 1 << 31),
    "max_message_bytes": Range(1024, 1 << 32),
}  # fmt: skip
FIELDS = ("exact", "averaged")
SELECTIONS = ("sufficient", "complete")
NORMALS = ("facing", "nearest")
SAMPLED, EDGES, SEARCHED = "sampled", "edges", "searched"
SURFACES = (SAMPLED, EDGES, SEARCHED)
TREES = ("restructured", "plain", "rebuilt")
TRAVERSALS = ("alternating", "queue")


# No contact depends on these: they share or save work, or they reject a message, which its refusal says.
_WITHOUT_CONTACTS = frozenset({
    "neighbour_lists", "threads", "max_pairs", "max_bodies", "max_nodes", "max_fragments", "max_message_bytes",
})  # fmt: skip
OF_CONTACTS = tuple(name for name in Settings._fields if name not in _WITHOUT_CONTACTS)


@lru_cache(maxsize=8)
def settings_text(settings: Settings) -> str:
    """The settings that contacts depend on, as one line of JSON: `settings` of a FragmentRegistry."""
    defaults = Settings._field_defaults
    # a number has its setting's type, so that equal settings have equal texts
    return json.dumps({name: type(defaults[name])(getattr(settings, name)) for name in OF_CONTACTS})


def geometry_settings(settings: Settings) -> tuple[str | bool, ...]:
    """The settings a registry is built with; a change of any of them rebuilds it from the event log."""
    return settings.field, settings.normals, settings.tree, settings.traversal, settings.surfaces != SAMPLED


def has_edges(settings: Settings) -> bool:
    """Whether edges that cross between samples are contacts; never under the paper's rule."""
    return settings.surfaces != SAMPLED and settings.selection == "sufficient" and not settings.visit_budget


def most_listed(settings: Settings) -> int:
    """Most contacts per pair that `sufficient` lists; 0 if `selection` is `complete`."""
    if settings.selection == "complete":
        return 0
    return max(settings.contacts_per_pair, settings.deep_contacts_per_pair)


def check_settings(settings: Settings) -> None:
    """Raise ValueError, naming the field, unless every setting is valid."""
    for name, choices in (
        ("field", FIELDS), ("normals", NORMALS), ("tree", TREES), ("traversal", TRAVERSALS), ("selection", SELECTIONS),
        ("surfaces", SURFACES),
    ):  # fmt: skip
        if getattr(settings, name) not in choices:
            raise ValueError(f"{name}: {getattr(settings, name)!r} is not one of {', '.join(choices)}")
    if settings.surfaces == SEARCHED and settings.field != "exact":
        raise ValueError("surfaces: 'searched' needs field 'exact': averaged depths bound nothing between samples")
    for name, limits in RANGES.items():
        value = getattr(settings, name)
        if value < limits.low:
            raise ValueError(f"{name}: {value} is less than {limits.low:g}")
        if not value <= limits.high:  # NaN, too
            raise ValueError(f"{name}: {value} is not in [{limits.low:g}, {limits.high:.15g}]")

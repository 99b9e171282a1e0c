"""The service's settings: one place, with meaning, unit and why. config/collision.yaml carries the same names."""

from __future__ import annotations

from typing import NamedTuple


class Settings(NamedTuple):
    # m of Glondu 2014, 5.2: contacts a pair gets before only those deeper than epsilon count. Six constraints lock a
    # rigid body; beyond eight the paper saw no better contact (Fig. 16).
    contacts_per_pair: int = 8
    # epsilon of 5.2, as a share of R (the smaller of the two bodies' half longest side): penetrations up to this may
    # stay unlisted once a pair has its contacts.
    penetration_tolerance: float = 0.002
    # delta of 5.2, as a share of R: contacts this far apart are listed already, so that surfaces about to touch give
    # the solver something to hold and the traversal a reason to end.
    detection_tolerance: float = 0.002
    # `exact`: local flood, no error; `averaged`: the paper's front propagation (eq. 1-2).
    field: str = "exact"
    # Threads of the narrow phase; 0: all cores. The answer does not depend on it.
    threads: int = 0
    # Tree nodes a step may test, shared evenly by its pairs; 0: no limit. The bound says what a limit left out.
    visit_budget: int = 0
    # Limits: a message beyond them is refused in words.
    max_bodies: int = 10_000
    max_nodes: int = 2_000_000  # tetrahedral-mesh and surface vertices of all bodies together
    max_fragments: int = 100_000  # ever made in one run
    max_message_bytes: int = 256 * 1024 * 1024


FIELDS = ("exact", "averaged")

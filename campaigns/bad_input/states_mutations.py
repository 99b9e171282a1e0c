"""Possible faults of FragmentStates."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds.gate_world import EARLIER, REFERENCE

from campaigns.bad_input.clean_scene import REMOVED
from campaigns.bad_input.mutations import (
    FINE,
    Mutation,
    Pick,
    Rules,
    float_mutations,
    identifier_type_mutations,
    index_mutations,
    mutation,
    one_of,
    value_mutations,
)

MOVING = REFERENCE._replace(linear_velocities=np.ones(12), angular_velocities=np.ones(12))
AHEAD = "sequence_gap unknown_id"  # held, not refused
ROWS = "size_mismatch"
BESIDE_IDS = ("positions",)  # the first field whose size is compared with fragment_ids


def _quaternion(*factors: float):
    """A quaternion of length `factor`, in some direction."""

    def change(record: Any, pick: Pick) -> Any:
        turns = np.array(record.orientations).reshape(-1, 4)
        i = pick(len(turns))
        if pick(2):
            turns[i] = np.array([0.1, -0.7, 0.5, -0.5]) / np.linalg.norm([0.1, -0.7, 0.5, -0.5])
        turns[i] *= one_of(factors, pick)
        return record._replace(orientations=turns.ravel())

    return change


def _id(*values: int):
    def change(record: Any, pick: Pick) -> Any:
        ids = np.array(record.fragment_ids)
        ids[pick(len(ids))] = one_of(values, pick)
        return record._replace(fragment_ids=ids)

    return change


def _fewer(record: Any, pick: Pick) -> Any:
    """Only some of the fragments: the others do not take part."""
    kept = np.array([pick(2) == 1 for _ in record.fragment_ids])
    return record._replace(
        fragment_ids=record.fragment_ids[kept], positions=np.reshape(record.positions, (-1, 3))[kept],
        orientations=np.reshape(record.orientations, (-1, 4))[kept], linear_velocities=np.zeros((0, 3)),
        angular_velocities=np.zeros((0, 3)),
    )  # fmt: skip


def _moved(*lengths: float):
    def change(record: Any, pick: Pick) -> Any:
        length = one_of(lengths, pick)
        places = [length * (pick(2**20) / 2**19 - 1.0) for _ in range(np.size(record.positions))]
        return record._replace(positions=np.reshape(places, (-1, 3)))

    return change


def _velocities(field: str) -> list[Mutation]:
    rules = Rules(3, ROWS, "", "", empty="", empty_passes=True)
    return [
        *float_mutations(field, rules),
        mutation(field, "of one fragment less", lambda r, p: r._replace(**{field: np.zeros(9)}), ROWS),
    ]


STATES_MUTATIONS: list[tuple[Any, Mutation]] = [(MOVING, each) for each in (
    *value_mutations("step", (0, 1, 6, 7, 2**32, 2**63, 2**64 - 1), FINE),  # a replay may go back
    *identifier_type_mutations("step", 64),
    *value_mutations("fracture_sequence", (2, 3, 2**32, 2**63, 2**64 - 1), AHEAD, what="is to come"),
    *value_mutations("fracture_sequence", (0,), "retired_id", ("fragment_ids",), what="is long past"),
    *identifier_type_mutations("fracture_sequence", 64),
    *value_mutations("body_sequence", (7, 8, 2**32, 2**64 - 1), AHEAD, what="is to come"),
    *value_mutations("body_sequence", (4,), "retired_id", what="precedes the removal of a static body"),
    *value_mutations("body_sequence", (0, 1, 2, 3, 5, 6), FINE, what="is known"),
    *identifier_type_mutations("body_sequence", 64),
    *index_mutations("fragment_ids", Rules(1, f"{ROWS} doubled {AHEAD} retired_id", AHEAD, "doubled",
                                           names=BESIDE_IDS)),
    mutation("fragment_ids", "one is unknown", _id(0, 50, 12, 20, 2**32 - 1), AHEAD),
    mutation("fragment_ids", "one broke before", _id(1), "retired_id"),
    mutation("fragment_ids", "one of a removed body", _id(REMOVED), "retired_id"),
    mutation("fragment_ids", "fewer", _fewer, FINE),
    *float_mutations("positions", Rules(3, ROWS, "out_of_range", "")),
    *float_mutations("orientations", Rules(4, ROWS, "not_unit", "not_unit")),
    *_velocities("linear_velocities"), *_velocities("angular_velocities"),
    mutation("orientations", "one of length 0", _quaternion(0.0, -0.0, 1e-320, 1e-200), "not_unit"),
    mutation("orientations", "one of another length", _quaternion(2.0, 0.5, 1e10, 1e154, 1e200, 1e308), "not_unit"),
    mutation("orientations", "one a little off", _quaternion(1.0 + 2e-6, 1.0 - 2e-6), "not_unit"),
    mutation("orientations", "one off by rounding", _quaternion(1.0 + 5e-7, 1.0 - 5e-7, -1.0), FINE),
    mutation("positions", "anywhere near", _moved(0.1, 1.0), FINE),
    mutation("positions", "at the ends of the world", _moved(1e9, 1e6), FINE),
    mutation("fracture_sequence", "an earlier registry", lambda r, p: EARLIER, FINE),
)] + [
    (EARLIER, mutation("fragment_ids", "one is not born yet", _id(10, 11), "retired_id")),
    (EARLIER, mutation("fragment_ids", "one is unknown to an earlier registry", _id(50), AHEAD)),
]  # fmt: skip

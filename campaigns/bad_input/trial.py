"""One case: a message, the expected result, and whether it occurred."""

from __future__ import annotations

import re
import traceback
import warnings
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from worlds.broken_rules import BODIES, EVENTS, STATES
from worlds.gate_world import observed

from campaigns.bad_input.body_mutations import BODY_MUTATIONS, SHAPES
from campaigns.bad_input.clean_scene import (
    AHEAD,
    AT_ONE_PLACE,
    FAST,
    FULL,
    REFERENCE,
    REMOVED,
    SETTINGS,
    SPARSE,
)
from campaigns.bad_input.doors import DOORS, HELD, MESSAGE_CLASSES, REFUSED, TAKEN, Verdict, ending, unsound
from campaigns.bad_input.event_mutations import EVENT_MUTATIONS
from campaigns.bad_input.mutations import ANY_KIND, Mutation, Pick
from campaigns.bad_input.serialized import compared_with_rclpy, spoilt_bytes
from campaigns.bad_input.states_mutations import STATES_MUTATIONS
from fracture_collision.world import Settings

TABLES: dict[str, list[tuple[Any, Mutation]]] = {
    "bodies": BODY_MUTATIONS, "fracture_events": EVENT_MUTATIONS, "fragment_states": STATES_MUTATIONS,
}  # fmt: skip
# Every rule violated once, as in the tests of the gate.
RULES = {"bodies": BODIES, "fracture_events": EVENTS, "fragment_states": STATES}
SHAPE_PARTS = frozenset({"primitive.type", "primitive.dimensions"})
FIELDS = {topic: table[0][0]._fields for topic, table in TABLES.items()}
# "field: ...", or several fields
_NAMES = re.compile(r"([a-z_.]+(?:, [a-z_.]+)*): ")


class Case(NamedTuple):
    topic: str
    name: str
    record: Any
    kinds: frozenset[str]
    names: frozenset[str]  # of fields
    must_pass: bool = False
    must_fail: bool = True
    on_the_wire: bool = False
    settings: Settings = SETTINGS


def fixed_cases() -> Iterator[Case]:
    """Cases without random choices: the rules, worlds without spare capacity, meshes of fragments that do not exist."""
    for topic, rules in RULES.items():
        for rule, (record, kind, _) in rules.items():
            yield Case(topic, f"rule: {rule}", record, frozenset({kind}), SHAPE_PARTS.union(record._fields))
    for shape in SHAPES:
        yield Case(
            "bodies", "one body too many", shape, frozenset({"limit_exceeded"}), frozenset({"body_id"}),
            on_the_wire=True, settings=FULL,
        )  # fmt: skip
    yield Case(
        "fragment_states", "all at one place", AT_ONE_PLACE, frozenset({"limit_exceeded"}), frozenset({"positions"}),
        on_the_wire=True, settings=SPARSE,
    )  # fmt: skip
    yield Case(
        "fragment_states", "too fast to look ahead", FAST, frozenset({"out_of_range"}),
        frozenset({"linear_velocities"}), on_the_wire=True, settings=AHEAD,
    )  # fmt: skip
    yield Case(
        "bodies", "bad, and next in order", SHAPES[0]._replace(sequence=7, friction=-1.0), frozenset({"out_of_range"}),
        frozenset({"friction"}), on_the_wire=True,
    )  # fmt: skip
    yield Case(
        "fragment_states", "after that body", REFERENCE._replace(body_sequence=7), frozenset({"sequence_gap"}),
        frozenset({"body_sequence"}), on_the_wire=True,
    )  # fmt: skip
    for kind, fragment_ids in (
        ("unknown_id", (0, 1, REMOVED, 12)), ("out_of_range", (2**32, -1)), ("wrong_type", (0.5, None, "1", [1])),
    ):  # fmt: skip
        for fragment_id in fragment_ids:
            yield Case(
                "fragment_meshes", f"of {fragment_id!r}", fragment_id, frozenset({kind}), frozenset({"fragment_id"})
            )


def single(topic: str, number: int, pick: Pick) -> Case:
    """The table's entry `number`."""
    record, mutation = TABLES[topic][number % len(TABLES[topic])]
    return Case(
        topic, f"{mutation.field}, {mutation.what}", mutation.change(record, pick), mutation.kinds,
        frozenset(mutation.names), not mutation.kinds, mutation.must_fail, mutation.on_the_wire,
    )  # fmt: skip


def several(topic: str, number: int, pick: Pick, count: int) -> Case:
    """The entry `number` and up to `count` - 1 others of the same body, event or states, on other fields.

    Any of them may cause the rejection, and they may cancel each other out.
    """
    record, first = TABLES[topic][number % len(TABLES[topic])]
    chosen = [first]
    others = [each for base, each in TABLES[topic] if base is record]
    for _ in range(count - 1):
        other = others[pick(len(others))]
        if all(other.field != each.field for each in chosen):
            chosen.append(other)
    changed, done = record, []
    for mutation in chosen:
        try:
            with np.errstate(all="ignore"):  # from an edge of zero length, for example
                changed = mutation.change(changed, pick)
        except (ValueError, IndexError, TypeError, AttributeError, KeyError):
            continue  # the target of the mutation is already gone
        done.append(mutation)
    return Case(
        topic, " + ".join(f"{m.field}, {m.what}" for m in done), changed, ANY_KIND,
        SHAPE_PARTS.union(record._fields), must_fail=False, on_the_wire=all(m.on_the_wire for m in done),
    )  # fmt: skip


def spoilt(topic: str, pick: Pick) -> Case:
    """A serialized message that is no longer valid, or has become another one."""
    what, data = spoilt_bytes(topic, pick)
    return given_bytes(topic, data, what)


def given_bytes(topic: str, data: bytes, what: str = "given") -> Case:
    return Case(
        topic, f"bytes: {what}", data, ANY_KIND | {"malformed"}, SHAPE_PARTS.union(FIELDS[topic]), must_fail=False,
        on_the_wire=True,
    )  # fmt: skip


REJECTED = {"event_rejected", "body_rejected"}


class Bench:
    """Two instances of a door: a case goes to one first; what it refuses, the other must refuse alike, unchanged.

    The second, the veteran, sees every bad message of its life and accepts none.
    """

    def __init__(self, door: str, settings: Settings) -> None:
        self._make = lambda: DOORS[door](settings)
        self.verdict = Verdict(TAKEN)  # of the last case
        self.readers = ""  # which readers accept it, if it was bytes
        fresh = self._make()
        self._clean, self._ending = observed(fresh.world), ending(fresh)
        self._tried, self._veteran = self._make(), self._make()

    def judge(self, case: Case) -> str:
        """Describes what is wrong with the result; "" if nothing is."""
        self.verdict, self.readers = Verdict(TAKEN), ""
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                return self._judge(case)
        except Exception:
            self._tried, self._veteran = self._make(), self._make()
            return "raised " + "".join(traceback.format_exc(limit=-6))

    def retire(self) -> str:
        """The veteran plays the clean scene to its end and is replaced."""
        came = ending(self._veteran)
        self._veteran = self._make()
        return "" if came == self._ending else "the clean scene after it has other answers than without it"

    def _judge(self, case: Case) -> str:
        if isinstance(case.record, bytes):
            self.readers, problem = compared_with_rclpy(case.record, MESSAGE_CLASSES[case.topic])
            if problem:
                return problem
        verdict = self.verdict = self._tried.deliver(case.topic, case.record)
        if verdict.outcome != REFUSED:
            # states change nothing, even if they are ahead
            if case.topic == "fragment_states":
                return self._agrees(case, verdict) or _expected(case, verdict)
            problem = unsound(self._tried.world, self._tried.events) if verdict.outcome == TAKEN else ""
            self._tried = self._make()
            return problem or _expected(case, verdict)
        return self._agrees(case, verdict) or _expected(case, verdict)

    def _agrees(self, case: Case, verdict: Verdict) -> str:
        again = self._veteran.deliver(case.topic, case.record)
        if again != verdict and not (_wait_for_messages(again) and _wait_for_messages(verdict)):
            return f"told {verdict[:3]} at first and {again[:3]} to the veteran"
        if verdict.outcome == TAKEN:
            self._veteran.deliver("fragment_states", REFERENCE)  # the registry is that of the last states
        if observed(self._veteran.world) != self._clean:
            self._veteran = self._make()
            return f"changed something: {verdict[:3]}"
        return ""


def _wait_for_messages(verdict: Verdict) -> bool:
    """Whether states were held for a missing event or body, or rejected because the next one had been rejected.

    Which of the two depends only on the bad messages that a door has seen.
    """
    return verdict.kind in REJECTED or (verdict.outcome == HELD and verdict.kind in ("", "sequence_gap"))


def _expected(case: Case, verdict: Verdict) -> str:
    if verdict.outcome == TAKEN:
        return "was taken" if case.must_fail else ""
    if case.must_pass:
        return f"was {verdict.outcome}: {verdict.kind}: {verdict.text}"
    if verdict.outcome == HELD and not verdict.kind:
        return ""
    kind = "sequence_gap" if verdict.kind in REJECTED else verdict.kind
    if kind not in case.kinds:
        return f"{verdict.outcome} as {verdict.kind}, not {' or '.join(sorted(case.kinds))}: {verdict.text}"
    if verdict.kind == "malformed":
        return "" if verdict.text.startswith("no serialized ") else f"no words for what is malformed: {verdict.text}"
    found = _NAMES.match(verdict.text)
    if found is None or not case.names.intersection(found[1].split(", ")):
        return f"the words name none of {', '.join(sorted(case.names))}: {verdict.text}"
    return ""

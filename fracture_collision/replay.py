"""Replays a recorded run and compares the answers with those recorded, byte for byte.

Contacts are a function of bodies, events, states and settings alone, so the order, rate and number of the questions and
the number of threads do not matter. `Replay` sends the questions to any `Service`; `InProcess` is one,
ros/runs/replay_run.py has another, over DDS.
"""

from __future__ import annotations

import hashlib
import time
from bisect import bisect_right
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np

from fracture_collision.bag.exchanges import Question, Run, deserialize_record, registry_settings, serialize_record
from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import recorded_settings
from fracture_collision.records import ContactConstraintArray, FragmentStates, refusal_of
from fracture_collision.world import CollisionWorld, InvalidMessage, PaperSettings, Settings, StatesAhead
from fracture_collision.world.settings import OF_CONTACTS, check_settings

# [s] While it waits for the recorded time, a replay checks this often whether to end.
WAITING_INTERVAL = 0.05

# Numbers per contact in these arrays of an answer; all others have one per pair.
_OF_CONTACTS = {"points_a": 3, "points_b": 3, "normals": 3, "gaps": 1, "contact_ids": 1}


class Unanswered(RuntimeError):
    """A service gave no answer; the text names the step and the service's explanation."""


class Service(Protocol):
    """A collision service that a Replay sends questions to."""

    def ask(self, run: Run, question: Question) -> tuple[bytes, float]:
        """The answer, serialized with zeroed padding, and the time it took [s]. Raises Unanswered."""


class Order(NamedTuple):
    """Which questions, and in what order. The answers do not depend on it."""

    first: int | None = None  # step; None: that of the recording
    end: int | None = None  # the first step after the range
    backwards: bool = False
    loops: int = 1

    def has(self, step: int) -> bool:
        """Whether `step` is in the range."""
        return (self.first is None or step >= self.first) and (self.end is None or step < self.end)


AS_RECORDED = Order()


class Difference(NamedTuple):
    """The first difference between an answer and the recording."""

    run_id: int
    step: int
    field: str
    entry: int | None  # of the number in the field; None: not an array, or of another length
    pair: tuple[int, int] | None  # of fragments, as recorded
    recorded: str
    answered: str

    def words(self) -> str:
        """The difference as one line: step, pair, field, and both values."""
        where = f"step {self.step}"
        if self.pair is not None:
            where += f", pair {self.pair[0]}-{self.pair[1]}"
        place = self.field if self.entry is None else f"{self.field}[{self.entry}]"
        return f"{where}, {place}: recorded {self.recorded}, answered {self.answered}"


class Report(NamedTuple):
    """Result of a replay, or of its part so far."""

    digest: str  # SHA-256 of all answers, as_recorded
    recorded_digest: str  # of those recorded for the same questions; "" if one of them has none
    steps: int  # questions asked, each counted once
    answers: int  # all, including those to repeated questions
    unrecorded: int  # questions without an answer in the bag
    unasked: list[int]  # steps in the requested range that have an answer in the bag, but no question
    differing: int  # questions answered otherwise than recorded
    difference: Difference | None  # the first of those, by step
    contradicted: list[int]  # steps that were answered in two ways in this replay
    recorded_twice: list[int]  # steps that have two different answers in the bag
    seconds: np.ndarray  # (answers,) how long each took

    @property
    def exact(self) -> bool:
        """Nothing that was compared differs."""
        return not (self.differing or self.contradicted or self.recorded_twice)

    @property
    def compared(self) -> int:
        """Questions that have an answer in the bag."""
        return self.steps - self.unrecorded

    @property
    def complete(self) -> bool:
        """Each question has its answer in the bag, and each answer its question."""
        return not (self.unrecorded or self.unasked)


class Replay:
    """An iterator that sends the questions of `runs` to `service` in `order`; yields how many are done.

    `rate`: times the pace of the recording; None: as fast as possible. `wait`: called while it waits for a recorded
    time; an exception from it ends the replay. `report` may be called at any time.
    """

    def __init__(
        self, runs: list[Run], service: Service, order: Order = AS_RECORDED, rate: float | None = None,
        wait: Callable[[], None] = lambda: None,
    ) -> None:  # fmt: skip
        """Raises BagError if no step is in the order's range."""
        self._service, self._rate, self._wait = service, rate, wait
        self._plays = _plays(runs, order)
        if not self._plays:
            raise BagError(f"no step from {order.first} to {order.end}: {_range_words(runs)}")
        self._order = order
        self._runs = runs
        self._answers: dict[tuple[int, int], bytes] = {}  # as_recorded, by place of the run and of the question in it
        self._contradicted: set[tuple[int, int]] = set()
        self._seconds: list[float] = []

    @property
    def total(self) -> int:
        """Number of questions that the whole replay sends."""
        return len(self._plays) * self._order.loops

    def __iter__(self) -> Iterator[int]:
        for _ in range(self._order.loops):
            started, last_run = time.monotonic(), None
            for place, at in self._plays:
                run = self._runs[place]
                question = run.questions[at]
                if place != last_run:
                    started, begin, last_run = time.monotonic(), question.time, place
                self._await(started, abs(question.time - begin))
                answer, seconds = self._service.ask(run, question)
                answer = run.as_recorded(answer)
                if self._answers.setdefault((place, at), answer) != answer:
                    self._contradicted.add((place, at))
                self._seconds.append(seconds)
                yield len(self._seconds)

    def _await(self, started: float, nanoseconds: int) -> None:
        self._wait()
        if self._rate is None:
            return
        due = started + 1e-9 * nanoseconds / self._rate
        while (left := due - time.monotonic()) > 0:
            time.sleep(min(left, WAITING_INTERVAL))
            self._wait()

    def report(self) -> Report:
        """Reports on the answers so far."""
        differing: list[tuple[Run, Question, bytes]] = []
        recorded_twice, unrecorded, recorded = [], 0, {}
        for (place, at), answer in sorted(self._answers.items()):
            run = self._runs[place]
            question = run.questions[at]
            if not question.answers:
                unrecorded += 1
                continue
            recorded[place, at] = run.as_recorded(question.answers[0])
            if len(question.answers) > 1:
                recorded_twice.append(question.step)
            if answer != recorded[place, at]:
                differing.append((run, question, answer))
        return Report(
            digest=self._digest(self._answers),
            recorded_digest="" if unrecorded or not recorded else self._digest(recorded),
            steps=len(self._answers),
            answers=len(self._seconds),
            unrecorded=unrecorded,
            unasked=[step for run in self._runs for step in run.unasked if self._order.has(step)],
            differing=len(differing),
            difference=first_difference(*differing[0]) if differing else None,
            contradicted=[self._runs[place].questions[at].step for place, at in sorted(self._contradicted)],
            recorded_twice=recorded_twice,
            seconds=np.array(self._seconds),
        )

    def _digest(self, answers: Mapping[tuple[int, int], bytes]) -> str:
        """SHA-256 over step, length and bytes of each answer, by run and step, whatever the order of play."""
        digest = hashlib.sha256()
        for (place, at), answer in sorted(answers.items()):
            step = self._runs[place].questions[at].step
            digest.update(step.to_bytes(8, "little") + len(answer).to_bytes(8, "little"))
            digest.update(answer)
        return digest.hexdigest()


class InProcess:
    """The service in this process, without ROS."""

    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._run: Run | None = None
        self._bodies = self._events = 0  # of the run, added to the world
        self.refusals: dict[str, str] = {}  # of bodies and events: kind, and its last reason

    def ask(self, run: Run, question: Question) -> tuple[bytes, float]:
        """The answer, serialized with zeroed padding, and the time it took [s]. Raises Unanswered."""
        heading, run_id, states = deserialize_record(question.states, FragmentStates)
        if run is not self._run or question.bodies_before < self._bodies:
            # Back before a body was added or removed: only a world that never had it answers as the recorded one did.
            self._run, self._world = run, CollisionWorld(self._settings)
            self._bodies = self._events = 0
        started = time.perf_counter()
        while self._bodies < question.bodies_before:
            self._add_body(run)
        due = bisect_right(run.events, states.fracture_sequence, key=lambda event: event.received.record.sequence)
        while self._events < due:
            self._add_event(run)
        answer = self._answer(run, states)
        seconds = time.perf_counter() - started
        return serialize_record(answer, heading, run_id), seconds

    def _answer(self, run: Run, states: FragmentStates) -> ContactConstraintArray:
        while True:
            try:
                return self._world.contacts(states)
            except StatesAhead as error:
                # Recorders keep no order across topics: the body may come after the states that name it.
                if self._bodies < len(run.bodies):
                    self._add_body(run)
                elif self._events < len(run.events):
                    self._add_event(run)
                else:
                    missing = "the bag lacks bodies or fracture events of its run; record it from its first step"
                    raise Unanswered(f"step {states.step}: {error}; {missing}") from error
            except InvalidMessage:
                return refusal_of(states, self._settings.lookahead)

    def _add_body(self, run: Run) -> None:
        self._bodies += 1
        self._add(self._world.add_body, run.bodies[self._bodies - 1].received.record)

    def _add_event(self, run: Run) -> None:
        self._events += 1
        self._add(self._world.add_fracture, run.events[self._events - 1].received.record)

    def _add(self, add: Callable[[Any], None], record: Any) -> None:
        try:
            add(record)
        except InvalidMessage as error:  # the recorded service rejected it too
            self.refusals[f"{type(record).__name__}, {error.kind}"] = str(error)


class SettingsFound(NamedTuple):
    """The settings of a replay."""

    settings: Settings
    words: list[str]  # notes on their origin


def settings_of(bag: Path, given: Mapping[str, Any], namespace: str | None = None) -> SettingsFound:
    """Settings of the recorded service, replaced by those `given`; defaults if the bag has none.

    The bag's custom data has all of them, its registries those that contacts depend on. Recorded limits apply too: what
    was rejected is rejected again. Raises BagError, ValueError.
    """
    noted, told = recorded_settings(bag), registry_settings(bag, namespace)
    words: list[str] = []
    settings = Settings()
    if noted is not None:
        settings = _checked_settings(bag, noted.values, words)
    elif told:
        settings = _checked_settings(bag, told[-1], words)
        words.append("the bag has the settings that contacts depend on; the replay uses the defaults of all others")
    else:
        words.append("the bag lacks the settings of the service; the replay uses the defaults")
    if len(told) > 1 or (noted is not None and noted.changed):
        words.append("the settings changed during the recording; the replay uses the last ones")
    recorded = _checked_settings(bag, told[-1], []) if told else settings
    settings = settings._replace(**{"threads": 0, **given})
    check_settings(settings)
    if noted is not None or told:
        words += _other_settings(recorded, settings)
    return SettingsFound(settings, words)


def _other_settings(recorded: Settings, used: Settings) -> list[str]:
    """A note, if contacts may differ because of the settings."""
    others = [
        f"{name}: {getattr(used, name)}, recorded {getattr(recorded, name)}"
        for name in OF_CONTACTS
        if getattr(used, name) != getattr(recorded, name)
    ]
    return [f"the replay uses other settings than the recorded answers: {'; '.join(others)}"] if others else []


def _checked_settings(bag: Path, values: Mapping[str, Any], words: list[str]) -> Settings:
    settings = Settings()
    unknown = [name for name in values if name not in Settings._fields]
    if unknown:
        named = ", ".join(repr(name[:80]) for name in unknown[:9]) + ", ..." * (len(unknown) > 9)
        words.append(f"the bag has settings of another version, which the replay ignores: {named}")
    for name, value in values.items():
        if name in unknown:
            continue
        if name == "paper":
            value = _variant(bag, value)
        kind = type(getattr(settings, name))
        taken: Any = float(value) if kind is float and type(value) is int else value
        if type(taken) is not kind:
            raise BagError(f"{bag}: the setting {name}: {str(value)[:80]!r} is not of type {kind.__name__}")
        settings = settings._replace(**{name: taken})
    try:
        check_settings(settings)
    except ValueError as error:
        raise BagError(f"{bag}: the settings: {error}") from error
    return settings


def _variant(bag: Path, value: Any) -> PaperSettings:
    try:
        return PaperSettings(**{name: str(choice) for name, choice in value.items()})
    except (AttributeError, TypeError) as error:
        raise BagError(f"{bag}: the setting paper: {str(value)[:80]!r} is not a variant of the method") from error


def first_difference(run: Run, question: Question, answer: bytes) -> Difference:
    """The first difference between `answer`, `as_recorded`, and the first recorded one; they must not be equal."""
    recorded = deserialize_record(question.answers[0], ContactConstraintArray)
    answered = run.answers_as.read(answer)
    at = (run.run_id, question.step)
    for name in ("heading", "run_id"):
        one, other = getattr(recorded, name), getattr(answered, name)
        if one != other:
            return Difference(*at, name, None, None, str(one), str(other))
    for name, one in recorded.record._asdict().items():
        other = getattr(answered.record, name)
        if not isinstance(one, np.ndarray):
            if one != other:
                return Difference(*at, name, None, None, str(one), str(other))
        elif one.size != other.size:
            return Difference(*at, name, None, None, f"{one.size} numbers", f"{other.size}")
        elif one.tobytes() != other.tobytes():
            one, other = one.reshape(-1), other.reshape(-1)  # as in the message
            bits = np.dtype(f"u{one.itemsize}")
            index = int(np.flatnonzero(one.view(bits) != other.view(bits))[0])
            pair = _pair_of(recorded.record, name, index)
            return Difference(*at, name, index, pair, repr(one[index].item()), repr(other[index].item()))
    raise ValueError("the answers are equal")


def _pair_of(contacts: ContactConstraintArray, name: str, index: int) -> tuple[int, int] | None:
    if name in _OF_CONTACTS:
        pair = int(np.searchsorted(contacts.pair_begin, index // _OF_CONTACTS[name], side="right")) - 1
    else:
        pair = index - (name == "pair_begin")  # where a pair begins is where the one before ends
    if not 0 <= pair < min(len(contacts.fragment_a), len(contacts.fragment_b)):
        return None
    return int(contacts.fragment_a[pair]), int(contacts.fragment_b[pair])


def _plays(runs: list[Run], order: Order) -> list[tuple[int, int]]:
    """Indices of runs and of their questions in one play of the order."""
    plays = [
        (place, at)
        for place, run in enumerate(runs)
        for at, question in enumerate(run.questions)
        if order.has(question.step)
    ]
    return plays[::-1] if order.backwards else plays


def _range_words(runs: list[Run]) -> str:
    asked = (run.questions for run in runs if run.questions)
    return "; ".join(f"the bag has steps {questions[0].step} to {questions[-1].step}" for questions in asked)

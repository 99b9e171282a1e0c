"""Entry points of the service: records to a CollisionWorld, and messages, read as by the node, to a CollisionRun."""

from __future__ import annotations

from types import TracebackType
from typing import Any, NamedTuple

import numpy as np
from rclpy.serialization import serialize_message
from worlds.gate_world import observed

from campaigns.bad_input.clean_scene import CLEAN, ENDING, record_bytes
from fracture_collision.records import FragmentStates
from fracture_collision.ros.service.collision_run import CollisionRun
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import deserialize_record, serialize_record
from fracture_collision.ros.wire.conversion import heading, to_message
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings, StatesAhead

RUN_ID = 41
MESSAGE_CLASSES = {topic.name: topic.message_class for topic in qos.TOPICS}
TAKEN, REFUSED, HELD = "taken", "refused", "held"


class Verdict(NamedTuple):
    outcome: str  # TAKEN, REFUSED, or HELD until what it refers to arrives
    kind: str = ""
    text: str = ""
    site: tuple[str, int] | None = None  # file and line of the refusal, if known
    answer: bytes = b""  # for states


class WorldDoor:
    """Records, as passed by a user of the library."""

    def __init__(self, settings: Settings) -> None:
        self.world = CollisionWorld(settings)
        self.events = 0  # accepted
        self._deliver = {
            "bodies": self.world.add_body, "fracture_events": self.world.add_fracture,
            "fragment_states": lambda states: record_bytes(self.world.contacts(states)),
            "fragment_meshes": lambda fragment_id: record_bytes(self.world.fragment_mesh(fragment_id)),
        }  # fmt: skip
        admit_all(self, CLEAN)

    def deliver(self, topic: str, record: Any) -> Verdict:
        try:
            answer = self._deliver[topic](record) or b""
        except StatesAhead as error:
            return Verdict(HELD, error.kind, str(error), site_of(error.__traceback__))
        except InvalidMessage as error:
            return Verdict(REFUSED, error.kind, str(error), site_of(error.__traceback__))
        if topic == "fracture_events":
            self.events = max(self.events, record.sequence)
        return Verdict(TAKEN, answer=answer)


class RunDoor:
    """Messages, from their bytes to the entries on /diagnostics: everything that the node does except DDS."""

    def __init__(self, settings: Settings) -> None:
        self.run = CollisionRun(RUN_ID, settings)
        self.world = self.run.world
        admit_all(self, CLEAN)

    @property
    def events(self) -> int:
        return self.run.event_count

    def deliver(self, topic: str, record: Any) -> Verdict:
        """A record, or serialized bytes."""
        data = record if isinstance(record, bytes) else as_bytes(record)
        try:
            received = deserialize_record(data, MESSAGE_CLASSES[topic])
        except ValueError as error:
            return Verdict(REFUSED, "malformed", str(error))
        if topic == "fragment_states":
            return self._ask(received.record)
        before = self.run.held_event_count
        refusals = (self.run.add_body if topic == "bodies" else self.run.add_fracture)(received.record)
        if self.run.held_event_count > before:
            return Verdict(HELD, refusals[0].kind, refusals[0].reason)
        if refusals:
            return Verdict(REFUSED, refusals[0].kind, refusals[0].reason)
        return Verdict(TAKEN)

    def _ask(self, states: FragmentStates) -> Verdict:
        try:
            contacts = self.run.answer(states)
        except InvalidMessage as error:
            return Verdict(REFUSED, error.kind, str(error))
        if contacts is None:
            return Verdict(HELD)
        return Verdict(TAKEN, answer=serialize_record(contacts, heading(0.0), RUN_ID))


Door = WorldDoor | RunDoor
DOORS: dict[str, type[WorldDoor] | type[RunDoor]] = {"records": WorldDoor, "messages": RunDoor}


def as_bytes(record: Any) -> bytes:
    if isinstance(record, FragmentStates):
        return serialize_record(record, heading(0.0), RUN_ID)
    return serialize_message(to_message(record, heading(0.0), RUN_ID))


def admit_all(door: Door, messages: Any) -> bytes:
    """All of them must be accepted; returns the answers, concatenated."""
    verdicts = [door.deliver(topic, record) for topic, record in messages]
    if any(verdict.outcome != TAKEN for verdict in verdicts):
        raise AssertionError(f"the clean scene is not taken: {verdicts}")
    return b"".join(verdict.answer for verdict in verdicts)


def ending(door: Door) -> bytes:
    """The rest of the clean scene from here: all answers, and the registry at the end."""
    return admit_all(door, ENDING) + b"".join(observed(door.world))


def unsound(world: CollisionWorld, events: int) -> str:
    """Describes what is wrong with a world after it accepted a message; "" if nothing is."""
    nobody = FragmentStates(20, events, np.zeros(0, int), np.zeros(0), np.zeros(0))
    for sequence in (1, events):
        world.contacts(nobody._replace(fracture_sequence=sequence))
        told = world.fragments()
        count = len(told.fragment_ids)
        contacts = world.contacts(FragmentStates(
            21, sequence, told.fragment_ids, np.zeros(3 * count), np.tile([0.0, 0.0, 0.0, 1.0], count)
        ))  # fmt: skip
        for record in (contacts, told):
            for name, value in record._asdict().items():
                if isinstance(value, np.ndarray) and value.dtype.kind == "f" and np.isnan(value).any():
                    return f"{name} of {type(record).__name__} is not a number"
        if not (told.masses >= 0.0).all():  # 0: the mass of a plane
            return f"masses {told.masses}"
    return ""


def site_of(trace: TracebackType | None) -> tuple[str, int]:
    """File and line of the innermost frame other than `refuse` itself."""
    site = ("", 0)
    while trace is not None:
        code = trace.tb_frame.f_code
        if code.co_name != "refuse":
            site = (code.co_filename, trace.tb_lineno)
        trace = trace.tb_next
    return site

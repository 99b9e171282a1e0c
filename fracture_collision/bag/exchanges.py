"""The messages of a recorded run: bodies, events, and each question with its recorded answer.

Topics are identified by their message types, so the run may have been recorded under any namespace.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from fracture_collision.bag.mcap_file import BagError
from fracture_collision.bag.reader import read_messages, settings_values, topic_types
from fracture_collision.cdr import Codec, Heading, Layout, Received
from fracture_collision.records import (
    CollisionBody,
    ContactConstraintArray,
    FractureEvent,
    FragmentMesh,
    FragmentRegistry,
    FragmentStates,
)

_FIRST = (("header", "std_msgs/Header"), ("run_id", "uint64"))
# Those of the generated message classes, without which bags can be read.
LAYOUTS: dict[type, Layout] = {
    CollisionBody: (
        *_FIRST, ("operation", "uint8"), ("sequence", "uint64"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("name", "string"), ("primitive", "shape_msgs/SolidPrimitive"), ("plane", "shape_msgs/Plane"),
        ("vertices", "sequence<double>"), ("triangles", "sequence<uint32>"), ("tetrahedra", "sequence<uint32>"),
        ("is_static", "boolean"), ("density", "double"), ("friction", "double"), ("restitution", "double"),
    ),
    FractureEvent: (
        *_FIRST, ("sequence", "uint64"), ("body_id", "uint32"), ("fragment_id", "uint32"),
        ("new_fragment_ids", "sequence<uint32>"), ("nodes", "sequence<uint32>"),
        ("node_fragments", "sequence<uint32>"), ("cut_edges", "sequence<uint32>"), ("cut_planes", "sequence<double>"),
    ),
    FragmentStates: (
        *_FIRST, ("step", "uint64"), ("fracture_sequence", "uint64"), ("body_sequence", "uint64"),
        ("fragment_ids", "sequence<uint32>"), ("positions", "sequence<double>"), ("orientations", "sequence<double>"),
        ("linear_velocities", "sequence<double>"), ("angular_velocities", "sequence<double>"),
    ),
    ContactConstraintArray: (
        *_FIRST, ("step", "uint64"), ("fracture_sequence", "uint64"), ("status", "uint32"),
        ("fragment_a", "sequence<uint32>"), ("fragment_b", "sequence<uint32>"), ("pair_begin", "sequence<uint32>"),
        ("missed_depth_bound", "sequence<double>"), ("friction", "sequence<double>"),
        ("restitution", "sequence<double>"), ("points_a", "sequence<double>"), ("points_b", "sequence<double>"),
        ("normals", "sequence<double>"), ("gaps", "sequence<double>"), ("contact_ids", "sequence<uint64>"),
        ("lookahead", "double"),
    ),
    FragmentRegistry: (
        *_FIRST, ("fracture_sequence", "uint64"), ("fragment_ids", "sequence<uint32>"),
        ("body_ids", "sequence<uint32>"), ("parent_ids", "sequence<uint32>"), ("masses", "sequence<double>"),
        ("centers_of_mass", "sequence<double>"), ("inertias", "sequence<double>"),
        ("sampling_gaps", "sequence<double>"), ("digest", "string"), ("settings", "string"),
    ),
    FragmentMesh: (
        *_FIRST, ("fragment_id", "uint32"), ("vertices", "sequence<float>"), ("triangles", "sequence<uint32>"),
        ("is_crack", "sequence<boolean>"),
    ),
}  # fmt: skip

# Of nested messages.
NESTED_LAYOUTS: dict[str, Layout] = {
    "std_msgs/Header": (("stamp", "builtin_interfaces/Time"), ("frame_id", "string")),
    "builtin_interfaces/Time": (("sec", "int32"), ("nanosec", "uint32")),
    "shape_msgs/SolidPrimitive": (
        ("type", "uint8"), ("dimensions", "sequence<double, 3>"), ("polygon", "geometry_msgs/Polygon"),
    ),
    "shape_msgs/Plane": (("coef", "double[4]"),),
    "geometry_msgs/Polygon": (("points", "sequence<geometry_msgs/Point32>"),),
}  # fmt: skip

_CODECS = {
    record_class: Codec(record_class, layout, NESTED_LAYOUTS.__getitem__) for record_class, layout in LAYOUTS.items()
}


def present_codec(record_class: Any) -> Codec:
    """Reads and writes messages of the present definition."""
    return _CODECS[record_class]


def codec_of(record_class: Any, layout: Layout) -> Codec | None:
    """Reads messages of a layout from a bag: the present one, or an earlier one without fields that have a default.

    None if it is neither.
    """
    present = LAYOUTS[record_class]
    if layout == present:
        return _CODECS[record_class]
    names = {name for name, _ in layout}
    earlier = tuple(field for field in present if field[0] in names or field[0] not in record_class._field_defaults)
    return Codec(record_class, layout, NESTED_LAYOUTS.__getitem__) if layout == earlier else None


def serialize_record(record: NamedTuple, heading: Heading, run_id: int) -> bytes:
    """The serialized message of a record of LAYOUTS. Raises as Codec.write does."""
    return _CODECS[type(record)].write(record, heading, run_id)


def deserialize_record(data: bytes, record_class: Any) -> Received:
    """The record of a serialized message of the same name. Raises as Codec.read does."""
    return _CODECS[record_class].read(data)


PACKAGE = "fracture_collision/msg/"
_CLASSES = (CollisionBody, FractureEvent, FragmentStates, ContactConstraintArray)
# Types that the generated message classes name differently from .msg files.
_TYPE_WORDS = {"float64": "double", "float32": "float", "bool": "boolean"}


class Message(NamedTuple):
    """A recorded message, serialized and as a record."""

    data: bytes  # as recorded
    received: Received


class Question(NamedTuple):
    """Recorded states and the answers to them."""

    step: int
    fracture_sequence: int
    time: int  # [ns] of its heading
    bodies_before: int  # number of the run's messages on `bodies` that were recorded before it
    states: bytes  # as recorded
    answers: tuple[bytes, ...]  # the recorded ones, each once: none, one, or several that contradict each other; in the
    # present definition, with zeroed padding


class Run(NamedTuple):
    """All recorded messages of one run id."""

    run_id: int
    bodies: list[Message]  # in the order of recording
    events: list[Message]  # ascending in sequence
    questions: list[Question]  # ascending in step
    unasked: list[int]  # steps with an answer, but without the states that it answers; ascending
    answers_as: Codec  # the definition of the answers when they were recorded

    def as_recorded(self, answer: bytes) -> bytes:
        """An answer without the fields that answers did not have yet when the run was recorded."""
        if self.answers_as.is_complete:
            return answer
        heading, run_id, record = deserialize_record(answer, ContactConstraintArray)
        return self.answers_as.write(record, heading, run_id)


class _Gathered:
    """One run while the bag is read."""

    def __init__(self) -> None:
        self.bodies: dict[bytes, Message] = {}  # latched: a repeated delivery adds nothing
        self.events: dict[bytes, Message] = {}
        self.states: dict[tuple[int, int], tuple[bytes, int, int]] = {}  # by step and sequence: data, time, bodies
        self.answers: dict[tuple[int, int], dict[bytes, None]] = {}
        self.answers_as = present_codec(ContactConstraintArray)


def read_runs(bag: Path, namespace: str | None = None) -> list[Run]:
    """The runs of a bag in the order in which they began: a rosbag2 folder, or one .mcap file.

    `namespace`: of the topics, if there are several. A repeated message counts once. Raises BagError with an
    explanation if the bag holds no run, or a message is not of its topic's type.
    """
    codecs = topics_of(bag, _CLASSES, namespace)
    runs: dict[int, _Gathered] = {}
    for count, message in enumerate(read_messages(bag, list(codecs))):
        codec = codecs[message.topic]
        try:
            received = codec.read(message.data)
        except ValueError as error:
            raise BagError(f"{bag}: {message.topic}, message {count} at {message.nanoseconds} ns: {error}") from error
        run = runs.setdefault(received.run_id, _Gathered())
        try:
            _gather(run, Message(message.data if codec.is_complete else canonical(received), received))
            if isinstance(received.record, ContactConstraintArray):
                run.answers_as = codec
        except BagError as error:
            raise BagError(f"{bag}: {message.topic}: {error}") from error
    found = [_run(run_id, run) for run_id, run in runs.items()]
    found = [run for run in found if run.questions or run.unasked]
    if not any(run.questions for run in found):
        raise BagError(f"{bag}: holds no {PACKAGE}FragmentStates")
    return found


def answers_missing(bag: Path, namespace: str | None = None) -> str:
    """Explains why a bag without answers has none."""
    name = PACKAGE + ContactConstraintArray.__name__
    if topics_of(bag, [ContactConstraintArray], namespace):
        return f"{bag} has no answer to any of these steps"
    others = ", ".join(f"{topic} ({kind})" for topic, (kind, _) in topic_types(bag).items() if PACKAGE not in kind)
    return f"{bag} has no topic of type {name}" + (f"; its other topics are {others[:300]}" if others else "")


def registry_settings(bag: Path, namespace: str | None = None) -> list[dict[str, Any]]:
    """The settings in the recorded registries, by name and not validated, in the order of recording.

    Several if they changed; none if the bag has no registries, or only such as lack the field. Raises BagError.
    """
    codecs = topics_of(bag, [FragmentRegistry], namespace)
    texts: list[str] = []
    for message in read_messages(bag, list(codecs)) if codecs else ():
        try:
            text = codecs[message.topic].read(message.data).record.settings
        except ValueError as error:
            raise BagError(f"{bag}: {message.topic}: {error}") from error
        if text and texts[-1:] != [text]:
            texts.append(text)
    return [settings_values(text, f"{bag}: settings of {FragmentRegistry.__name__}") for text in texts]


def canonical(received: Received) -> bytes:
    """The message serialized with zeroed padding: equal messages have equal bytes."""
    return serialize_record(received.record, received.heading, received.run_id)


def topics_of(bag: Path, record_classes: Iterable[Any], namespace: str | None = None) -> dict[str, Codec]:
    """What reads each topic's messages, for the topics whose message types are those of `record_classes`.

    Raises BagError if they are of several services, or were recorded with a definition that this package never had.
    """
    known = {PACKAGE + record_class.__name__: record_class for record_class in record_classes}
    codecs: dict[str, Codec] = {}
    for topic, (name, definition) in topic_types(bag).items():
        if name in known and (namespace is None or topic.rpartition("/")[0] == "/" + namespace.strip("/")):
            codecs[topic] = _codec(bag, topic, known[name], definition)
    namespaces = sorted({topic.rpartition("/")[0] for topic in codecs})
    if len(namespaces) > 1:
        names = ", ".join(each or "/" for each in namespaces)
        raise BagError(f"{bag}: has the topics of several services, under {names}; choose one with --namespace")
    return codecs


def _codec(bag: Path, topic: str, record_class: Any, definition: str) -> Codec:
    expected, found = list(LAYOUTS[record_class]), defined_fields(definition)
    codec = codec_of(record_class, tuple(found))
    if codec is None:
        differing = [name for name, kind in expected + found if ((name, kind) in expected) != ((name, kind) in found)]
        what = ", ".join(dict.fromkeys(differing)) or "the order of its fields"
        raise BagError(f"{bag}: {topic}: recorded with another definition of {record_class.__name__}: {what[:200]}")
    return codec


def defined_fields(definition: str) -> list[tuple[str, str]]:
    """Name and type of each field of a .msg text, without those of the types that it uses."""
    fields = []
    for line in definition.partition("\n===")[0].splitlines():
        words = line.partition("#")[0].split()
        if len(words) >= 2 and not any("=" in word for word in words[1:3]):  # else a constant, or nothing
            kind = words[0].removesuffix("[]").replace("/msg/", "/")
            kind = _TYPE_WORDS.get(kind, kind)
            fields.append((words[1], f"sequence<{kind}>" if words[0].endswith("[]") else kind))
    return fields


def _gather(run: _Gathered, message: Message) -> None:
    record = message.received.record
    if isinstance(record, CollisionBody):
        run.bodies.setdefault(message.data, message)
    elif isinstance(record, FractureEvent):
        run.events.setdefault(message.data, message)
    elif isinstance(record, FragmentStates):
        heading = message.received.heading
        question = message.data, heading.sec * 10**9 + heading.nanosec, len(run.bodies)
        known = run.states.setdefault((record.step, record.fracture_sequence), question)
        if known[0] != message.data and canonical(deserialize_record(known[0], FragmentStates)) != canonical(
            message.received
        ):
            raise BagError(f"step {record.step} was queried twice with different states")
    else:
        run.answers.setdefault((record.step, record.fracture_sequence), {})[canonical(message.received)] = None


def _run(run_id: int, run: _Gathered) -> Run:
    questions = [
        Question(step, sequence, time, bodies, data, tuple(run.answers.get((step, sequence), ())))
        for (step, sequence), (data, time, bodies) in run.states.items()
    ]
    return Run(
        run_id,
        list(run.bodies.values()),
        sorted(run.events.values(), key=lambda message: message.received.record.sequence),
        sorted(questions, key=lambda question: (question.step, question.fracture_sequence)),
        sorted(step for step, sequence in run.answers if (step, sequence) not in run.states),
        run.answers_as,
    )

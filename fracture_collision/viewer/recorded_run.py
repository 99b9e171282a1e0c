"""A run as a bag holds it: bodies, fractures, meshes and where everything was at each step."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from fracture_collision.bag.reader import BagError, mcap_files
from fracture_collision.records import REMOVE, CollisionBody, FragmentMesh, SolidPrimitive

PACKAGE = "fracture_collision/msg/"


class RecordedStates(NamedTuple):
    time: float  # [s], simulated
    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray  # (n,)
    positions: np.ndarray  # (n, 3) [m]
    orientations: np.ndarray  # (n, 4) x y z w


class RecordedRun(NamedTuple):
    bodies: dict[int, CollisionBody]  # by body_id
    body_of: dict[int, int]  # fragment_id -> body_id
    meshes: dict[int, FragmentMesh]  # by fragment_id
    states: list[RecordedStates]  # ascending in step


def read_run(bag: Path) -> RecordedRun:
    """Read the last run of a bag: a rosbag2 folder, or one .mcap file.

    Topics are known by their message types, so the run may have been recorded under any namespace. Raises BagError in
    words where there is no such file, or no FragmentStates in it.
    """
    messages: dict[int, dict[str, list[Any]]] = {}
    last_run = None
    for kind, message in _messages(mcap_files(bag)):
        messages.setdefault(message.run_id, {}).setdefault(kind, []).append(message)
        if kind == "FragmentStates":
            last_run = message.run_id
    if last_run is None:
        raise BagError(f"{bag}: holds no {PACKAGE}FragmentStates")
    run = messages[last_run]
    bodies = {m.body_id: _body(m) for m in run.get("CollisionBody", []) if m.operation != REMOVE}
    body_of = {body.fragment_id: body.body_id for body in bodies.values()}
    for event in run.get("FractureEvent", []):
        body_of.update((int(f), event.body_id) for f in event.new_fragment_ids)
    meshes = {m.fragment_id: _mesh(m) for m in run.get("FragmentMesh", [])}
    states = {m.step: _states(m) for m in run["FragmentStates"]}
    return RecordedRun(bodies, body_of, meshes, [states[step] for step in sorted(states)])


def _messages(files: list[Path]) -> Iterator[tuple[str, Any]]:
    kinds = ("CollisionBody", "FractureEvent", "FragmentMesh", "FragmentStates")
    for file in files:
        with file.open("rb") as stream:
            reader = make_reader(stream, decoder_factories=[DecoderFactory()])
            summary = reader.get_summary()
            topics = None
            if summary is not None:
                wanted = {PACKAGE + kind for kind in kinds}
                ids = {i for i, schema in summary.schemas.items() if schema.name in wanted}
                topics = [c.topic for c in summary.channels.values() if c.schema_id in ids]
                if not topics:
                    continue
            for schema, _, _, message in reader.iter_decoded_messages(topics=topics):
                kind = schema.name.removeprefix(PACKAGE)
                if kind in kinds:
                    yield kind, message


def _body(message: Any) -> CollisionBody:
    return CollisionBody(
        body_id=message.body_id,
        fragment_id=message.fragment_id,
        name=message.name,
        primitive=SolidPrimitive(message.primitive.type, tuple(message.primitive.dimensions)),
        plane=np.array(message.plane.coef, dtype=np.float64),
        vertices=np.array(message.vertices, dtype=np.float64),
        triangles=np.array(message.triangles, dtype=np.uint32),
        tetrahedra=np.array(message.tetrahedra, dtype=np.uint32),
        is_static=message.is_static,
    )


def _mesh(message: Any) -> FragmentMesh:
    return FragmentMesh(
        message.fragment_id,
        np.array(message.vertices, dtype=np.float32),
        np.array(message.triangles, dtype=np.uint32),
        np.array(message.is_crack, dtype=np.bool_),
    )


def _states(message: Any) -> RecordedStates:
    return RecordedStates(
        time=message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec,
        step=message.step,
        fracture_sequence=message.fracture_sequence,
        fragment_ids=np.array(message.fragment_ids, dtype=np.int64),
        positions=np.array(message.positions, dtype=np.float64).reshape(-1, 3),
        orientations=np.array(message.orientations, dtype=np.float64).reshape(-1, 4),
    )

"""Runs a scene end to end over DDS: service, simulator and recorder as three processes on this machine."""

from __future__ import annotations

import json
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np
from rclpy.serialization import deserialize_message

from fracture_collision.bag.reader import message_counts, read_messages, topic_digest
from fracture_collision.msg import CollisionBody, FragmentMesh, FragmentRegistry
from fracture_collision.ros.processes.node_process import NodeProcess
from fracture_collision.ros.processes.timing_files import SERVICE_COLUMNS, SIMULATOR_COLUMNS
from fracture_collision.ros.runs.run_domain import run_domain
from fracture_collision.run_report import summaries
from fracture_collision.simulation.engines import with_engine
from fracture_collision.simulation.scene.scene import load_scene

# [s] for the recorder to receive what is on its way when the simulator has ended.
RECORDER_PATIENCE = 20.0
POLL_INTERVAL = 0.05  # [s]
# Niceness of the recorder: on two processors a step waits 0.3 ms less for it. It may be late by 64 steps.
LATER = 10


class RunFailed(RuntimeError):
    """A process ended early, or the recording is incomplete; the text has the cause and the end of the log."""


class Progress(NamedTuple):
    """How far a run is."""

    step: int  # steps done
    steps: int  # in all; 0 until known
    time: float  # [s] simulated
    fragments: int  # that move
    contacts: int
    word: str  # the service's last log line, before the first step


def run_scene(
    scene: str, seed: int | None, out: Path, on_progress: Callable[[Progress], None], engine: str | None = None
) -> dict[str, Any]:  # fmt: skip
    """Runs `scene` to its end; returns the report (see `make_report`).

    Writes out/bag and out/logs, which must not exist yet. Raises RunFailed, DomainTaken. In any case no process is left
    behind.
    """
    logs, bag = out / "logs", out / "bag"
    logs.mkdir(parents=True)
    times = {name: logs / f"{name}.npy" for name in ("collision_node", "simulator_node")}
    simulator_parameters = {
        "scene": scene, "timing_file": str(times["simulator_node"]), "progress": True, "wait_for_subscribers": 2,
        "engine": engine or "",
    }  # fmt: skip
    if seed is not None:
        simulator_parameters["seed"] = seed
    what = with_engine(load_scene(scene), engine)
    time_step = what.time_step
    started = time.monotonic()
    with run_domain() as domain_id, ExitStack() as processes:
        def start(
            module: str, parameters: dict[str, Any], stdout: int | None = None, niceness: int = 0
        ) -> NodeProcess:
            process = NodeProcess(module, parameters, domain_id, logs / f"{module}.log", stdout, niceness=niceness)
            processes.callback(process.stop)
            return process

        service = start("collision_node", {"timing_file": str(times["collision_node"]), "lookahead": time_step})
        recorder = start("recorder_node", {"folder": str(bag), "progress": True}, subprocess.PIPE, LATER)
        simulator = start("simulator_node", simulator_parameters, subprocess.PIPE)
        with _last_line(simulator.stdout) as told, _last_line(recorder.stdout) as recorded:
            while (status := simulator.exit_status()) is None:
                _check_alive(service, recorder)
                on_progress(_progress(told(), service))
                time.sleep(POLL_INTERVAL)
            if status != 0:
                raise RunFailed(simulator.last_words())
            on_progress(_progress(told(), service))
            steps = told()["step"]
            _await_recording(recorded, steps, service, recorder)
        # In this order: the service must run until the recorder has ended.
        for process in (recorder, service):
            if process.stop() != 0:
                raise RunFailed(process.last_words())
    seconds = time.monotonic() - started
    report = make_report(np.load(times["collision_node"]), np.load(times["simulator_node"]))
    counts = message_counts(bag)
    for topic in ("/fragment_states", "/contact_constraints"):
        if counts[topic] < steps:
            raise RunFailed(f"{bag}: {counts[topic]} messages on {topic}, but the run had {steps} steps")
    living, totals = _at_the_end(bag)
    totals["time_step_ms"] = 1e3 * float(report["time"][0])
    return {
        "scene": scene,
        "engine": what.engine,
        "seed": seed,
        "seconds": seconds,
        "living_fragments": living,
        "triangles": totals["triangles_after"],
        "totals": totals,
        "digests": {topic: topic_digest(bag, topic) for topic in ("/fragment_states", "/contact_constraints")},
        "messages": counts,
        **report,
    }


def make_report(service: np.ndarray, simulator: np.ndarray) -> dict[str, Any]:
    """Lists with one number per step from both nodes' timing files, and the median, average and worst of each.

    total_ms: the whole step. collision_ms: broad and narrow phase. update_ms: applying fracture events, in steps that
    brought some, else 0. solver_ms: contact solver. fracture_ms: making the patterns of what breaks. physics_ms: the
    rest of the simulator's part. ros_ms: from states published to contacts received, less collision and update.
    """
    answers = {name: service[:, column] for column, name in enumerate(SERVICE_COLUMNS)}
    report = {name: simulator[:, column] for column, name in enumerate(SIMULATOR_COLUMNS)}
    # A repeated request was answered twice; the last answer counts.
    row_of = {int(step): row for row, step in enumerate(answers["step"])}
    missing = [int(step) for step in report["step"] if int(step) not in row_of]
    if missing:
        raise RunFailed(f"the service has no times of {len(missing)} steps, the first is {missing[0]}")
    rows = np.array([row_of[int(step)] for step in report["step"]], dtype=np.int64)
    collision, update = answers["collision"][rows], answers["update"][rows]
    broke = np.diff(answers["fracture_sequence"][rows], prepend=0.0) > 0
    milliseconds = {
        "total_ms": report["total"],
        "collision_ms": collision,
        "update_ms": np.where(broke, update, 0.0),
        "physics_ms": report["total"] - report["round_trip"] - report["fracture"],
        "solver_ms": report["solver"],
        "fracture_ms": report["fracture"],
        "ros_ms": report["round_trip"] - collision - update,
    }
    columns = {name: 1e3 * values for name, values in milliseconds.items()}
    for name in ("time", "kinetic_energy", "potential_energy", "drift_energy", "max_speed", "deepest_gap"):
        columns[name] = report[name]
    integers = {name: report[name].astype(int).tolist() for name in ("step", "contacts", "fragments")}
    summary = summaries({name: columns[name] for name in milliseconds} | {"contacts": report["contacts"]})
    return {"summary": summary, **integers, **{name: values.tolist() for name, values in columns.items()}}


def _at_the_end(bag: Path) -> tuple[int, dict[str, float]]:
    """Number of all fragments at the end, and totals as in `scene_run`, of bodies that are tetrahedral meshes."""
    meshes = {m.fragment_id: len(m.triangles) for m in _messages(bag, "/fragment_meshes", FragmentMesh)}
    pieces_of = {m.body_id: m.is_static for m in _messages(bag, "/bodies", CollisionBody) if len(m.tetrahedra)}
    registries = deque(_messages(bag, "/fragments", FragmentRegistry), maxlen=1)
    if not registries:
        raise RunFailed(f"{bag}: no FragmentRegistry")
    registry = registries.pop()
    pieces = [(i, body) for i, body in zip(registry.fragment_ids, registry.body_ids, strict=True) if body in pieces_of]
    return len(registry.fragment_ids), {
        "triangles_after": sum(meshes[fragment_id] for fragment_id, _ in pieces),
        "fragments": sum(not pieces_of[body] for _, body in pieces),
    }


def _messages(bag: Path, topic: str, message_class: Any) -> Iterator[Any]:
    for message in read_messages(bag, [topic]):
        yield deserialize_message(message.data, message_class)


@contextmanager
def _last_line(stream: IO[str]) -> Iterator[Callable[[], dict[str, Any]]]:
    """Reads lines of JSON as they come; yields a function that returns the last one, {} before the first."""
    last: dict[str, Any] = {}

    def read() -> None:
        for line in stream:
            if line.startswith("{"):  # some libraries print to stdout
                last.update(json.loads(line))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()

    def newest() -> dict[str, Any]:
        return dict(last)

    yield newest


def _progress(told: dict[str, Any], service: NodeProcess) -> Progress:
    word = ""
    if not told:
        lines = service.log_text().splitlines()
        word = lines[-1].split("]: ")[-1] if lines else "starting"
    return Progress(
        told.get("step", 0), told.get("steps", 0), told.get("time", 0.0), told.get("fragments", 0),
        told.get("contacts", 0), word,
    )  # fmt: skip


def _check_alive(*processes: NodeProcess) -> None:
    for process in processes:
        if process.exit_status() is not None:
            raise RunFailed(process.last_words())


def _await_recording(recorded: Callable[[], dict[str, int]], steps: int, *processes: NodeProcess) -> None:
    deadline = time.monotonic() + RECORDER_PATIENCE
    wanted = {"fragment_states": steps, "contact_constraints": steps, "fragments": 1}
    while any(recorded().get(topic, 0) < count for topic, count in wanted.items()):
        _check_alive(*processes)
        if time.monotonic() > deadline:
            raise RunFailed(f"the recorder has only {recorded()} of {steps} steps")
        time.sleep(POLL_INTERVAL)

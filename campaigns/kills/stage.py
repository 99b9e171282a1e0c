"""Real nodes in a domain of their own, runs of a scene with a node killed in mid-run, and what is left of them."""

from __future__ import annotations

import hashlib
import json
import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from fracture_collision.bag.reader import read_messages, topic_digest, without_run_id
from fracture_collision.ros.processes.node_process import NodeProcess, free_domain_id
from fracture_collision.ros.processes.shared_memory import YOUNG, dead_segments, remove_dead_segments

PATIENCE = 300.0  # [s] a node that takes longer counts as hung
LOOK = 0.02  # [s] shorter intervals would take time from the nodes, which measure by their own clocks
COMPARED = ("/bodies", "/fracture_events", "/fragment_states")
SETTLED = 3.0  # [s] after which no further messages arrive
READY = "ready, "
_STEP = re.compile(r'"step": (\d+)')
_READY = re.compile(rf"{READY}([0-9.]+) s after its process was started")
_GOES_ON = re.compile(r"\[(\d+\.\d+)\] \[[^]]*\]: step \d+ is answered after")


class Stage:
    """Starts nodes in one domain; `close` ends them all."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self.domain_id = free_domain_id()
        self._nodes: list[NodeProcess] = []
        self._started = 0

    def start(self, module: str, *arguments: str, **parameters: Any) -> NodeProcess:
        """`module`: below fracture_collision.ros. `arguments`: for namespace and remapping."""
        self._started += 1
        log = self._folder / f"{module}_{self._started}.log"
        self._nodes.append(NodeProcess(module, parameters, self.domain_id, log, arguments=arguments))
        return self._nodes[-1]

    def forget(self, node: NodeProcess) -> None:
        """Drops a node that has ended."""
        self._nodes.remove(node)

    def close(self) -> None:
        for node in reversed(self._nodes):
            node.stop()


@contextmanager
def stage(folder: Path) -> Iterator[Stage]:
    made = Stage(folder)
    try:
        yield made
    finally:
        made.close()


class Digests(NamedTuple):
    """SHA-256 of a run's output, by topic of COMPARED and by answer, and its last registry's own digest."""

    topics: tuple[str, ...]
    answers: dict[int, str]  # by step
    registry: str

    def lost(self, undisturbed: Digests) -> int:
        """Number of answers of an undisturbed run that are missing."""
        return len(undisturbed.answers.keys() - self.answers.keys())

    def differs(self, undisturbed: Digests, may_lack: int = 0) -> bool:
        """Whether anything differs, or more than `may_lack` answers are missing.

        A service that is killed while it publishes an answer may have reached the simulator and not a recorder. The
        simulator then continues and does not request the answer again.
        """
        same = (self.topics, self.registry) == (undisturbed.topics, undisturbed.registry)
        equal = all(undisturbed.answers.get(step) == answer for step, answer in self.answers.items())
        return not same or not equal or self.lost(undisturbed) > may_lack


def digests(bag: Path) -> Digests:
    """Raises ValueError if there is no registry."""
    from fracture_collision.msg import ContactConstraintArray, FragmentRegistry
    from rclpy.serialization import deserialize_message

    from fracture_collision.ros.wire.cdr_records import deserialize_record

    last = None
    for message in read_messages(bag, ["/fragments"]):
        last = message.data
    if last is None:
        raise ValueError(f"{bag}: no registry")
    registry = deserialize_message(last, FragmentRegistry)
    answers = {}
    for message in read_messages(bag, ["/contact_constraints"]):
        step = deserialize_record(message.data, ContactConstraintArray).record.step
        answer = hashlib.sha256(without_run_id(message.data)).hexdigest()
        if answers.setdefault(step, answer) != answer:
            raise ValueError(f"{bag}: two answers to step {step}")
    return Digests(tuple(topic_digest(bag, topic) for topic in COMPARED), answers, registry.digest)


def await_that(condition: Callable[[], bool], what: str, *alive: NodeProcess) -> float:
    """[s] until it holds. Raises RuntimeError if one of `alive` ends before, or after PATIENCE."""
    began = time.perf_counter()
    while not condition():
        for node in alive:
            if node.exit_status() is not None:
                raise RuntimeError(f"{what}: {node.name} ended with {node.exit_status()}:\n{node.log_text()[-2000:]}")
        if time.perf_counter() - began > PATIENCE:
            raise RuntimeError(f"in vain: {what}")
        time.sleep(LOOK)
    return time.perf_counter() - began


def await_words(node: NodeProcess, words: str, *alive: NodeProcess) -> float:
    """[s] until they appear in its log, or one of `alive` has ended with status 0."""
    return await_that(
        lambda: words in node.log_text() or any(other.exit_status() == 0 for other in alive), words, node
    )


def await_ready(service: NodeProcess, *alive: NodeProcess) -> float:
    """[s] until the service reports that it is ready."""
    return await_that(lambda: READY in service.log_text(), "a ready service", service, *alive)


def await_step(simulator: NodeProcess, step: int, *alive: NodeProcess) -> float:
    """[s] until it reports a later step or has ended."""
    return await_that(
        lambda: simulator.exit_status() is not None or steps_told(simulator) > step, f"a step after {step}", *alive
    )


def await_end(simulator: NodeProcess, *alive: NodeProcess) -> float:
    """[s] until the scene has ended."""
    return await_that(lambda: simulator.exit_status() is not None, "the scene's end", *alive)


def steps_told(simulator: NodeProcess) -> int:
    """The last step that it reported; needs its parameter `progress`."""
    told = _STEP.findall(simulator.log_text())
    return int(told[-1]) if told else 0


def ready_told(service: NodeProcess) -> float:
    """[s] from the start of its process until it was ready, as it reports itself."""
    return float(_READY.search(service.log_text())[1])


def answers_awaited(simulator: NodeProcess) -> list[float]:
    """[s] of time.time() at the arrival of each answer that it had to request again."""
    return [float(told) for told in _GOES_ON.findall(simulator.log_text())]


def await_recording(
    recorder: NodeProcess, simulator: NodeProcess, *alive: NodeProcess, may_lack: int = 0
) -> float:
    """[s] until it has states and contacts of every step that the simulator reported, and a registry.

    Both nodes need their parameter `progress`. Up to `may_lack` contacts may be missing once none has arrived for
    SETTLED.
    """
    steps = steps_told(simulator)
    most, since = 0, time.monotonic()

    def counts() -> dict[str, int]:
        lines = [line for line in recorder.log_text().splitlines() if line.startswith("{") and line.endswith("}")]
        return json.loads(lines[-1]) if lines else {}

    def is_there() -> bool:
        nonlocal most, since
        told = counts()
        states, contacts = (told.get(topic, 0) for topic in ("fragment_states", "contact_constraints"))
        if contacts > most:
            most, since = contacts, time.monotonic()
        is_settled = contacts >= steps - may_lack and time.monotonic() > since + SETTLED
        return told.get("fragments", 0) > 0 and states >= steps and (contacts >= steps or is_settled)

    try:
        return await_that(is_there, f"a recording of {steps} steps", recorder, *alive)
    except RuntimeError as error:
        logs = "\n".join(f"{node.name}:\n{node.log_text()[-3000:]}" for node in (recorder, simulator, *alive))
        raise RuntimeError(f"{error}; recorded: {counts()}\n{logs}") from error


def must_end(node: NodeProcess) -> None:
    """Raises RuntimeError unless it ends without a fault."""
    if fault := fault_at_end(node, node.stop(patience=60.0)):
        raise RuntimeError(fault)


def fault_at_end(node: NodeProcess, status: int) -> str:
    """Description; "" if it ended with status 0 and no traceback."""
    text = node.log_text()
    return f"{node.name} ended with {status}:\n{text[-2000:]}" if status != 0 or "Traceback" in text else ""


class Litter(NamedTuple):
    files: frozenset[Path]  # segments of Fast DDS in shared memory, unused
    processes: frozenset[int]  # nodes without a parent


def litter() -> Litter:
    """What is left behind."""
    time.sleep(1.5 * YOUNG)  # recent leftovers still count as new
    return Litter(frozenset(dead_segments()), frozenset(_orphans()))


def await_no_litter(before: Litter) -> None:
    """Waits until nothing is left but what was there before; raises RuntimeError if something remains.

    It cleans up as the next node would at startup: the last cleanup spares recent files, and other programs that end
    nodes on this machine leave such files too.
    """

    def is_clean() -> bool:
        remove_dead_segments()
        left = litter()
        return left.files <= before.files and left.processes <= before.processes

    await_that(is_clean, "nothing left behind")


def _orphans() -> Iterator[int]:
    """Nodes of this package whose parent no longer exists."""
    for folder in Path("/proc").iterdir():
        if not folder.name.isdigit():
            continue
        try:
            words = (folder / "cmdline").read_bytes().split(b"\0")
            parent = int((folder / "stat").read_text().rsplit(")", 1)[1].split()[1])
        except (OSError, IndexError, ValueError):
            continue
        is_ours = any(word.startswith(b"fracture_collision.ros.") for word in words)
        if is_ours and parent in (0, 1) and folder.stat().st_uid == os.getuid():
            yield int(folder.name)

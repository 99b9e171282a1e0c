"""Bags recorded on the user's request, one after another: a recorder_node each, in a process of its own."""

from __future__ import annotations

from itertools import count
from pathlib import Path

from fracture_collision.ros.processes.node_process import NodeProcess, default_domain_id


class RecordingFailed(RuntimeError):
    """Its text has the reason, or the file that has it."""


class Recordings:
    """At most one at a time, into bag_1, bag_2 ... of a folder."""

    def __init__(self, folder: Path, namespace: str) -> None:
        """`namespace`: of the nodes to record."""
        self._folder = folder
        self._namespace = namespace
        self._running: tuple[Path, NodeProcess] | None = None

    def begin(self) -> Path:
        """Starts a recording; returns its bag. Raises RecordingFailed."""
        try:
            bag = _new_folder(self._folder)
            node = NodeProcess(
                "recorder_node", {"folder": str(bag)}, default_domain_id(), bag.with_suffix(".log"),
                arguments=("-r", f"__ns:={self._namespace}"),
            )  # fmt: skip
        except OSError as error:
            raise RecordingFailed(f"cannot start a recording: {error}") from error
        self._running = bag, node
        return bag

    def end(self) -> Path | None:
        """Ends the recording; returns its complete bag, or None if there was none. Raises RecordingFailed."""
        if self._running is None:
            return None
        (bag, node), self._running = self._running, None
        if status := node.stop():
            raise RecordingFailed(f"the recorder of {bag} ended with status {status}; see {node.log}")
        return bag


def _new_folder(parent: Path) -> Path:
    """The first of bag_1, bag_2 ... that is the name of no bag and no recorder's log."""
    parent.mkdir(parents=True, exist_ok=True)
    bags = (parent / f"bag_{number}" for number in count(1))
    return next(bag for bag in bags if not (bag.exists() or bag.with_suffix(".log").exists()))

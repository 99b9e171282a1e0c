"""What the service publishes for states: their contacts and, if it has changed, the registry.

While there are subscribers, it also publishes surfaces of fragments, markers, contact poses and times.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from time import perf_counter

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher

from fracture_collision.cdr import Heading
from fracture_collision.records import ADD, CollisionBody, ContactConstraintArray, FragmentStates, refusal_of
from fracture_collision.ros.processes.parameters import Declaration, declare
from fracture_collision.ros.processes.process import Fatal
from fracture_collision.ros.processes.timing_files import SERVICE_COLUMNS, RowFile
from fracture_collision.ros.service.collision_run import CollisionRun
from fracture_collision.ros.service.diagnostics import AnswerTimes
from fracture_collision.ros.wire import qos
from fracture_collision.ros.wire.cdr_records import serialize_record
from fracture_collision.ros.wire.contact_poses import serialize_contact_poses
from fracture_collision.ros.wire.conversion import header_of, to_message
from fracture_collision.ros.wire.markers import MarkersPublisher
from fracture_collision.world.settings import settings_text

TIMING_FILE = Declaration("timing_file", "", ".npy file for the times of each answer; '': none")
LAST_MESHES = Duration(seconds=0.5)  # for all subscribers to acknowledge those of a run that is over


class Answers:
    """Publishers of a node. Parameter: timing_file."""

    def __init__(self, node: Node) -> None:
        self._node = node
        timing_file = declare(node, TIMING_FILE)
        self._rows = _row_file(timing_file) if timing_file else None
        self._registry_version: tuple[int, int, int, int, str] | None = None
        self._meshes_published: set[int] = set()
        self._meshes_version: tuple[int, int, int, int, str] | None = None  # of which all meshes are published
        self.times = AnswerTimes()
        self.last = "no answer yet"

        self._contacts, self._fragments, self._meshes, self._answer_times, self._poses = map(
            self._publisher_of,
            (qos.CONTACT_CONSTRAINTS, qos.FRAGMENTS, qos.FRAGMENT_MESHES, qos.ANSWER_TIMES, qos.CONTACT_POSES),
        )
        self._markers = MarkersPublisher(node)

    def _publisher_of(self, topic: qos.Topic) -> Publisher:
        return self._node.create_publisher(topic.message_class, topic.name, topic.qos)

    def forget(self) -> None:
        """Starts a new run."""
        self._registry_version = self._meshes_version = None
        self._markers.forget()
        if self._meshes_published:
            # A latched publisher sends its whole history to late joiners; these fragments are gone.
            self._meshes.wait_for_all_acked(LAST_MESHES)  # or a recorder would miss the last ones
            self._node.destroy_publisher(self._meshes)
            self._meshes = self._publisher_of(qos.FRAGMENT_MESHES)
            self._meshes_published.clear()

    def close(self) -> None:
        """Completes the timing file, if requested."""
        if self._rows is not None:
            self._rows.close()

    def add_body(self, run: CollisionRun, body: CollisionBody) -> None:
        """Takes a received body; `run` shows whether it was accepted."""
        if body.operation != ADD or body.body_id in run.body_ids:
            self._markers.add_body(body)

    def prepare(self, run: CollisionRun, heading: Heading) -> None:
        """Makes the fragments of a run whose states were not answered yet, and publishes their meshes."""
        if self._registry_version is None and not self._publish_new_meshes(run, heading):
            run.world.fragments()

    def refuse(self, run: CollisionRun, heading: Heading, states: FragmentStates) -> None:
        """Publishes that `states` are invalid: no contacts, and the status INVALID_STATES."""
        refusal = refusal_of(states, run.world.settings.lookahead)
        self._contacts.publish(serialize_record(refusal, heading, run.run_id))

    def publish(
        self, run: CollisionRun, heading: Heading, states: FragmentStates, contacts: ContactConstraintArray,
        seconds: float,
    ) -> None:  # fmt: skip
        """Publishes the answer to `states` and all that is due with it. `seconds`: the time that the contacts took."""
        began = perf_counter()
        self._publish_registry(run, heading, states.fracture_sequence)
        self._contacts.publish(serialize_record(contacts, heading, run.run_id))
        parts = {"answer": seconds, **run.world.last_timings, "conversion and publishing": perf_counter() - began}
        self.times.add(parts, run.world.last_visits)
        self.last = f"the answer to step {states.step} of run {run.run_id}"
        self._tell_times(run, heading, states, parts)
        self._publish_meshes(run, heading)
        if self._poses.get_subscription_count():
            self._poses.publish(serialize_contact_poses(contacts, heading))
        self._markers.after_answer(run.world, heading, states, contacts)

    def _publish_registry(self, run: CollisionRun, heading: Heading, fracture_sequence: int) -> None:
        settings = settings_text(run.world.settings)
        version = (run.run_id, fracture_sequence, len(run.body_ids), run.removals, settings)
        if version != self._registry_version:
            self._registry_version = version
            self._fragments.publish(to_message(run.world.fragments(), heading, run.run_id))

    def _tell_times(
        self, run: CollisionRun, heading: Heading, states: FragmentStates, parts: Mapping[str, float]
    ) -> None:
        collision, visits = parts["broad_phase"] + parts["narrow_phase"], run.world.last_visits
        update, conversion = parts["update"], parts["conversion and publishing"]
        if self._answer_times.get_subscription_count():
            told = qos.ANSWER_TIMES.message_class(
                header=header_of(heading), run_id=run.run_id, step=states.step, collision_s=collision, update_s=update,
                conversion_s=conversion, visits=visits,
            )  # fmt: skip
            self._answer_times.publish(told)
        if self._rows is not None:
            self._rows.add((states.step, states.fracture_sequence, collision, update, conversion, visits))

    def _publish_meshes(self, run: CollisionRun, heading: Heading) -> None:
        """Publishes meshes of new fragments after a change of the registry."""
        if self._meshes_version != self._registry_version and self._publish_new_meshes(run, heading):
            self._meshes_version = self._registry_version

    def _publish_new_meshes(self, run: CollisionRun, heading: Heading) -> bool:
        """Publishes meshes of fragments that have none on the topic yet; False without subscribers."""
        if self._meshes.get_subscription_count() == 0:
            return False
        for fragment_id in run.world.fragments().fragment_ids.tolist():
            if fragment_id not in self._meshes_published:
                self._meshes_published.add(fragment_id)
                self._meshes.publish(serialize_record(run.world.fragment_mesh(fragment_id), heading, run.run_id))
        return True


def _row_file(path: str) -> RowFile:
    try:
        return RowFile(Path(path), len(SERVICE_COLUMNS))
    except OSError as error:
        raise Fatal(f"timing_file: {error}") from error

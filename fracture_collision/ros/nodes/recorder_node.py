"""Records every message of a run into a bag. For systems without `ros2 bag`, and for equal bytes of equal runs.

Once a second all settled messages go to disk, so that a killed recorder leaves a readable bag. The bag's custom data
has the settings of the service: contacts are a function of the messages and the settings.

A run that lacks steps or answers is no recording: the recorder checks the step numbers, and ends with an error if some
are missing. States are subscribed to once the service has discovered this recorder, so a simulator that waits for its
subscribers begins with a recorder that receives the answers. DDS does not always discover a participant again
whose lease has expired.
"""

from __future__ import annotations

import json
import struct
import sys
import time
from collections import deque
from collections.abc import Callable

from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

from fracture_collision.bag.reader import EARLIER_SETTINGS, SETTINGS
from fracture_collision.bag.writer import BagTopic, BagWriter, OfferedQos
from fracture_collision.cdr import offset_of_run_id
from fracture_collision.ros.nodes.settings_watcher import ServiceSettings
from fracture_collision.ros.processes.parameters import Declaration, declare_all
from fracture_collision.ros.processes.process import Fatal, run_node
from fracture_collision.ros.wire import interfaces, qos
from fracture_collision.ros.wire.cdr_padding import zero_padding
from fracture_collision.ros.wire.message_definitions import message_definition, type_hash, type_name

RECORDED = interfaces.RECORDER.subscribes

PROGRESS_INTERVAL = 0.1  # [s]
FLUSH_INTERVAL = 1.0  # [s]
FEW = 3  # Fewer steps may lack their answers: those on their way when the recording ends, or when a simulator ended.
RECENT = 64  # answers
LONGEST_SILENCE = 5.0  # [s] of a publisher of answers that has no parameters to be asked for

# Every message here begins with a header, whose stamp follows the four bytes of CDR's encapsulation. In states and
# answers run_id and step follow.
_STAMP = struct.Struct("<iI")
_STAMP_OFFSET = 4
_RUN_AND_STEP = struct.Struct("<QQ")


class RecorderNode(Node):
    """Records until it is stopped; never overwrites a bag."""

    PARAMETERS = (
        Declaration("folder", "", "folder of the bag; must not exist yet"),
        Declaration("progress", False, "print JSON lines to stdout: messages by topic"),
    )
    INTERFACE = interfaces.RECORDER
    EXAMPLES = ("--ros-args -p folder:=out/my_bag", "--ros-args -p folder:=out/my_bag -r __ns:=/cell")

    def __init__(self) -> None:
        super().__init__("recorder_node")
        folder, self._tells_progress = declare_all(self, self.PARAMETERS).values()
        if not folder:
            raise Fatal("parameter folder: empty; pass the folder of the bag")
        names = {topic.name: self.resolve_topic_name(topic.name) for topic in RECORDED}
        try:
            self._bag = BagWriter(folder, [bag_topic(names[topic.name], topic) for topic in RECORDED])
        except OSError as error:
            raise Fatal(f"parameter folder: {error}") from error
        self._newest_time = 0  # [ns]
        self._settled_time = 0  # [ns] the newest at the last flush; its other messages have arrived since
        self._flushed_time = 0  # [ns] its messages are in the bag
        self._counts = dict.fromkeys((topic.name for topic in RECORDED), 0)
        self._unflushed = 0  # messages
        self._noted_settings: str | None = None
        self._settings = ServiceSettings(self, qos.CONTACT_CONSTRAINTS.name, self._note_settings)
        self._records_states = False
        self._service_since: float | None = None  # time.monotonic() when its publisher was discovered
        self._unanswered: set[int] = set()  # [ns] times of the steps without answers, since the first answer
        self._answered: deque[int] = deque(maxlen=RECENT)  # [ns] an answer may be taken before its states
        self._lacks_service = False  # at the last check
        self._last_step: tuple[int, int] | None = None  # run id and step of the newest states
        self._first_missed = 0
        self._missed = 0  # steps whose states did not arrive
        for topic in RECORDED:
            if topic is not qos.FRAGMENT_STATES:
                self._record(topic)

    def _record(self, topic: qos.Topic) -> None:
        keep = self._keep(topic, self.resolve_topic_name(topic.name))
        self.create_subscription(topic.message_class, topic.name, keep, qos.recording(topic.qos), raw=True)

    def _keep(self, topic: qos.Topic, name: str) -> Callable[[bytes], None]:
        def keep(data: bytes) -> None:
            try:
                clear = zero_padding(data, topic.message_class)
            except ValueError as error:  # a reader of the bag could not read it either
                self.get_logger().warning(f"{name}: not recorded: {error}", throttle_duration_sec=1.0)
                return
            self._counts[topic.name] += 1
            if topic is not qos.DIAGNOSTICS:  # they carry wall clock time, all others simulation time
                seconds, nanoseconds = _STAMP.unpack_from(data, _STAMP_OFFSET)
                self._newest_time = max(seconds * 10**9 + nanoseconds, 0)  # bags have no times before the epoch
            if topic is qos.FRAGMENT_STATES:
                self._check_step(*_RUN_AND_STEP.unpack_from(clear, offset_of_run_id(clear)))
                if self._newest_time not in self._answered:
                    self._unanswered.add(self._newest_time)
            elif topic is qos.CONTACT_CONSTRAINTS:
                if self._counts[topic.name] == 1:
                    self._unanswered.clear()
                self._unanswered.discard(self._newest_time)
                self._answered.append(self._newest_time)
            self._bag.write(name, clear, self._newest_time)
            self._unflushed += 1

        return keep

    def _check_step(self, run_id: int, step: int) -> None:
        """Simulators number steps without gaps; repeated states and a replay that goes back lack nothing."""
        if self._last_step is not None and self._last_step[0] == run_id and step > self._last_step[1] + 1:
            if not self._missed:
                self._first_missed = self._last_step[1] + 1
            self._missed += step - self._last_step[1] - 1
            self.get_logger().error(f"states of {self._missed} steps were missed, the first is {self._first_missed}")
        self._last_step = run_id, step

    def _note_settings(self, settings: dict[str, object]) -> None:
        text = json.dumps(settings)
        if text == self._noted_settings:
            return
        if self._noted_settings is not None and self._counts[qos.FRAGMENT_STATES.name]:
            self.get_logger().warning("the service's settings have changed; a replay of the bag uses the last ones")
            self._bag.note(EARLIER_SETTINGS, self._noted_settings)
        self._noted_settings = text
        self._bag.note(SETTINGS, text)

    def spin(self, executor: SingleThreadedExecutor) -> None:
        """Records until rclpy shuts down and raises ExternalShutdownException, or returns if the service is lost."""
        told: dict[str, int] = {}
        due = flush_due = 0.0
        while True:
            executor.spin_once(timeout_sec=PROGRESS_INTERVAL)
            now = time.monotonic()
            if not self._records_states and self._is_known_to_service(now):
                self._records_states = True
                self._record(qos.FRAGMENT_STATES)
            if self._tells_progress and now >= due and self._counts != told:
                due, told = now + PROGRESS_INTERVAL, dict(self._counts)
                print(json.dumps(told), flush=True)
            if now >= flush_due:
                flush_due = now + FLUSH_INTERVAL
                self._settings.look()
                self._flush()
                lacked_service, self._lacks_service = self._lacks_service, self._has_lost_service()
                if lacked_service and self._lacks_service:
                    return

    def _is_known_to_service(self, now: float) -> bool:
        """Whether the service sends its answers here, too: it has responded to a request, or does not respond at all.

        It may discover this node seconds later than the other way round.
        """
        if not self._has_service():
            return False
        self._settings.look()
        if self._service_since is None:
            self._service_since = now
        return self._settings.has_answer or now > self._service_since + LONGEST_SILENCE

    def _has_service(self) -> bool:
        return self.count_publishers(qos.CONTACT_CONSTRAINTS.name) > 0

    def _has_lost_service(self) -> bool:
        """Whether a run goes on with a service that is not discovered here."""
        return len(self._unanswered) >= FEW and not self._has_service()

    def _flush(self) -> None:
        settled, self._settled_time = self._settled_time, self._newest_time
        if self._unflushed or settled != self._flushed_time:
            self._unflushed, self._flushed_time = 0, settled
            self._bag.flush(settled)

    def finish(self) -> None:
        """Completes the bag. Raises Fatal if steps or answers are missing in it."""
        self._bag.close()
        if self._missed:
            raise Fatal(
                f"the bag lacks the states of {self._missed} steps, the first is {self._first_missed}: the recorder was"
                " late by more than the depth of the topic. Record the run again."
            )
        if not self._records_states:
            self.get_logger().warning("no collision service was there: the bag has no states")
        if len(self._unanswered) >= FEW:
            first = 1e-9 * min(self._unanswered)
            reason = "the service is no longer discovered" if self._lacks_service else "they have not arrived"
            raise Fatal(
                f"{len(self._unanswered)} recorded steps lack their answers, the first at {first:.4g} s: {reason}."
                " Record the run again."
            )


def bag_topic(name: str, topic: qos.Topic) -> BagTopic:
    """A bag's topic `name` with the definition and the quality of service of `topic`."""
    offered = OfferedQos(
        history="keep_all" if topic.qos.history == HistoryPolicy.KEEP_ALL else "keep_last",
        depth=0 if topic.qos.history == HistoryPolicy.KEEP_ALL else topic.qos.depth,
        reliability="reliable" if topic.qos.reliability == ReliabilityPolicy.RELIABLE else "best_effort",
        durability="transient_local" if topic.qos.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
    )
    definition, hash_ = message_definition(topic.message_class), type_hash(topic.message_class)
    return BagTopic(name, type_name(topic.message_class), definition, hash_, offered)


def _work(node: RecorderNode) -> None:
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        node.spin(executor)
    finally:
        node.finish()
        executor.shutdown()


def main() -> int:
    """Runs the node with the process's arguments; returns its exit status."""
    return run_node(RecorderNode, _work)


if __name__ == "__main__":
    sys.exit(main())

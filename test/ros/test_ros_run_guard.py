"""Which publisher's run the service follows: the rules, without ROS."""

from __future__ import annotations

from fracture_collision.ros.service.run_guard import RunGuard, Verdict

BODIES, EVENTS, STATES = TOPICS = ("bodies", "fracture_events", "fragment_states")
LOG = {BODIES, EVENTS}
FIRST, SECOND, THIRD = b"first", b"second", b"third"


def there(*simulators: bytes, **helpers: bytes) -> dict[str, set[bytes]]:
    """Publishers by topic: simulators publish on all topics, helpers on one."""
    return {topic: {*simulators, *([helpers[topic]] if topic in helpers else [])} for topic in TOPICS}


def followed(*simulators: bytes) -> RunGuard:
    """A guard that follows the first of the given simulators."""
    guard = RunGuard()
    guard.observe(there(*simulators), LOG)
    assert guard.judge(BODIES, simulators[0], False, False) is Verdict.FOLLOW
    guard.observe(there(*simulators), LOG)
    return guard


def test_the_first_publisher_is_followed_and_the_second_rejected() -> None:
    guard = followed(FIRST, SECOND)
    for topic in TOPICS:
        assert guard.judge(topic, FIRST, False, False) is Verdict.FOLLOW  # also when it starts a new run
        for same_run in (False, True):
            assert guard.judge(topic, SECOND, same_run, False) is Verdict.REFUSE
    assert guard.leader == FIRST and guard.waiting == {SECOND}


def test_the_second_publisher_is_followed_when_the_first_is_gone() -> None:
    guard = followed(FIRST, SECOND)
    guard.judge(STATES, SECOND, True, False)
    guard.observe(there(SECOND), LOG)
    assert guard.leader is None and guard.waiting == {SECOND}
    assert guard.judge(BODIES, SECOND, True, False) is Verdict.BEGIN  # although the run id is the same, it is a new run
    assert guard.judge(EVENTS, SECOND, True, False) is Verdict.FOLLOW
    assert guard.judge(BODIES, FIRST, True, False) is Verdict.REFUSE


def test_a_publisher_that_returns_continues_its_run() -> None:
    guard = followed(FIRST)
    guard.observe(there(), LOG)
    assert guard.leader is None
    guard.observe(there(FIRST), LOG)
    assert guard.judge(STATES, FIRST, True, False) is Verdict.FOLLOW


def test_a_leader_with_one_publisher_left_is_still_followed() -> None:
    guard = followed(FIRST, SECOND)
    guard.observe({BODIES: {SECOND}, EVENTS: {SECOND}, STATES: {FIRST, SECOND}}, LOG)
    assert guard.leader == FIRST
    assert guard.judge(BODIES, SECOND, False, False) is Verdict.REFUSE
    assert guard.judge(STATES, SECOND, True, False) is Verdict.REFUSE


def test_one_other_publisher_may_supply_missing_topics_of_the_same_run() -> None:
    guard = RunGuard()
    alone = {BODIES: {FIRST}, EVENTS: set(), STATES: {SECOND, THIRD}}
    guard.observe(alone, LOG)
    assert guard.judge(BODIES, FIRST, False, False) is Verdict.FOLLOW
    guard.observe(alone, LOG)
    assert guard.judge(STATES, SECOND, False, False) is Verdict.REFUSE
    assert guard.judge(STATES, SECOND, True, False) is Verdict.FOLLOW
    assert guard.judge(STATES, THIRD, True, False) is Verdict.REFUSE
    assert guard.judge(BODIES, SECOND, True, False) is Verdict.REFUSE
    # After the publisher of the bodies has left, others may continue its run.
    guard.observe({BODIES: set(), EVENTS: set(), STATES: {THIRD}}, LOG)
    assert guard.judge(STATES, THIRD, True, False) is Verdict.FOLLOW


def test_a_takeover_is_for_good() -> None:
    guard = followed(FIRST, SECOND)
    assert guard.judge(STATES, SECOND, False, True) is Verdict.BEGIN
    assert guard.judge(STATES, FIRST, False, True) is Verdict.REFUSE  # otherwise the two would alternate
    assert guard.judge(BODIES, THIRD, False, True) is Verdict.BEGIN
    assert guard.judge(BODIES, SECOND, False, True) is Verdict.REFUSE
    guard.observe(there(FIRST), LOG)
    assert guard.judge(BODIES, FIRST, False, True) is not Verdict.REFUSE


def test_publishers_that_are_gone_are_forgotten() -> None:
    guard = followed(FIRST)
    for number in range(1000):
        stranger = str(number).encode()
        guard.observe(there(FIRST, stranger), LOG)
        guard.judge(BODIES, stranger, False, bool(number % 2))
    guard.observe(there(), LOG)
    assert guard.waiting == set() and guard._displaced == set() and guard._helpers == {} and guard.leader is None

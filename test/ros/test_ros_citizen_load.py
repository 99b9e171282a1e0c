"""Overload: the service answers the newest states and counts the dropped ones; a visit budget bounds the cost."""

from __future__ import annotations

import time
from itertools import pairwise

import numpy as np
import pytest
from stages.ros_client import ServiceClient
from stages.ros_stage import StageWithClients

from fracture_collision.geometry.generators import ball
from fracture_collision.records import BUDGET_EXHAUSTED, CollisionBody, FragmentStates

RUN = 41
ANSWERS = "fracture_collision: answers"
DROPPED = "states dropped for newer ones"
FLOOD = 2.0  # [s]

# Two breakable balls that overlap by a third of a radius: several hundred tree nodes are visited per step.
STATES = FragmentStates(
    1, 0, np.array([1, 2]), np.array([0.0, 0.0, 0.0, 0.7, 0.1, 0.05]), np.tile([0.0, 0.0, 0.0, 1.0], 2)
)


def moved(step: int) -> FragmentStates:
    """A little: equal states have equal answers, which the service keeps."""
    return STATES._replace(step=step, positions=STATES.positions + 1e-9 * step)


@pytest.fixture(scope="module")
def client(shared_stage: StageWithClients) -> ServiceClient:
    """Of a service with two balls."""
    _, client = shared_stage.served(method="glondu2014")
    mesh = ball(0.5, 0.06)
    for number in (1, 2):
        body = CollisionBody(number, number, vertices=mesh.vertices.ravel(), tetrahedra=mesh.tetrahedra.ravel())
        client.publish("bodies", body, RUN)
    return client


def cost(client: ServiceClient) -> float:
    """Round trip [s] from states to answer, the minimum of 15."""
    seconds = []
    for step in range(1, 16):
        began = time.perf_counter()
        client.ask(moved(step), RUN)
        seconds.append(time.perf_counter() - began)
    return min(seconds)


def visits_told(client: ServiceClient) -> int:
    """Tree nodes visited for the last answer, read once the service has reported all answers."""
    client.spin_until(lambda: int(client.details[ANSWERS]["answers"]) == len(client.answers), "its word on them")
    told = next(value for key, value in client.details[ANSWERS].items() if key.startswith("tree nodes visited"))
    return int(told.split(", ")[-1].split()[0])


def test_states_faster_than_answers_are_dropped_and_counted(client: ServiceClient) -> None:
    # computing an answer takes far longer than sending a message
    usual = client.parameters("penetration_tolerance")[0]
    assert client.set_parameters(penetration_tolerance=0.0) == [""]
    least = cost(client)
    answered_before = len(client.answers)
    published: dict[int, float] = {}
    came: dict[int, float] = {}
    step, began = 100, time.monotonic()
    while time.monotonic() < began + FLOOD:
        step += 1
        published[step] = time.monotonic()
        client.publish("fragment_states", moved(step), RUN)
        client.spin_once(timeout_sec=0.001)
        for answer in client.answers[answered_before + len(came) :]:
            came[answer.step] = time.monotonic()
    client.spin_until(lambda: client.answers[-1].step == step, "the answer to the last states")
    sent, answered = len(published), len(client.answers) - answered_before
    assert answered < sent / 2  # otherwise there was no overload

    # States that are not answered are counted.
    def all_counted() -> bool:
        details = client.details[ANSWERS]
        return int(details["answers"]) == answered_before + answered and int(details[DROPPED]) == sent - answered

    client.spin_until(all_counted, f"{sent} sent = {answered} answered + {sent - answered} dropped")
    assert client.set_parameters(penetration_tolerance=usual) == [""]

    # Each answer is for the newest states at the start of its computation, when the previous answer was sent. A queue
    # would deliver older ones. (Median, because a message or this process is late occasionally.)
    steps = list(came)
    assert steps == sorted(steps)
    newer = [
        sum(step < other and published[other] < came[before] - least for other in published)
        for before, step in pairwise(steps)
    ]
    assert np.median(newer) == 0, newer
    latency = 1e3 * np.array([came[step] - published[step] for step in steps])
    print(  # for docs/reliability.md
        f"{sent} sent, {answered} answered, {sent - answered} dropped; answered {np.median(latency):.0f} ms after they"
        f" were sent (median; {latency.max():.0f} worst); least round trip {1e3 * least:.1f} ms"
    )


def test_a_limit_of_work_limits_the_cost_and_bounds_the_missed_depth(client: ServiceClient) -> None:
    whole = client.ask(STATES, RUN)
    assert whole.status == 0
    assert visits_told(client) > 800
    bounds = []
    for most in (100, 25):
        assert client.set_parameters(max_work=most) == [""]
        answer = client.ask(STATES, RUN)
        assert answer.status == BUDGET_EXHAUSTED
        bounds.append(answer.missed_depth_bound.max())
        assert visits_told(client) <= 4 * most
    assert bounds[1] >= bounds[0] > 2.0 * whole.missed_depth_bound.max()
    assert client.set_parameters(max_work=2_000_000) == [""]
    assert client.ask(STATES, RUN).status == 0

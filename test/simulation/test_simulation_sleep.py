"""Bodies at rest sleep, bit for bit; touching, pushing, grabbing or losing support wakes them."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from fracture_collision.records import FragmentStates
from fracture_collision.simulation.scene.scene import Scene, parse_scene
from fracture_collision.simulation.simulation import Simulation, StepReport
from fracture_collision.simulation.solver.contact_solver import SolverSettings
from fracture_collision.simulation.solver.sleep import NOBODY, Rest, after_step, roused, settled
from fracture_collision.world import CollisionWorld, Settings

STONE = {"density": 2000.0, "friction": 0.6, "restitution": 0.0, "rolling_arm": 0.0}
GROUND = {
    "name": "ground", "shape": {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}, "material": "stone", "static": True,
}  # fmt: skip


def block(name: str, z: float, **more: Any) -> dict[str, Any]:
    return {
        "name": name, "shape": {"box": {"size": [0.2, 0.2, 0.1]}}, "material": "stone", "position": [0.0, 0.0, z],
    } | more  # fmt: skip


def scene_of(*bodies: dict[str, Any], **more: Any) -> Scene:
    return parse_scene(
        {"time_step": 0.0025, "duration": 10.0, "gravity": [0.0, 0.0, -9.81], "materials": {"stone": STONE},
         "bodies": [GROUND, *bodies]} | more,
        "blocks",
    )  # fmt: skip


class Run:
    """Simulator and service in one process."""

    def __init__(self, scene: Scene) -> None:
        self.simulation, self.world = Simulation(scene, 7), CollisionWorld(Settings(threads=1))
        self.states: list[FragmentStates] = []
        for body in self.simulation.start_bodies():
            self.world.add_body(body)

    def step(self, count: int = 1) -> StepReport:
        for _ in range(count):
            request = self.simulation.begin_step()
            for body in request.bodies:
                self.world.add_body(body)
            for event in request.events:
                self.world.add_fracture(event)
            self.states.append(request.states)
            report = self.simulation.finish_step(self.world.contacts(request.states), self.world.fragments())
        return report

    def asleep(self) -> int:
        return int(self.simulation._rest.asleep.sum())

    def until_asleep(self, count: int) -> None:
        for _ in range(2000):
            self.step()
            if self.asleep() == count:
                return
        raise AssertionError(f"{self.asleep()} of {count} are asleep")

    def height(self, fragment_id: int) -> float:
        states = self.states[-1]
        return float(states.positions.reshape(-1, 3)[states.fragment_ids.tolist().index(fragment_id), 2])


@pytest.fixture
def run_of() -> Iterator[Any]:
    made = []

    def make(scene: Scene) -> Run:
        made.append(Run(scene))
        return made[-1]

    yield make
    for each in made:
        each.simulation.close()


def test_a_stack_at_rest_keeps_its_poses_to_the_last_bit(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515)))
    run.until_asleep(2)
    run.step(3)
    kept = run.states[-1]
    report = run.step(50)
    for name in ("positions", "orientations"):
        assert getattr(run.states[-1], name).tobytes() == getattr(kept, name).tobytes()
    assert not run.states[-1].linear_velocities.any() and not run.states[-1].angular_velocities.any()
    assert report.kinetic_energy == 0.0 and report.contacts == 12


def test_a_sleep_time_of_zero_disables_sleeping(run_of) -> None:
    scene = scene_of(block("lower", 0.051), solver={"sleep_time": 0.0})
    run = run_of(scene)
    run.step(400)
    assert run.asleep() == 0


def test_a_block_that_lands_wakes_the_stack(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515), block("late", 1.0, start_time=2.0)))
    run.until_asleep(2)
    while run.asleep():
        run.step()
        assert run.simulation.time < 3.0
    # not before the block lands
    assert run.height(4) < 0.27
    run.until_asleep(3)


def test_a_block_falls_when_its_support_is_removed(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515)))
    run.until_asleep(2)
    before = run.height(3)
    run.simulation.take_out(2)
    run.step(40)
    assert run.height(3) < before - 0.03


def test_a_hand_wakes_what_it_pulls(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515)))
    run.until_asleep(2)
    before = run.height(3)
    run.simulation.grab("upper", np.array([0.0, 0.0, 0.3]))
    run.step(100)
    assert run.height(3) > before + 0.05


def test_a_fracture_wakes_touching_bodies(run_of) -> None:
    clay = STONE | {
        "fracture": {"strength": 40.0, "minimum_mass": 0.1, "pattern": {"seeds": 7, "minimum_nodes": 6}},
    }  # fmt: skip
    brick = {"shape": {"brick": {"size_xyz": [0.2, 0.1, 0.06], "edge_length": 0.02}}, "material": "clay"}
    stack = [block(f"brick {k}", 0.0301 + 0.0601 * k, **brick) for k in range(3)]
    apart = block("apart", 0.0301, **brick) | {"position": [1.0, 0.0, 0.0301]}
    run = run_of(scene_of(*stack, apart, materials={"stone": STONE, "clay": clay}))
    run.until_asleep(4)
    assert run.simulation.strike(3, np.zeros(3), 2.0)
    run.step()
    awake = run.simulation._rest.fragment_ids[~run.simulation._rest.asleep].tolist()
    assert {2, 4} < set(awake), "those below and above"
    assert 5 not in awake and 3 not in run.simulation._rest.fragment_ids


def test_islands_sleep_and_wake_as_one() -> None:
    """Bodies 0 and 1 touch each other, 2 touches a static body, 3 touches nothing."""
    begin, a, b = np.array([0, 1, 2]), np.array([0, 2]), np.array([1, 4])
    ids = np.arange(10, 14, dtype=np.uint32)
    quiet = np.array([0.3, 0.1, 0.3, 0.3])
    rest = settled(Rest(ids, quiet, np.zeros(4, bool), np.zeros((4, 6))), begin, a, b, 0.25)
    assert rest.asleep.tolist() == [False, False, True, False]
    rest = settled(Rest(ids, np.full(4, 0.3), np.zeros(4, bool), np.ones((4, 6))), begin, a, b, 0.25)
    assert rest.asleep.tolist() == [True, True, True, False]
    nobody_gone = np.zeros(0, np.uint32), np.zeros(0, np.uint32)
    pushed = np.array([True, False, False, False])
    woken = settled(roused(rest, ids, nobody_gone, pushed), begin, a, b, 0.25)
    assert woken.asleep.tolist() == [False, False, True, False] and woken.quiet[:2].tolist() == [0.0, 0.0]
    assert not woken.gone[0].any() and woken.gone[2].all()
    # 12 is gone, and 13 rested on it
    rest = rest._replace(asleep=np.ones(4, bool))
    touched = np.array([10, 12], np.uint32), np.array([11, 13], np.uint32)
    left = roused(rest, np.array([10, 11, 13], np.uint32), touched, np.zeros(3, bool))
    assert left.asleep.tolist() == [True, True, False]
    assert roused(rest, np.zeros(0, np.uint32), touched, np.zeros(0, bool)) is NOBODY


def test_slow_bodies_count_as_quiet() -> None:
    """At 0.9 and 1.1 mm/s, spinning, oscillating in place at 16 mm/s, and at rest."""
    n, steps, time_step = 5, 101, 0.0025
    rest = Rest(np.arange(n, dtype=np.uint32), np.zeros(n), np.zeros(n, bool), np.zeros((n, 6)))
    inertias = np.tile(1e-4 * np.eye(3), (n, 1, 1))
    for step in range(steps):
        moves = np.zeros((n, 6))
        moves[0, 0], moves[1, 0], moves[2, 5] = 0.9e-3, 1.1e-3, 0.2
        moves[3, 1] = 16e-3 if step % 2 else -16e-3
        rest = after_step(rest, np.ones(n), inertias, moves, np.full(n, 0.25e-3), time_step)
    quiet = rest.quiet >= SolverSettings().sleep_time
    assert quiet.tolist() == [True, False, False, True, True]
    assert rest.quiet[4] == pytest.approx(steps * time_step)

"""Bodies at rest sleep, bit for bit; touching, pushing, grabbing or losing support wakes them.

Contacts that the service omits for a step are remembered and move with their bodies.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.gate_world import record_bytes
from worlds.served_scene import ServedScene
from worlds.small_scenes import GROUND, box, small_scene

from fracture_collision.records import ContactConstraintArray, FragmentStates
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.simulation.simulation import Simulation, _Still
from fracture_collision.simulation.solver.contact_memory import NOTHING, rest_gaps_of, with_remembered
from fracture_collision.simulation.solver.contact_solver import SolverSettings
from fracture_collision.simulation.solver.sleep import Rest, after_step
from fracture_collision.world import Settings

STONE = {"density": 2000.0, "friction": 0.6, "restitution": 0.0, "rolling_arm": 0.0}


def block(name: str, z: float, **more: Any) -> dict[str, Any]:
    return box(name, [0.2, 0.2, 0.1], [0.0, 0.0, z]) | more


def scene_of(*bodies: dict[str, Any], **more: Any) -> Scene:
    return small_scene(STONE, GROUND, *bodies, duration=10.0, **more)


class Run(ServedScene):
    def asleep(self) -> int:
        return int(self.simulation.dynamics._rest.asleep.sum())

    def until_asleep(self, count: int) -> None:
        for _ in range(2000):
            self.step()
            if self.asleep() == count:
                return
        raise AssertionError(f"{self.asleep()} of {count} are asleep")

    def height(self, fragment_id: int) -> float:
        return float(self.place(fragment_id)[2])


@pytest.fixture
def run_of() -> Iterator[Any]:
    made = []

    def make(scene: Scene) -> Run:
        made.append(Run(Simulation(scene, 7), Settings(threads=1)))
        return made[-1]

    yield make
    for each in made:
        each.simulation.close()


def test_a_stack_at_rest_keeps_its_poses_to_the_last_bit_until_a_hand_pulls_it(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515)))
    run.until_asleep(2)
    run.step(3)
    kept = run.requests[-1].states
    report = run.step(50)
    last = run.requests[-1].states
    for name in ("positions", "orientations"):
        assert getattr(last, name).tobytes() == getattr(kept, name).tobytes()
    assert not last.linear_velocities.any() and not last.angular_velocities.any()
    assert report.kinetic_energy == 0.0 and report.contacts == 12
    before = run.height(3)
    run.simulation.grab("upper", np.array([0.0, 0.0, 0.3]))
    run.step(100)
    assert run.height(3) > before + 0.05


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


@pytest.mark.parametrize("engine", ["own", "mujoco"])
def test_a_step_that_is_taken_from_the_last_one_equals_one_that_is_solved(run_of, monkeypatch, engine: str) -> None:
    """A stack at rest, then a block that lands on it, then a hand."""
    late = block("late", 0.3, start_time=1.5)
    scene = scene_of(block("lower", 0.051), block("upper", 0.1515), late, engine=engine)
    runs, reports, solved = [run_of(scene), run_of(scene)], [], []
    for run, is_kept in zip(runs, (True, False), strict=True):
        if not is_kept:
            monkeypatch.setattr(_Still, "goes_on", lambda *_: False)
        solve = Mock(wraps=run.simulation.dynamics.solve)
        monkeypatch.setattr(run.simulation.dynamics, "solve", solve)
        reports.append([run.step()._replace(solver_seconds=0.0) for _ in range(1400)])
        run.simulation.grab("late", np.array([0.0, 0.0, 0.5]))
        reports[-1] += [run.step()._replace(solver_seconds=0.0) for _ in range(40)]
        solved.append(solve.call_count)
    assert solved[1] == 1440 > solved[0] + 400
    assert reports[0] == reports[1]
    for one, other in zip(*(run.requests for run in runs), strict=True):
        assert record_bytes(one.states) == record_bytes(other.states)


def test_a_block_falls_when_its_support_is_removed(run_of) -> None:
    run = run_of(scene_of(block("lower", 0.051), block("upper", 0.1515)))
    run.until_asleep(2)
    before = run.height(3)
    run.simulation.take_out(2)
    run.step(40)
    assert run.height(3) < before - 0.03


def test_a_fracture_wakes_touching_bodies(run_of) -> None:
    clay = STONE | {
        "fracture": {"strength": 40.0, "minimum_mass": 0.1, "pattern": {"seeds": 7, "minimum_nodes": 6}},
    }  # fmt: skip
    brick = {"shape": {"brick": {"size_xyz": [0.2, 0.1, 0.06], "edge_length": 0.02}}, "material": "clay"}
    stack = [block(f"brick {k}", 0.0301 + 0.0601 * k, **brick) for k in range(3)]
    apart = block("apart", 0.0301, **brick) | {"position": [1.0, 0.0, 0.0301]}
    run = run_of(scene_of(*stack, apart, materials={"clay": clay}))
    run.until_asleep(4)
    assert run.simulation.strike(3, np.zeros(3), 2.0)
    run.step()
    awake = run.simulation.dynamics._rest.fragment_ids[~run.simulation.dynamics._rest.asleep].tolist()
    assert {2, 4} < set(awake), "those below and above"
    assert 5 not in awake and 3 not in run.simulation.dynamics._rest.fragment_ids


def test_slow_bodies_count_as_quiet() -> None:
    """At 0.9 and 1.1 mm/s, spinning, oscillating in place at 16 mm/s, and at rest.

    The first one creeps on: it stays quiet in every step from then on, or a heap of many would hardly fall asleep.
    """
    n, steps, time_step, sleep_time = 5, 801, 0.0025, SolverSettings().sleep_time
    quiet = np.zeros((steps, n), bool)
    rest = Rest(np.arange(n, dtype=np.uint32), np.zeros(n), np.zeros(n, bool), np.zeros((n, 6)))
    inertias = np.tile(1e-4 * np.eye(3), (n, 1, 1))
    for step in range(steps):
        moves = np.zeros((n, 6))
        moves[0, 0], moves[1, 0], moves[2, 5] = 0.9e-3, 1.1e-3, 0.2
        moves[3, 1] = 16e-3 if step % 2 else -16e-3
        rest = after_step(rest, np.ones(n), inertias, moves, np.full(n, 0.25e-3), sleep_time, time_step)
        quiet[step] = rest.quiet >= sleep_time
    assert quiet[101:].all(axis=0).tolist() == [True, False, False, True, True]
    assert not quiet[:99].any() and not quiet[:, 1:3].any()
    assert rest.quiet[4] == pytest.approx(steps * time_step)


REACH = np.full(2, 2.5e-4)  # of each pair; the tests have one or two


def states_of(frames):
    """frames: fragment id -> (position, rotation)."""
    ids = sorted(frames)
    return FragmentStates(
        0, 0, np.array(ids, np.uint32),
        np.array([frames[i][0] for i in ids]), np.array([frames[i][1].as_quat() for i in ids]),
    )  # fmt: skip


def contacts_of(*pairs):
    """pairs: (a, b, [(id, point_a, point_b, normal)])."""
    flat = [contact for _, _, found in pairs for contact in found]
    point_a, point_b, normal = (np.array([c[k] for c in flat]).reshape(-1, 3) for k in (1, 2, 3))
    return ContactConstraintArray(
        0, 0, 0, np.array([a for a, _, _ in pairs], np.uint32), np.array([b for _, b, _ in pairs], np.uint32),
        np.cumsum([0] + [len(found) for _, _, found in pairs]).astype(np.uint32),
        *[np.zeros(len(pairs))] * 3, point_a, point_b, normal,
        np.einsum("ck,ck->c", point_b - point_a, normal), np.array([c[0] for c in flat], np.uint64),
    )  # fmt: skip


UP = np.array([0.0, 0.0, 1.0])
STILL = (np.zeros(3), Rotation.identity())


def contact(number, x, gap):
    point = np.array([x, 0.0, 0.0])
    return number, point, point + gap * UP, UP


def test_an_omitted_contact_moves_with_its_bodies():
    first = contacts_of((3, 8, [contact(1, 0.0, 0.0), contact(2, 0.1, -1e-4)]))
    merged, memory = with_remembered(first, states_of({3: STILL, 8: STILL}), NOTHING, REACH)
    for got, expected in zip(merged, first, strict=True):
        np.testing.assert_array_equal(got, expected)

    # Both rotate and move as one; b lifts off by 1.5e-4 along the rotated normal.
    turn = Rotation.from_rotvec([0.3, -0.5, 0.2])
    shift = np.array([1.0, 2.0, 3.0])
    lifted = shift + 1.5e-4 * turn.apply(UP)
    second = contacts_of((3, 8, [(1, shift, lifted, turn.apply(UP))]))
    merged, memory = with_remembered(second, states_of({3: (shift, turn), 8: (lifted, turn)}), memory, REACH)
    assert merged.contact_ids.tolist() == [1, 2]
    assert merged.pair_begin.tolist() == [0, 2]
    np.testing.assert_allclose(merged.points_a[1], turn.apply([0.1, 0.0, 0.0]) + shift, atol=1e-15)
    np.testing.assert_allclose(merged.normals[1], turn.apply(UP), atol=1e-15)
    np.testing.assert_allclose(merged.gaps, [1.5e-4, 0.5e-4], atol=1e-15)

    # Beyond the reach it is forgotten permanently.
    lifted = shift + 4.0e-4 * turn.apply(UP)
    far, memory = with_remembered(second, states_of({3: (shift, turn), 8: (lifted, turn)}), memory, REACH)
    assert far.contact_ids.tolist() == [1]
    near, _ = with_remembered(second, states_of({3: (shift, turn), 8: (shift, turn)}), memory, REACH)
    assert near.contact_ids.tolist() == [1]


def test_contacts_that_slip_or_separate_are_dropped_and_listed_ones_not_doubled():
    both = contacts_of((3, 8, [contact(1, 0.0, 0.0), contact(2, 0.1, 0.0)]), (3, 9, [contact(1, 0.2, 0.0)]))
    states = states_of({3: STILL, 8: STILL, 9: STILL})
    _, memory = with_remembered(both, states, NOTHING, REACH)
    again, _ = with_remembered(both, states, memory, REACH)
    assert again.contact_ids.tolist() == [1, 2, 1]
    slipped = states_of({3: STILL, 8: (np.array([3e-4, 0.0, 0.0]), Rotation.identity()), 9: STILL})
    one = contacts_of((3, 8, [contact(1, 0.0, 0.0)]))
    assert with_remembered(one, slipped, memory, REACH)[0].contact_ids.tolist() == [1]
    # A pair that the service no longer lists has separated, whatever was remembered.
    kept, _ = with_remembered(one, states, memory, REACH)
    assert kept.fragment_b.tolist() == [8]
    assert kept.contact_ids.tolist() == [1, 2]
    none, _ = with_remembered(contacts_of(), states, memory, REACH)
    assert len(none.gaps) == 0


def test_static_bodies_without_states_are_in_the_world_frame():
    turn = Rotation.from_rotvec([0.0, 0.0, 0.4])
    first = contacts_of((1, 8, [contact(5, 0.3, 0.0), contact(6, 0.4, 0.0)]))
    _, memory = with_remembered(first, states_of({8: (np.zeros(3), turn)}), NOTHING, REACH)
    second = contacts_of((1, 8, [contact(5, 0.3, 0.0)]))
    merged, _ = with_remembered(second, states_of({8: (np.zeros(3), turn)}), memory, REACH)
    assert merged.contact_ids.tolist() == [5, 6]
    np.testing.assert_allclose(merged.points_a[1], [0.4, 0.0, 0.0], atol=1e-15)


def test_a_remembered_contact_with_a_normal_of_its_own_is_dropped():
    """A sample has slipped over an edge: the pair touches only at another face, so the old contact is dropped."""
    aside = np.array([1.0, 0.0, 0.0])
    point = np.array([0.1, 0.0, 0.0])
    both = contacts_of((3, 8, [contact(1, 0.0, 0.0), (2, point, point, aside)]))
    states = states_of({3: STILL, 8: STILL})
    _, memory = with_remembered(both, states, NOTHING, REACH)
    left, after = with_remembered(contacts_of((3, 8, [(2, point, point, aside)])), states, memory, REACH)
    assert left.contact_ids.tolist() == [2]
    assert after.contact_ids.tolist() == [2], "for good"
    # With a slightly tilted normal, as on a curved face, the old contact stays.
    leaning = np.array([np.sin(0.4), 0.0, np.cos(0.4)])
    kept, _ = with_remembered(contacts_of((3, 8, [(4, point, point, leaning)])), states, memory, REACH)
    assert kept.contact_ids.tolist() == [4, 1]


def test_fragments_of_one_body_rest_in_contact_until_they_have_moved():
    """Fragments 3 and 4 are of one body, 8 of another; 4 has rotated about the first of its contacts with 3."""
    turn = Rotation.from_euler("z", 0.01)
    near, far = np.array([0.1, 0.0, 0.0]), np.array([0.3, 0.0, 0.0])
    moved = near - turn.apply(near)  # keeps the near point fixed
    contacts = contacts_of((3, 4, [(1, near, near, UP), (2, far, far, UP)]), (3, 8, [(3, near, near, UP)]))
    states = states_of({3: STILL, 4: (moved, turn), 8: STILL})
    _, memory = with_remembered(contacts, states, NOTHING, REACH)
    rest_gaps = np.array([1e-4, 2e-4])
    assert rest_gaps_of(memory, np.array([True, False]), rest_gaps).tolist() == [0.0, 1e-4, 2e-4]
    assert rest_gaps_of(memory, np.array([False, False]), rest_gaps).tolist() == [1e-4, 1e-4, 2e-4]
    assert rest_gaps_of(NOTHING, np.zeros(0, bool), np.zeros(0)).tolist() == []

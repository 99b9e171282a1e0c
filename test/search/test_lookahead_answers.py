"""Answers with lookahead contacts: their form, what they do not depend on, and cases with a known result."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from worlds.fractured_worlds import FracturedWorld
from worlds.gate_world import assert_same_bytes
from worlds.hard_worlds import tetrahedral_body
from worlds.sampled_worlds import ForgetfulWorld
from worlds.thrown_fragments import AHEAD, CASES, SETTINGS, later, rows_of, thrown, thrown_case, with_others

from fracture_collision.geometry.generators import brick
from fracture_collision.lockstep import Lockstep
from fracture_collision.records import SPHERE, CollisionBody, FractureEvent, FragmentStates, SolidPrimitive
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.world import CollisionWorld, InvalidMessage, Settings


@pytest.fixture(scope="module", params=CASES)
def case(request) -> FracturedWorld:
    return thrown_case(request.param)


def test_gaps_are_along_the_normals(case: FracturedWorld) -> None:
    answer = with_others(case, SETTINGS).contacts(thrown(case, 1, 10.0))
    normals = answer.normals.reshape(-1, 3)
    apart = (answer.points_b - answer.points_a).reshape(-1, 3)
    assert np.abs((normals * apart).sum(axis=1) - answer.gaps).max() < 1e-12
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-12
    assert len(answer.contact_ids) == len(np.unique(answer.contact_ids))


def test_present_contacts_are_the_same_with_lookahead(case: FracturedWorld) -> None:
    world, now = with_others(case, SETTINGS), with_others(case, SETTINGS._replace(lookahead=0.0))
    for seed in range(3):
        states = thrown(case, seed, 10.0)._replace(positions=case_positions(case, seed))
        listed, touching = world.contacts(states), now.contacts(states)
        every = rows_of(listed)
        assert len(rows_of(touching)) > 3
        for pair, rows in rows_of(touching).items():
            count = rows.stop - rows.start
            mine = slice(every[pair].start, every[pair].start + count)
            assert np.array_equal(listed.contact_ids[mine], touching.contact_ids[rows])
            assert np.array_equal(listed.gaps[mine], touching.gaps[rows])


def case_positions(case: FracturedWorld, seed: int) -> np.ndarray:
    """All fragments near their places before the fracture, so that they touch; ball and block far away."""
    random, n = np.random.default_rng(seed), len(case.states(0.0).fragment_ids)
    return np.concatenate([random.normal(0.0, 0.01, 3 * n), [9.0, 0.0, 5.0, -9.0, 0.0, 5.0]])


def test_the_answer_does_not_depend_on_neighbour_lists_or_threads(case: FracturedWorld) -> None:
    """With and without lists, with one and two threads, along a sequence of states."""
    worlds = [
        with_others(case, SETTINGS._replace(threads=threads), kind)
        for kind, threads in ((CollisionWorld, 1), (ForgetfulWorld, 1), (CollisionWorld, 2))
    ]
    states = thrown(case, 2, 10.0)
    still = states._replace(linear_velocities=np.zeros(0), angular_velocities=np.zeros(0))
    slow = states._replace(linear_velocities=0.02 * states.linear_velocities, angular_velocities=np.zeros(0))
    worlds[0].contacts(states)  # activates the registry
    flight = [later(worlds[0], states, t)._replace(step=k) for k, t in enumerate(np.linspace(0.0, 2.0 * AHEAD, 9))]
    flight += [states, still, states, slow, still, still, slow]
    # in place, where many touch: the previous answer may hold, or the next contacts must be searched
    places = case_positions(case, 0)
    creeping = still._replace(linear_velocities=1e-4 * states.linear_velocities)
    flight += [
        each._replace(positions=places)
        for each in (still, creeping, creeping, slow, creeping, states, creeping, states, still, slow, still)
    ]
    for k, each in enumerate(flight):
        answers = [world.contacts(each._replace(step=100 + k)) for world in worlds]
        for other in answers[1:]:
            assert_same_bytes(answers[0], other, k)


@pytest.mark.parametrize(("name", "first", "last"), [("vase", 430, 470), ("bricks", 60, 100)])
def test_each_answer_of_a_course_is_that_of_a_world_without_memory(name: str, first: int, last: int) -> None:
    """Pairs that come near within the step, but no deeper than epsilon, were listed or not by what was remembered."""
    scene = load_scene(name)
    settings = Settings(threads=1, lookahead=scene.time_step)
    slow = ForgetfulWorld(settings)
    events: list[FractureEvent] = []
    with Lockstep(scene, settings) as run:
        for body in run.simulation.start_bodies():
            slow.add_body(body)
        for _ in range(last):
            states, contacts, _, report, _ = run.step()
            if states.step >= first:
                for event in events:
                    slow.add_fracture(event)
                events.clear()
                assert_same_bytes(contacts, slow.contacts(states), states.step)
            events += report.events


def test_a_brick_rotating_above_a_floor_gets_contacts() -> None:
    """Its centre stays in place; relative to it, distant parts of the floor move at any speed."""
    world = CollisionWorld(SETTINGS._replace(lookahead=0.0025))
    world.add_body(tetrahedral_body(brick((0.06, 0.06, 0.004), 0.02), 1))
    world.add_body(CollisionBody(2, 2, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True))
    states = FragmentStates(
        1, 0, np.array([1]), np.array([0.0, 0.0, 0.01]), np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3),
        np.array([150.0, 0.0, 0.0]),
    )  # fmt: skip
    answer = world.contacts(states)
    assert len(answer.gaps) and np.allclose(answer.gaps, 0.008, atol=1e-9)


def test_bodies_in_common_rigid_motion_get_no_contacts() -> None:
    """Two bricks 4 cm apart tumble about their common centre at 50 rad/s: fast, but never closer."""
    world = CollisionWorld(SETTINGS._replace(lookahead=0.02))
    for i in (1, 2):
        world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), 0.5), i))
    spin, apart = np.array([0.0, 50.0, 0.0]), np.array([0.0, 0.0, 0.27])
    linear = np.cross(spin, [-apart, apart])
    states = FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.concatenate([-apart, apart]), np.tile([0.0, 0.0, 0.0, 1.0], 2),
        linear.ravel(), np.tile(spin, 2),
    )  # fmt: skip
    # their centres move straight, so they separate as they rotate
    assert len(world.contacts(states).gaps) == 0
    towards = states._replace(linear_velocities=(linear + [[0.0, 0.0, 15.0], [0.0, 0.0, 0.0]]).ravel())
    assert len(world.contacts(towards).gaps) > 0


def test_a_fast_ball_gets_a_contact_before_it_passes_through() -> None:
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.01), 0.2), 1))
    world.add_body(CollisionBody(2, 2, primitive=SolidPrimitive(SPHERE, (0.05,)), density=1000.0))
    states = FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.array([0.0, 0.0, 0.0, 0.1, 0.1, 1.0]), np.tile([0.0, 0.0, 0.0, 1.0], 2),
        np.array([0.0, 0.0, 0.0, 0.0, 0.0, -200.0]), np.zeros(6),
    )  # fmt: skip
    answer = world.contacts(states)
    assert answer.fragment_a.tolist() == [1] and answer.fragment_b.tolist() == [2]
    assert np.allclose(answer.normals.reshape(-1, 3), [0.0, 0.0, 1.0])
    assert np.allclose(answer.gaps, 1.0 - 0.05 - 0.005, atol=1e-4)
    beside = states._replace(positions=np.array([0.0, 0.0, 0.0, 0.57, 0.0, 1.0]))
    assert len(world.contacts(beside).gaps) == 0
    slower = states._replace(linear_velocities=0.2 * states.linear_velocities)
    assert len(world.contacts(slower).gaps) == 0


def rod_on_one_end(world: CollisionWorld, degrees: float) -> FragmentStates:
    """A rod of 10 cm on one end on a plate, tilted by 20 degrees, rotates down by `degrees` about that end."""
    world.add_body(tetrahedral_body(brick((0.5, 0.5, 0.01), 0.1), 1))
    world.add_body(tetrahedral_body(brick((0.1, 0.008, 0.008), 0.02), 2))
    turn, end = Rotation.from_rotvec([0.0, -np.radians(20.0), 0.0]), np.array([-0.05, 0.0, -0.004])
    place = np.array([0.0, 0.0, 0.005 + 1e-5]) - turn.apply(end)  # 0.01 mm above the plate
    w = np.array([0.0, np.radians(degrees) / SETTINGS.lookahead, 0.0])
    return FragmentStates(
        1, 0, np.array([1, 2], np.uint32), np.concatenate([np.zeros(3), place]),
        np.concatenate([[0.0, 0.0, 0.0, 1.0], turn.as_quat()]),
        np.concatenate([np.zeros(3), np.cross(w, turn.apply(-end))]), np.concatenate([np.zeros(3), w]),
    )  # fmt: skip


@pytest.mark.parametrize(("degrees", "hits"), [(40.0, True), (10.0, False)])
def test_a_rod_that_touches_with_one_end_gets_contacts_at_the_other(degrees: float, hits: bool) -> None:
    world, now = CollisionWorld(SETTINGS), CollisionWorld(SETTINGS._replace(lookahead=0.0))
    listed = world.contacts(rod_on_one_end(world, degrees))
    touching = now.contacts(rod_on_one_end(now, degrees))
    assert 0 < len(touching.gaps) == (listed.gaps < 1e-3).sum()
    assert np.isin(touching.contact_ids, listed.contact_ids).all()
    # the lower edge of the other end is 0.1 sin 20 above the point of impact
    far = listed.gaps[listed.gaps > 1e-3]
    assert (len(far) > 0) == hits and (not hits or abs(far.max() - 0.1 * np.sin(np.radians(20.0))) < 2e-3)


def test_invalid_lookahead_and_velocities_are_rejected() -> None:
    for wrong in (-1e-3, 1.5, np.nan):
        with pytest.raises(ValueError, match="lookahead"):
            CollisionWorld(Settings(lookahead=wrong))
    world = CollisionWorld(SETTINGS)
    world.add_body(tetrahedral_body(brick((1.0, 1.0, 0.5), 0.5), 1))
    states = FragmentStates(
        1, 0, np.array([1], np.uint32), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), np.array([1e300, 0.0, 0.0]),
        np.zeros(3),
    )  # fmt: skip
    with pytest.raises(InvalidMessage, match="linear_velocities"):
        world.contacts(states)
    with pytest.raises(InvalidMessage, match="angular_velocities"):
        world.contacts(states._replace(linear_velocities=np.zeros(3), angular_velocities=np.full(3, 1e300)))
    assert len(world.contacts(states._replace(linear_velocities=np.zeros(3))).gaps) == 0

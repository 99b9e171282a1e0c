"""The judge of scenes finds what floats, what is in something else, and energy from nowhere, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from worlds.small_scenes import GROUND, brick, small_scene

from benchmarks.scene_seeds import judging
from benchmarks.scene_seeds.__main__ import NUDGE, run_of, scene_of
from benchmarks.scene_seeds.judging import (
    EPSILON,
    FINEST,
    SPEED_AT_REST,
    EnergyWatch,
    Overlap,
    Rise,
    Verdict,
    moved,
    verdict,
)
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.world import Settings

SETTINGS = Settings(threads=1, lookahead=0.0025)
RIGHT = Verdict(1, 1, [], Overlap(), Rise(judged=10), 11)
SIDE = 0.2  # [m]


def scene_with(*bodies: tuple[list[float], list[float]]) -> Scene:
    """A ground and bricks: (size (3,) [m], position (3,) [m])."""
    bricks = [brick(f"brick {k}", size, SIDE, place) for k, (size, place) in enumerate(bodies)]
    return small_scene({"density": 700.0, "friction": 0.5}, GROUND, *bricks, duration=0.25)


def found_as_placed(*bodies: tuple[list[float], list[float]]) -> Verdict:
    """The verdict on bricks that were stopped in their first step: where they were placed."""
    scene = scene_with(*bodies)
    with Lockstep(scene, SETTINGS) as run:
        told = run.simulation.start_bodies(), []
        for _ in range(2):  # they enter the engine in the first
            run.step()
            places = run.simulation.dynamics.states()
        still = np.zeros((len(places.masses), 3))
        fallen = -places.centers + [place for _, place in bodies]
        run.simulation.dynamics.advance(still, still, fallen / scene.time_step, still)
        run.simulation.dynamics.advance(still, still, still, still)
        return verdict(run, scene, told, np.zeros(0, int))


CUBE = [SIDE, SIDE, SIDE]
STANDING = (CUBE, [0.0, 0.0, SIDE / 2.0 + 1e-4])


def test_a_cube_on_the_ground_is_right() -> None:
    found = found_as_placed(STANDING)
    assert (found.fragments, found.at_rest, found.faults) == (1, 1, [])


def test_a_floating_body_is_unsupported() -> None:
    found = found_as_placed(STANDING, (CUBE, [0.0, 0.0, 2.0 * SIDE]))
    assert found.at_rest == 2 and found.unsupported == [3]
    assert found.faults == ["1 unsupported: 3"]


def test_a_body_in_another_is_deep() -> None:
    depth = 0.003
    found = found_as_placed(STANDING, (CUBE, [0.0, 0.0, 1.5 * SIDE + 1e-4 - depth]))
    assert found.overlap.fragments == (2, 3)
    # flush: no sample is deep, and libigl has the surfaces in single precision
    assert found.overlap.depth_m == pytest.approx(depth, abs=SIDE * float(np.finfo(np.float32).eps))
    assert found.overlap.depth == pytest.approx(found.overlap.depth_m / (SIDE / 2.0), rel=1e-6)
    assert found.faults == ["2 in 3: 3.00 % R, 3.00 mm"]


def test_depth_between_samples_is_found() -> None:
    """A bar through a bar: their corners are far outside, and the service lists what its ridges find."""
    long, thin, depth = 0.8, 0.05, 0.002
    lower = [long, thin, thin], [0.0, 0.0, thin / 2.0]
    upper = [thin, long, thin], [0.0, 0.0, 1.5 * thin - depth]
    found = found_as_placed(lower, upper)
    assert found.overlap.depth_m == pytest.approx(depth, abs=FINEST * long / 2.0)
    assert found.overlap.depth > EPSILON and len(found.faults) == 1


def test_what_is_pushed_out_of_something_is_not_at_rest() -> None:
    scene = scene_with(STANDING, (CUBE, [0.0, 0.0, 1.5 * SIDE - 0.003]))
    with Lockstep(scene, SETTINGS) as run:
        for _ in range(3):
            before = run.simulation.dynamics.states()
            run.step()
        now = run.simulation.dynamics.states()
    assert np.abs(now.linear).max() < SPEED_AT_REST
    assert moved(before, now, scene.time_step).tolist() == [3]


def test_energy_from_nowhere_is_found() -> None:
    scene = scene_with((CUBE, [0.0, 0.0, 1.0]))
    with Lockstep(scene, SETTINGS) as run:
        watch = EnergyWatch()
        for step in range(20):
            if step == 10:
                engine = run.simulation.dynamics
                states = engine.states()
                still = np.zeros((1, 3))
                before = 0.5 * states.masses[0] * (states.linear**2).sum()
                engine.advance(1.01 * states.linear, states.angular, -1.01 * states.linear, still)
            watch.take(run.step())
    assert watch.rise.step == 10 and watch.rise.judged == 19
    total = states.masses[0] * 9.81 * 1.0
    assert watch.rise.share == pytest.approx((1.01**2 - 1.0) * before / total, rel=1e-2)
    assert watch.rise.solved == watch.rise.share and watch.rise.lifted == 0.0
    assert len(RIGHT._replace(rise=watch.rise).faults) == 1


def test_a_scene_is_judged_and_seeds_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    found = run_of("pane", "flat", 0).found
    assert found.steps == 60 and found.rise.judged == 59
    assert found.fragments == found.at_rest > 5 and not found.unsupported
    monkeypatch.setattr(judging, "verdict", lambda *_: RIGHT)  # it takes seconds, and the run's energy differs too
    assert run_of("pane", "flat", 1).found.rise != found.rise


@pytest.mark.slow
def test_interlocked_bricks_come_to_rest_and_apart() -> None:
    """They ended 0.8 % R deep in each other, where no translation parts them, or never came to rest."""
    found = run_of("bricks", "own", 2).found
    assert found.at_rest == found.fragments > 90
    assert found.overlap.depth <= EPSILON


@pytest.mark.slow
def test_a_piece_on_a_nearly_flat_edge_is_supported() -> None:
    """It lies 0.02 mm from an edge that is searched for no crossings; the nearest samples are 0.23 mm away."""
    assert not run_of("reference_sphere", "own", 7).found.unsupported


@pytest.mark.parametrize("name", ["wall", "plate_in_bowl"])
def test_scenes_without_cracks_start_elsewhere(name: str) -> None:
    one, again, other = (scene_of(name, "own", seed) for seed in (1, 1, 2))
    starts = [np.hstack([np.r_[body.position, body.orientation, body.linear_velocity] for body in each.bodies])
              for each in (one, again, other)]  # fmt: skip
    assert (starts[0] == starts[1]).all() and (starts[0] != starts[2]).any()
    if name == "wall":
        assert np.abs(one.bodies[1].position - other.bodies[1].position).max() <= 2.0 * NUDGE

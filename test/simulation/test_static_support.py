"""Bodies at rest at the end of a scene are supported by their contacts, and fall when the support is removed."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from truth.static_support import support_of
from worlds.small_scenes import GROUND, TIME_STEP, box, brick, small_scene

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene
from fracture_collision.simulation.scene.scene_changes import with_curvature
from fracture_collision.world.settings import PaperSettings, Settings

SCENES = [
    "plates", "bricks", "drop_bunnies", "bunnies", "piggy_bank", "vase", "wall", "reference_sphere", "pane",
    "plate_in_bowl", "rolling_plate",
]  # fmt: skip
CURVATURES = [0.0, 0.25]
SEEDS = range(10)


def run_of(scene, seed=None):
    return Lockstep(scene, Settings(threads=1, lookahead=scene.time_step), seed)  # as `scene` runs it


def longest_hold(run):
    """Of a whole run: most steps in which lookahead held a fragment back that nothing touched; the last report."""
    counts, longest = Counter(), 0
    for exchange in run:
        answer, ids = exchange.contacts, run.simulation.dynamics.states().fragment_ids
        has_contacts = np.diff(answer.pair_begin) > 0
        touch = set(answer.fragment_a[has_contacts]) | set(answer.fragment_b[has_contacts])
        shares = run.simulation.dynamics.shares
        held = set(ids[shares < 1.0]) - touch if len(shares) == len(ids) else set()
        counts = Counter({i: counts[i] + 1 for i in held})
        longest = max(longest, *counts.values(), 0)
    return longest, exchange.report


# Runs in which shards used to hang beside the rack by outdated contacts, or by its edge.
@pytest.mark.parametrize(("curvature", "seed"), [
    (0.25, 7), *(pytest.param(*run, marks=pytest.mark.slow) for run in ((0.25, 9), (0.0, 0)))
])
def test_no_shard_of_the_default_demo_floats(curvature, seed):
    """One that nothing touches falls as others do; bodies beside it may hold it back for some steps."""
    scene = with_curvature(load_scene("plates"), curvature)
    with run_of(scene, seed) as run:
        longest, report = longest_hold(run)
        support = support_of(run, scene, hooks=False)
    assert 0 < longest < 50
    assert support.unsupported == []
    assert len(support.fragment_ids) > 50, "they lie still"
    assert report.deepest_gap > -0.002


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("curvature", CURVATURES)
@pytest.mark.parametrize("name", SCENES)
def test_bodies_at_rest_are_supported(name, curvature):
    scene, floating = with_curvature(load_scene(name), curvature), {}
    for seed in SEEDS:
        with run_of(scene, seed) as run:
            for _ in run:
                pass
            floating[seed] = support_of(run, scene).unsupported
    assert not any(floating.values()), floating


def stand(support=True, wall=True):
    """A block on a pedestal, flush with a wall."""
    boxes = [box("wall", [0.5, 1.0, 2.0], [-0.25, 0.0, 1.0], static=True)] if wall else []
    boxes += [box("pedestal", [0.2, 0.2, 0.4], [0.1, 0.0, 0.2])] if support else []
    boxes += [box("block", [0.2, 0.2, 0.2], [0.1, 0.0, 0.5])]
    return small_scene({"density": 700.0, "friction": 0.5}, GROUND, *boxes, duration=2.0)


SAMPLES = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))


def hooked():
    """A slab with samples 30 um below the upper edge of a leaning box and 40 um inside its front: invisibly little."""
    lean = [-15.0, 0.0, 0.0]
    place = Rotation.from_euler("xyz", lean, degrees=True).apply([0.0, -0.11 + 4e-5, 0.1 - 3e-5])
    rack = box("rack", [0.4, 0.2, 0.2], static=True, rotation=lean)
    slab = brick("slab", [0.1, 0.02, 0.08], 0.02, place.tolist(), rotation=lean)
    return small_scene({"density": 2400.0, "friction": 0.3}, rack, slab)


def test_a_slab_on_an_invisibly_narrow_edge_falls():
    scene = hooked()
    in_contact = scene.solver._replace(rest_gap=0.0, rest_slop=0.002)
    for solver, floats in ((scene.solver, False), (in_contact, True)):
        # contacts at samples alone: whole surfaces meet elsewhere, too
        with Lockstep(scene._replace(solver=solver), SAMPLES) as run:
            for _ in range(100):
                run.step()
            states = run.simulation.dynamics.states()
            assert support_of(run, scene, hooks=False).unsupported == ([2] if floats else [])
            assert (states.linear[0, 2] < -1.5) != floats, states.linear


def test_a_body_falls_within_two_steps_when_its_support_is_removed():
    scene = stand()
    with Lockstep(scene, Settings(threads=1)) as run:
        for _ in range(200):
            report = run.step().report
        assert report.max_speed < 1e-6
        assert support_of(run, scene).unsupported == []
        names = {body.name: i for i, body in run.simulation._cast.body_of.items()}
        run.simulation.take_out(names["pedestal"])
        run.step()
        run.step()
        states = run.simulation.dynamics.states()
        assert states.linear[0, 2] < -0.9 * TIME_STEP * 9.81


@pytest.mark.parametrize(("support", "wall", "falls"), [(True, False, False), (True, True, False), (False, True, True)])
def test_the_linear_program_finds_floating_bodies(support, wall, falls):
    """The block as placed, before it moves: on its pedestal, or beside a wall with nothing below it."""
    scene = stand(support, wall)
    with Lockstep(scene, Settings(threads=1)) as run:
        run.step()
        engine = run.simulation.dynamics
        still = np.zeros((len(engine.states().masses), 3))
        engine.advance(still, still, still, still)
        block = max(i for i, body in run.simulation._cast.body_of.items() if body.name == "block")
        assert support_of(run, scene).unsupported == ([block] if falls else [])

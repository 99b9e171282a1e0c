"""Bodies at rest at the end of a scene are supported by their contacts, and fall when the support is removed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from truth.static_support import support_of

from fracture_collision.geometry import generators
from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import load_scene, parse_scene
from fracture_collision.simulation.scene.scene_changes import with_curvature
from fracture_collision.world.settings import PaperSettings, Settings

SCENES = [
    "plates", "bricks", "drop_bunnies", "bunnies", "piggy_bank", "vase", "wall", "reference_sphere", "pane",
    "plate_in_bowl", "rolling_plate",
]  # fmt: skip
CURVATURES = [0.0, 0.25]
SEEDS = range(10)
TIME_STEP = 0.0025


def unsupported(name, curvature, seed, hooks=True):
    scene = with_curvature(load_scene(name), curvature)
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step), seed) as run:  # as `scene` runs it
        for _ in run:
            pass
        return support_of(run, scene, hooks)


# Runs in which shards used to hang beside the rack by outdated contacts, or by its edge.
@pytest.mark.parametrize(("curvature", "seed"), [(0.25, 7), (0.25, 9), (0.0, 0)])
def test_no_shard_of_the_default_demo_floats(curvature, seed):
    support = unsupported("plates", curvature, seed, hooks=False)
    assert support.unsupported == []
    assert len(support.fragment_ids) > 50, "they lie still"


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("curvature", CURVATURES)
@pytest.mark.parametrize("name", SCENES)
def test_bodies_at_rest_are_supported(name, curvature):
    floating = {seed: unsupported(name, curvature, seed).unsupported for seed in SEEDS}
    assert not any(floating.values()), floating


def stand(support=True, wall=True):
    """A block on a pedestal, flush with a wall."""
    boxes = [("wall", [0.5, 1.0, 2.0], [-0.25, 0.0, 1.0], True)] if wall else []
    boxes += [("pedestal", [0.2, 0.2, 0.4], [0.1, 0.0, 0.2], False)] if support else []
    boxes += [("block", [0.2, 0.2, 0.2], [0.1, 0.0, 0.5], False)]
    return parse_scene(
        {
            "time_step": TIME_STEP, "duration": 2.0, "materials": {"wood": {"density": 700.0, "friction": 0.5}},
            "bodies": [
                {"name": "ground", "material": "wood", "static": True,
                 "shape": {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}},
                *[{"name": name, "material": "wood", "static": static, "shape": {"box": {"size": size}},
                   "position": place} for name, size, place, static in boxes],
            ],
        },
        "stand",
    )  # fmt: skip


SAMPLES = Settings(threads=1, method="glondu2014", paper=PaperSettings(field="exact"))


def hooked():
    """A slab with samples 30 um below the upper edge of a leaning box and 40 um inside its front: invisibly little."""
    lean = [-15.0, 0.0, 0.0]
    place = Rotation.from_euler("xyz", lean, degrees=True).apply([0.0, -0.11 + 4e-5, 0.1 - 3e-5])
    stone = {"density": 2400.0, "friction": 0.3}
    return parse_scene(
        {
            "time_step": TIME_STEP, "duration": 1.0, "materials": {"stone": stone},
            "bodies": [
                {"name": "rack", "material": "stone", "static": True, "shape": {"box": {"size": [0.4, 0.2, 0.2]}},
                 "rotation": lean},
                {"name": "slab", "material": "stone", "position": place.tolist(), "rotation": lean,
                 "shape": {"brick": {"size_xyz": [0.1, 0.02, 0.08], "edge_length": 0.02}}},
            ],
        },
        "hooked",
    )  # fmt: skip


def test_a_slab_on_an_invisibly_narrow_edge_falls():
    scene = hooked()
    in_contact = scene.solver._replace(rest_gap=0.0, rest_slop=0.002)
    for solver, floats in ((scene.solver, False), (in_contact, True)):
        # contacts at samples alone: whole surfaces meet elsewhere, too
        with Lockstep(scene._replace(solver=solver), SAMPLES) as run:
            for _ in range(100):
                run.step()
            states = run.simulation._engine.states()
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
        states = run.simulation._engine.states()
        assert states.linear[0, 2] < -0.9 * TIME_STEP * 9.81


@pytest.mark.parametrize(("support", "wall", "falls"), [(True, False, False), (True, True, False), (False, True, True)])
def test_the_linear_program_finds_floating_bodies(support, wall, falls):
    """The block as placed, before it moves: on its pedestal, or beside a wall with nothing below it."""
    scene = stand(support, wall)
    with Lockstep(scene, Settings(threads=1)) as run:
        run.step()
        engine = run.simulation._engine
        still = np.zeros((len(engine.states().masses), 3))
        engine.advance(still, still, still, still)
        block = max(i for i, body in run.simulation._cast.body_of.items() if body.name == "block")
        assert support_of(run, scene).unsupported == ([block] if falls else [])


def smash(scene):
    """All reports, all answers' bytes, the last contacts, and the lowest point [m] of each fragment at the end."""
    reports, answers = [], []
    with Lockstep(scene) as run:
        for states, contacts, _, report, _ in run:
            parts = (contacts.gaps, contacts.normals, contacts.contact_ids, states.positions)
            answers.append(b"".join(part.tobytes() for part in parts))
            reports.append(report)
        return reports, answers, contacts, lowest_points(run)


def lowest_points(run: Lockstep) -> list[float]:
    """Lowest point of each fragment and body in the states; frame origins would not do, as they may be anywhere."""
    states = run.states()
    run.world.contacts(states)
    poses = zip(
        states.fragment_ids.tolist(), states.positions.reshape(-1, 3), states.orientations.reshape(-1, 4), strict=True
    )
    lowest = []
    for fragment, position, turn in poses:
        points = run.world.fragment_mesh(fragment).vertices.reshape(-1, 3)
        if len(points):
            lowest.append(float((position + Rotation.from_quat(turn).apply(points))[:, 2].min()))
    return lowest


@pytest.fixture(scope="module")
def scene():
    """One plate of the plates scene, of a coarse mesh, one ball, over a shelf only 10 cm high."""
    full = load_scene("plates")
    coarse = generators.plate(0.25, 0.01, 0.025, 0.018, layers=1)
    bodies = []
    for body in full.bodies:
        if body.name == "plate 1":
            bodies.append(body._replace(shape=body.shape._replace(mesh=coarse)))
        elif body.name == "ball 1":
            bodies.append(body._replace(start_time=0.0, position=body.position + [0.0, 0.8, -0.02]))
        elif body.is_static:
            bodies.append(body)
    return full._replace(bodies=tuple(bodies), duration=2.0)


@pytest.fixture(scope="module")
def run(scene):
    return smash(scene)


def test_the_plate_breaks_and_comes_to_rest(run):
    reports, _, contacts, _ = run
    events = [event for report in reports for event in report.events]
    assert [event.sequence for event in events] == list(range(1, len(events) + 1))
    assert reports[-1].fragments >= 10
    assert reports[-1].max_speed < 0.01
    assert contacts.gaps.min() > -0.002


def test_nothing_falls_through_shelf_or_ground(run):
    lowest = run[3]
    assert len(lowest) >= 10
    assert min(lowest) > -0.002  # as deep as a contact may be


def test_energy_never_rises_without_cause(run):
    reports = run[0]
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    drift = np.array([report.drift_energy for report in reports])
    unbroken = np.diff([report.fragments for report in reports]) == 0
    rise = (np.diff(energy) - drift[1:])[unbroken]
    assert rise.max() < 2e-5 * energy.max()
    assert drift.sum() < 0.02 * energy.max()


def test_a_shorter_run_gives_the_same_bytes(scene, run):
    part = scene._replace(duration=0.5)
    assert smash(part)[1] == run[1][: part.step_count]

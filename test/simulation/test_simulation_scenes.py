"""The package's scenes: each loads, breaks as expected, gains no energy, and comes to rest."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import Scene, SceneError, load_scene, parse_scene, scene_files
from fracture_collision.simulation.scene.scene_changes import random_drop, with_curvature
from fracture_collision.simulation.simulation import StepReport
from fracture_collision.world import Settings

loaded = cache(load_scene)  # some meshes take seconds


class Expected(NamedTuple):
    steps: int  # until the first bodies have broken
    fragments: tuple[int, int]  # that move in the end, at least and at most
    bodies: int  # that can break


SCENES = {
    "piggy_bank": Expected(60, (15, 120), 1),
    "drop_bunnies": Expected(50, (110, 250), 27),
    "bricks": Expected(70, (110, 220), 32),
    "vase": Expected(470, (30, 80), 1),
    "bunnies": Expected(660, (20, 90), 5),
    "reference_sphere": Expected(30, (8, 40), 1),
}


def run(scene: Scene, steps: int) -> list[StepReport]:
    """Reports of the first steps. Energy rises only by drift correction, a hand or a robot, or with a body that joins.

    That includes steps in which bodies break: their pieces move as the whole did.
    """
    with Lockstep(scene._replace(duration=steps * scene.time_step), Settings(threads=1)) as lockstep:
        reports = [exchange.report for exchange in lockstep]
    energy = np.array([report.kinetic_energy + report.potential_energy for report in reports])
    assert np.isfinite(energy).all()
    given = np.array([report.drift_energy + report.hand_energy for report in reports])
    # pieces replace their body in the step after its event; a body that is added later brings its own energy
    pieces = [sum(len(event.new_fragment_ids) - 1 for event in report.events) for report in reports]
    is_joined = np.diff([report.fragments for report in reports]) != pieces[:-1]
    joining = {round(body.start_time / scene.time_step) for body in scene.bodies if body.start_time > 0.0}
    assert is_joined.sum() <= len(joining)
    rise = (np.diff(energy) - given[1:])[~is_joined]
    assert rise.max(initial=0.0) <= 2e-5 * np.abs(energy).max()
    return reports


def assert_no_deeper_than_two_steps(reports: list[StepReport], scene: Scene) -> None:
    """No contact may be deeper than the motion of two and a half steps at the greatest speed.

    An impact penetrates by one step's motion; if the body breaks, the impulse is capped and its pieces penetrate by
    another step's. A quarter more allows for spin, as the speed is that of centres of mass.
    """
    fastest = max(report.max_speed for report in reports)
    assert min(report.deepest_gap for report in reports) > -2.5 * fastest * scene.time_step


@pytest.mark.parametrize("file", scene_files(), ids=lambda file: file.path.stem)
def test_scenes_and_variants_load_and_equal_shapes_share_one_mesh(file):
    assert file.title.endswith("."), "the first line is what `scenes` lists"
    name = file.path.stem
    for variant in file.variants:
        assert loaded(f"{name}:{variant}").name.endswith(variant)
    scene = loaded(name)
    assert scene.name == name and scene.step_count > 10
    meshes = [body.shape.mesh for body in scene.bodies if body.shape.mesh is not None]
    assert len({mesh.vertices.tobytes() for mesh in meshes}) == len({id(mesh) for mesh in meshes})
    if name in SCENES:
        breakable = [b for b in scene.bodies if b.material.fracture is not None and b.shape.mesh is not None]
        assert len(breakable) == SCENES[name].bodies


@pytest.mark.parametrize("name", sorted(SCENES))
def test_scenes_break_without_gaining_energy(name):
    expected, scene = SCENES[name], loaded(name)
    reports = run(scene, expected.steps)
    events = [event for report in reports for event in report.events]
    assert events and reports[-1].fragments > reports[0].fragments
    assert_no_deeper_than_two_steps(reports, scene)
    links = [] if scene.robot is None else [part for part in scene.robot.shapes if not part.is_static]
    assert reports[0].fragments <= expected.bodies + len(links)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("curvature", [0.0, 0.25])
@pytest.mark.parametrize("name", sorted(SCENES))
def test_whole_scenes_break_and_come_to_rest(name, curvature):
    expected, scene = SCENES[name], with_curvature(load_scene(name), curvature)
    reports = run(scene, scene.step_count)
    at_least, at_most = expected.fragments
    assert at_least <= reports[-1].fragments <= at_most
    assert_no_deeper_than_two_steps(reports, scene)
    assert sum(report.drift_energy for report in reports) < 0.1 * max(report.kinetic_energy for report in reports)
    # at rest, and no longer penetrating
    assert np.median([report.max_speed for report in reports[-40:]]) < 0.02
    assert reports[-1].deepest_gap > -1e-3


@pytest.mark.parametrize(("variant", "triangles", "inside"), [
    ("", 2420, 4000), (":fine_surface", 9680, 4000), (":coarse_inside", 2420, 435),
])  # fmt: skip
def test_the_reference_sphere_in_the_samplings_of_the_paper(variant, triangles, inside):
    scene = loaded("reference_sphere" + variant)
    assert scene.name == "reference_sphere" + variant
    (mesh,) = [body.shape.mesh for body in scene.bodies if body.shape.mesh is not None]
    on_surface = np.isclose(np.linalg.norm(mesh.vertices, axis=1), 0.1, rtol=1e-9)
    assert 2 * (np.count_nonzero(on_surface) - 2) == triangles
    assert np.count_nonzero(~on_surface) == pytest.approx(inside, rel=0.02)


def test_a_plate_comes_to_rest_in_the_bowl():
    scene = load_scene("plate_in_bowl")
    reports = run(scene, 300)
    assert not any(report.events for report in reports)
    assert reports[-1].contacts > 0 and reports[-1].max_speed < 0.1
    assert reports[-1].deepest_gap > -1e-3
    assert 0.0 < reports[-1].potential_energy < 0.3 * reports[0].potential_energy


def test_random_drops_depend_on_their_seed_and_stay_in_the_bowl():
    scene = load_scene("plate_in_bowl")
    one, again, other = (random_drop(scene, seed) for seed in (1, 1, 2))
    assert one.bodies[1].orientation.tolist() == again.bodies[1].orientation.tolist()
    assert one.bodies[1].angular_velocity.tolist() == again.bodies[1].angular_velocity.tolist()
    assert one.bodies[1].orientation.tolist() != other.bodies[1].orientation.tolist()
    assert one.bodies[0] is scene.bodies[0]
    assert all(random_drop(scene, seed).bodies[1].linear_velocity[2] <= 0.0 for seed in range(20))
    turns = Rotation.from_quat([random_drop(scene, seed).bodies[1].orientation for seed in range(200)])
    assert np.abs(turns.apply([0.0, 0.0, 1.0]).mean(axis=0)).max() < 0.15
    with Lockstep(one, Settings(threads=1)) as lockstep:
        for _ in range(240):
            exchange = lockstep.step()
    x, y, z = exchange.states.positions.reshape(-1, 3)[1]
    assert np.hypot(x, y) < 0.18 and 0.0 < z < 0.3


def test_curvature_applies_to_all_cracks():
    scene = load_scene("plates")
    for curvature in (0.0, 0.4):
        changed = with_curvature(scene, curvature)
        found = {b.material.fracture.pattern.curvature for b in changed.bodies if b.material.fracture is not None}
        assert found == {curvature}
    with pytest.raises(ValueError, match="curvature: -1"):
        with_curvature(scene, -1.0)


CONTENT = {
    "time_step": 0.01, "duration": 1.0, "materials": {"stone": {"density": 2000.0, "friction": 0.5}},
    "bodies": [{"name": "stone", "material": "stone", "shape": {"sphere": {"radius": 0.1}}, "position": [0, 0, 1]}],
    "variants": {
        "late": {"bodies": {"stone": {"start_time": 0.5}}, "duration": 2.0},
        "unknown": {"bodies": {"pebble": {}}},
        "odd": {"bodies": {"stone": {"shape": {"cone": {}}}}},
    },
}  # fmt: skip


def test_a_variant_changes_only_the_fields_it_names():
    plain, late = parse_scene(CONTENT, "own"), parse_scene(CONTENT, "own", "late")
    assert (late.name, late.duration, late.bodies[0].start_time) == ("own:late", 2.0, 0.5)
    assert (plain.duration, plain.bodies[0].start_time) == (1.0, 0.0)
    assert late.bodies[0].position.tolist() == [0.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("variant", "words"),
    [
        ("early", "own: has no variant 'early'; there are late, unknown, odd"),
        ("unknown", "variants.unknown.bodies: no body 'pebble'"),
        ("odd", r"bodies\[0\].shape: needs just one of"),
    ],
)
def test_invalid_variants_are_rejected(variant, words):
    with pytest.raises(SceneError, match=words):
        parse_scene(CONTENT, "own", variant)
    with pytest.raises(SceneError, match="no scene 'nowhere:late'"):
        load_scene("nowhere:late")

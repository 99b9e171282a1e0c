"""Results do not depend on the unit of length, and bodies of any size come to rest on each other."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pytest
from worlds.small_scenes import GROUND, box, small_scene

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.config.scene_fields import Fields
from fracture_collision.simulation.config.shapes import parse_shape
from fracture_collision.simulation.scene.scene import Scene
from fracture_collision.simulation.solver.contact_solver import SolverSettings
from fracture_collision.world import Settings

SIZE = (0.12, 0.1, 0.08)
# Of each box: position at scale 1, rotation; the first two are a stack, the third falls.
BOXES = (
    ((0.0, 0.0, 0.0401), (0.0, 0.0, 3.0)),
    ((0.003, -0.002, 0.1203), (0.0, 0.0, -8.0)),
    ((0.5, 0.0, 0.16), (12.0, 7.0, 0.0)),
)


def boxes(scale: float, time_step: float, gravity: float, duration: float, **stone: float) -> Scene:
    """A stack of two turned boxes, and one that falls on a corner; lengths times `scale`."""
    placed = [
        box(f"box {i}", [scale * x for x in SIZE], [scale * x for x in place], rotation=list(turn))
        for i, (place, turn) in enumerate(BOXES)
    ]
    material = {"density": 2000.0, "friction": 0.5} | stone
    return small_scene(material, GROUND, *placed, gravity=gravity, time_step=time_step, duration=duration)


@cache
def course_of(scale: float, restitution: float) -> tuple[np.ndarray, np.ndarray]:
    return course(boxes(scale, 0.0025, scale * 9.81, 0.5, restitution=restitution))


def course(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Centres of mass (steps, 3, 3) [m], and who is asleep at the end (3,)."""
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step)) as run:
        places = [run.simulation.dynamics.states().centers.copy() for _ in run]
        return np.array(places), run.simulation.dynamics._rest.asleep.copy()


@pytest.mark.parametrize("restitution", [0.0, 0.4])
@pytest.mark.parametrize("scale", [0.01, 100.0])
def test_a_scene_takes_the_same_course_in_another_unit_of_length(scale: float, restitution: float) -> None:
    places, asleep = course_of(1.0, restitution)
    scaled, scaled_asleep = course_of(scale, restitution)
    np.testing.assert_allclose(scaled / scale, places, rtol=0.0, atol=1e-6 * SIZE[0])
    assert scaled_asleep.tolist() == asleep.tolist()


@pytest.mark.parametrize(("scale", "sleep_time"), [(0.01, SolverSettings().sleep_time), (0.001, 0.01)])
def test_small_bodies_fall_asleep_on_each_other(scale: float, sleep_time: float) -> None:
    """On earth, with a time step in which they fall by the same share of their size as large ones."""
    root = math.sqrt(scale)
    scene = boxes(scale, 0.0025 * root, 9.81, root + 1.2 * sleep_time)
    places, asleep = course(scene._replace(solver=scene.solver._replace(sleep_time=sleep_time)))
    assert asleep.all()
    heights = places[-1, :2, 2] / scale
    np.testing.assert_allclose(heights, [0.04, 0.12], atol=2e-4)


def test_the_size_of_a_body_is_half_the_longest_side_of_its_box() -> None:
    shapes = {
        "box": {"size": [0.2, 0.6, 0.4]}, "sphere": {"radius": 0.3}, "plane": {"coefficients": [0, 0, 1, 0]},
        "brick": {"size_xyz": [0.2, 0.4, 0.6], "edge_length": 0.2},
    }  # fmt: skip
    sizes = [parse_shape(Fields({kind: fields}, "shape"), {}).half_length() for kind, fields in shapes.items()]
    assert sizes == pytest.approx([0.3, 0.3, math.inf, 0.3])

"""Impacts without loss, one after the other along a row; free flight and free spin that keep what they should."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import parse_scene
from fracture_collision.world import Settings

GROUND = {"name": "ground", "material": "lossless", "static": True, "shape": {"plane": {"coefficients": [0, 0, 1, 0]}}}
BALL, CUBE = {"sphere": {"radius": 0.05}}, {"box": {"size": [0.1, 0.1, 0.1]}}


class Course(NamedTuple):
    """Of n bodies, at each of m steps."""

    centers: np.ndarray  # (m, n, 3) [m]
    linear: np.ndarray  # (m, n, 3) [m/s]
    momenta: np.ndarray  # (m, n, 3) [kg m2/s] angular
    energy: np.ndarray  # (m,) [J]


def body(name: str, shape: dict[str, Any], x: float = 0.0, z: float = 0.0, **more: Any) -> dict[str, Any]:
    return {"name": name, "material": "lossless", "shape": shape, "position": [x, 0.0, z], **more}


def course(bodies: list[dict[str, Any]], duration: float, gravity: float = 0.0, step: float = 0.0025) -> Course:
    scene = parse_scene(
        {
            "gravity": [0.0, 0.0, -gravity], "time_step": step, "duration": duration, "bodies": bodies,
            "materials": {"lossless": {"density": 1000.0, "friction": 0.0, "restitution": 1.0}},
        }, "impacts",
    )  # fmt: skip
    rows = []
    with Lockstep(scene, Settings(threads=1, lookahead=step)) as run:
        for each in run:
            states = run.simulation._engine.states()
            momenta = np.einsum("nij,nj->ni", states.inertias, states.angular)
            energy = each.report.kinetic_energy + each.report.potential_energy
            rows.append((states.centers, states.linear, momenta, energy))
    return Course(*map(np.array, zip(*rows, strict=True)))


@pytest.mark.parametrize("shape", [BALL, CUBE], ids=["ball", "cube"])
@pytest.mark.parametrize(("step", "lost"), [(0.0025, 5e-5), (0.01, 5e-4)])
def test_a_bounce_without_loss_rises_as_high_as_it_fell(shape: dict[str, Any], step: float, lost: float) -> None:
    run = course([GROUND, body("a", shape, z=0.55)], 3.0, gravity=9.81, step=step)
    z = run.centers[:, 0, 2]
    tops = np.flatnonzero((z[1:-1] >= z[:-2]) & (z[1:-1] > z[2:])) + 1
    assert len(tops) == 4
    for bounces, top in enumerate(tops, 1):
        assert run.energy[top] > (1.0 - lost * bounces) * run.energy[0]
    assert np.diff(run.energy).max() < 1e-12 * run.energy[0]


@pytest.mark.parametrize("shape", [BALL, CUBE], ids=["balls", "cubes"])
@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_row_that_touches_passes_a_blow_on_to_as_many_at_its_end(shape: dict[str, Any], count: int) -> None:
    row = [
        body(f"b{k}", shape, 0.1 * k - 0.2 * (k < count), **({"linear_velocity": [1.0, 0, 0]} if k < count else {}))
        for k in range(5)
    ]
    run = course(row, 0.5)
    np.testing.assert_allclose(run.linear[-1, :, 0], [0.0] * (5 - count) + [1.0] * count, atol=1e-6)
    assert run.energy[-1] == pytest.approx(run.energy[0], rel=1e-9)


@pytest.mark.parametrize("spin", [10.0, 100.0, 360.0])
def test_a_free_spin_keeps_its_angular_momentum_and_energy(spin: float) -> None:
    shape = {"box": {"size": [0.1, 0.06, 0.03]}}
    run = course([body("a", shape, angular_velocity=[0.6 * spin, 0.64 * spin, 0.48 * spin])], 1.0)
    change = run.momenta[:, 0] - run.momenta[0, 0]
    assert np.linalg.norm(change, axis=1).max() < 1e-11 * np.linalg.norm(run.momenta[0, 0])
    assert np.ptp(run.energy) < 1e-11 * run.energy[0]


def test_free_flight_is_a_parabola() -> None:
    run = course([body("a", CUBE, linear_velocity=[1.0, 0.0, 2.0])], 0.5, gravity=9.81)
    t = 0.0025 * np.arange(1, len(run.centers) + 1)
    np.testing.assert_allclose(run.centers[:, 0, 2], 2.0 * t - 0.5 * 9.81 * t * t, atol=1e-12)
    np.testing.assert_allclose(run.centers[:, 0, 0], t, atol=1e-12)

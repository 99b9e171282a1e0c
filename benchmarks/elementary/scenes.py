"""The scenes that everybody tries first: what they must end like, and whether they do.

    python -m benchmarks.elementary [--only NAME] [--kinds box,brick1,brick2] [--scales 1,0.01] [--steps 2.5,10]

Lengths in a scene are of order 0.1 to 1 m at scale 1. At another scale lengths change, and times with their root, so
that under the same gravity everything happens alike.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import click
import numpy as np

from fracture_collision.lockstep import Lockstep
from fracture_collision.simulation.scene.scene import Scene, parse_scene
from fracture_collision.simulation.solver.contact_solver import SolverSettings
from fracture_collision.world import Settings

KINDS = ("box", "brick1", "brick2", "brick8")
PLANE = {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}
STICKY, ICE, BOUNCY = "sticky", "ice", "bouncy"
MATERIALS = {
    STICKY: {"density": 1000.0, "friction": 0.5},
    ICE: {"density": 1000.0, "friction": 0.0},
    BOUNCY: {"density": 1000.0, "friction": 0.0, "restitution": 1.0},
}


class Setting(NamedTuple):
    """A variant of a scene."""

    kind: str = "box"  # of bodies with flat sides: a box, or a brick of so many cells along its shortest side
    scale: float = 1.0
    step: float = 0.0025  # [s] at scale 1


class Trace(NamedTuple):
    """What a run was like; lengths and times at scale 1."""

    places: np.ndarray  # (steps, n, 3) [m] centres of mass
    linear: np.ndarray  # (steps, n, 3) [m/s]
    angular: np.ndarray  # (steps, n, 3) [rad/s]
    kinetic: np.ndarray  # (steps,) share of the first
    energy: np.ndarray  # (steps,) [J] kinetic and potential
    deepest: np.ndarray  # (steps,) [m] least gap of the contacts listed
    asleep: np.ndarray  # (n,) bool, at the end


class Elementary(NamedTuple):
    """A scene and what is right."""

    bodies: Callable[[Setting], list[dict[str, Any]]]  # at scale 1
    duration: float  # [s]
    faults: Callable[[Trace], Iterator[str]]
    gravity: float = 9.81


def flat(kind: str, *sides: float) -> dict[str, Any]:
    """The shape of a body with flat sides [m]."""
    if kind == "box":
        return {"box": {"size": list(sides)}}
    return {"brick": {"size_xyz": list(sides), "edge_length": min(sides) / int(kind.removeprefix("brick"))}}


def body(name: str, shape: dict[str, Any], at: Any = (0.0, 0.0, 0.0), material: str = STICKY, **more: Any) -> dict:
    return {"name": name, "material": material, "shape": shape, "position": [float(x) for x in at], **more}


def ground() -> dict[str, Any]:
    return body("ground", PLANE, static=True)


LENGTHS = "size", "size_xyz", "notch_xy", "edge_length", "radius", "diameter", "thickness", "rim_height", "position"


def scaled(content: Any, scale: float) -> Any:
    """Bodies with lengths times `scale` and velocities times its root."""
    if isinstance(content, list):
        return [scaled(item, scale) for item in content]
    if not isinstance(content, dict):
        return content
    root = math.sqrt(scale)
    factors = dict.fromkeys(LENGTHS, scale) | {"linear_velocity": root, "angular_velocity": 1.0 / root}
    return {
        key: (factors[key] * np.asarray(value, float)).tolist() if key in factors else scaled(value, scale)
        for key, value in content.items()
    }


def scene_of(name: str, elementary: Elementary, setting: Setting) -> Scene:
    """The scene in this setting."""
    root = math.sqrt(setting.scale)
    return parse_scene(
        {
            "gravity": [0.0, 0.0, -elementary.gravity], "time_step": setting.step * root,
            "duration": elementary.duration * root, "materials": MATERIALS,
            "solver": {"sleep_time": SolverSettings().sleep_time * root},
            "bodies": scaled(elementary.bodies(setting), setting.scale),
        }, name,
    )  # fmt: skip


def run(scene: Scene, scale: float = 1.0) -> Trace:
    """Run a scene to its end."""
    root = math.sqrt(scale)
    rows: list[tuple[Any, ...]] = []
    with Lockstep(scene, Settings(threads=1, lookahead=scene.time_step)) as running:
        for exchange in running:
            states, report = running.simulation._engine.states(), exchange.report
            rows.append((
                states.centers / scale, states.linear / root, states.angular * root, report.kinetic_energy,
                report.kinetic_energy + report.potential_energy, report.deepest_gap / scale,
            ))  # fmt: skip
        asleep = running.simulation._rest.asleep.copy()
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    columns[3] = columns[3] / max(columns[3][0], 1e-300)
    return Trace(*columns, asleep)


def ends_at(trace: Trace, where: Any, within: float, rows: slice = slice(None)) -> Iterator[str]:
    off = np.abs(trace.places[-1][rows] - np.asarray(where, float))
    off = off[~np.isnan(off)]
    if not off.max() <= within:
        yield f"ends {1e3 * off.max():.2f} mm off"


def rests(trace: Trace) -> Iterator[str]:
    if not trace.asleep.all():
        yield f"{(~trace.asleep).sum()} not asleep, at {1e3 * np.abs(trace.linear[-1]).max():.2f} mm/s"


def depth(trace: Trace, most: float) -> Iterator[str]:
    if trace.deepest.min() < -most:
        yield f"{-1e3 * trace.deepest.min():.2f} mm deep"


def drop(height: float, aside: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        cube = flat(setting.kind, 0.1, 0.1, 0.1)
        return [ground(), body("lower", cube, (0, 0, 0.05)), body("upper", cube, (aside, 0.6 * aside, 0.15 + height))]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, [[0, 0, 0.05], [aside, 0.6 * aside, 0.15]], 1e-3)
        yield from rests(trace)
        yield from depth(trace, 2e-3)

    return Elementary(bodies, 1.5, faults)


def stack(count: int, gap: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        cube = flat(setting.kind, 0.2, 0.2, 0.2)
        return [ground()] + [body(f"b{k}", cube, (0, 0, 0.1 + 0.2 * k + gap * (k + 1))) for k in range(count)]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, [[0, 0, 0.1 + 0.2 * k] for k in range(count)], 2e-3)
        yield from rests(trace)

    return Elementary(bodies, 2.0, faults)


PUCK = {"plate": {"diameter": 0.1, "thickness": 0.02, "edge_length": 0.02, "rim_height": 0.0}}
SLIDERS: dict[str, Callable[[str], tuple[dict[str, Any], float]]] = {
    "box": lambda kind: (flat(kind, 0.1, 0.1, 0.1), 0.0501),
    "plate": lambda kind: (flat(kind, 0.3, 0.2, 0.02), 0.0101),
    "puck": lambda kind: (PUCK, 0.0105),
    "sphere": lambda kind: ({"sphere": {"radius": 0.05}}, 0.0501),
}


def slide(what: str, speed: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        shape, height = SLIDERS[what](setting.kind)
        tiles = [
            body(f"t{k}", flat(setting.kind, 0.25, 1.0, 0.2), (-1.875 + 0.25 * k, 0, -0.1), static=True)
            for k in range(16)
        ]
        velocity = [speed, 0.1 * speed, 0.0]
        return [*tiles, body("slider", shape, (-1.5, 0.03, height), ICE, linear_velocity=velocity)]

    def faults(trace: Trace) -> Iterator[str]:
        first = trace.linear[0, 0]  # it has begun to fall onto the tiles
        left = trace.kinetic[-1] * (first @ first) / (first[:2] @ first[:2])
        if not 0.999 < left < 1.02:
            yield f"{100 * left:.1f} % of the energy left"
        lift = (trace.places[:, 0, 2] - trace.places[0, 0, 2]).max()
        if lift > 2e-5:
            yield f"lifted by {1e3 * lift:.3f} mm"

    return Elementary(bodies, 2.0 / speed, faults)


def overhang(share: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        table = flat(setting.kind, 1.0, 1.0, 0.2)
        at = (-0.1 + 0.2 * share, 0.03, 0.1 + 2e-5)
        block = flat(setting.kind, 0.2, 0.2, 0.2)
        return [body("table", table, (-0.5, 0, -0.1), static=True), body("block", block, at)]

    def faults(trace: Trace) -> Iterator[str]:
        fell = trace.places[-1, 0, 2] < 0.05
        if fell != (share > 0.5):
            yield "falls" if fell else "stays"
        if share < 0.5:
            yield from rests(trace)

    return Elementary(bodies, 1.5, faults)


def crossed() -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        return [
            body("lower", flat(setting.kind, 1.0, 0.1, 0.1), static=True),
            body("upper", flat(setting.kind, 0.1, 1.0, 0.1), (0, 0, 0.15)),
        ]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, [[0, 0, 0.1]], 1e-3)
        yield from rests(trace)

    return Elementary(bodies, 1.0, faults)


def in_wall(how_deep: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        return [
            body("wall", flat(setting.kind, 0.2, 4.0, 3.0), static=True),
            body("cube", flat(setting.kind, 1.0, 1.0, 1.0), (-0.6 + how_deep, 0, 0)),
        ]

    def faults(trace: Trace) -> Iterator[str]:
        x = trace.places[-1, 0, 0]
        right = -0.6 if how_deep < 0.6 else 0.6
        if abs(x - right) > 5e-3 and (x - right) * right < 0:
            yield f"ends at {x:.3f} m, not {right}"
        if np.abs(trace.linear).max() > 0.5:
            yield f"leaves at {np.abs(trace.linear).max():.2f} m/s"
        if np.abs(trace.angular).max() > 1e-3:
            yield f"turns at {np.abs(trace.angular).max():.4f} rad/s"

    return Elementary(bodies, 8.0, faults, gravity=0.0)


def one_place(shape: Callable[[str], dict[str, Any]], apart: float) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        each = shape(setting.kind)
        return [ground(), body("a", each, (0, 0, 0.5)), body("b", each, (0, 0, 0.5 + apart))]

    def faults(trace: Trace) -> Iterator[str]:
        yield from rests(trace)
        if trace.deepest[-1] < -2e-3:
            yield f"{-1e3 * trace.deepest[-1]:.1f} mm deep at the end"
        if np.abs(trace.linear).max() > 5.0:
            yield f"thrown at {np.abs(trace.linear).max():.1f} m/s"

    return Elementary(bodies, 5.0, faults)


def l_in_table() -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        shape = {"l_block": {"size_xyz": [0.1, 0.1, 0.04], "notch_xy": [0.06, 0.06], "edge_length": 0.02}}
        return [
            body("table", flat(setting.kind, 0.4, 0.4, 0.01), (0, 0, -0.005), static=True),
            body("l", shape, (0, 0, 0.05 - 0.004), rotation=[90.0, 0.0, 0.0]),
        ]

    def faults(trace: Trace) -> Iterator[str]:
        yield from rests(trace)
        if trace.deepest[-1] < -2e-4:
            yield f"{-1e3 * trace.deepest[-1]:.2f} mm deep at the end"

    return Elementary(bodies, 2.0, faults)


SCENES: dict[str, Elementary] = {
    **{f"drop {h} m, {1e3 * aside:g} mm aside": drop(h, aside) for h in (0.01, 0.5) for aside in (0.0, 0.001)},
    "stack of five": stack(5, 0.0),
    "stack of two, gaps": stack(2, 1e-4),
    **{f"slide a {what} at {v} m/s": slide(what, v) for what in SLIDERS for v in (1.0, 5.0)},
    **{f"overhang {s}": overhang(s) for s in (0.1, 0.3, 0.45, 0.55)},
    "crossed bars": crossed(),
    **{f"{d} m in a wall": in_wall(d) for d in (0.11, 0.7)},
    "boxes at one place": one_place(lambda kind: flat(kind, 1.0, 1.0, 1.0), 0.0),
    "l block 4 mm in a table": l_in_table(),
    "boxes half in each other": one_place(lambda kind: flat(kind, 1.0, 1.0, 1.0), 0.5),
}


@click.command(context_settings={"max_content_width": 120})
@click.option("--only", default="", help="Scenes whose names contain this.")
@click.option("--kinds", default="box,brick1,brick2", show_default=True)
@click.option("--scales", default="1", show_default=True)
@click.option("--steps", default="2.5", show_default=True, help="[ms] at scale 1.")
def main(only: str, kinds: str, scales: str, steps: str) -> None:
    """Runs the elementary scenes and says which end as they should."""
    total = wrong = 0
    for name, elementary in SCENES.items():
        if only not in name:
            continue
        for kind in kinds.split(","):
            for scale in map(float, scales.split(",")):
                for step in map(float, steps.split(",")):
                    setting = Setting(kind, scale, 1e-3 * step)
                    try:
                        trace = run(scene_of(name, elementary, setting), scale)
                        said = ", ".join(elementary.faults(trace))
                    except ArithmeticError as error:
                        said = repr(error)
                    total, wrong = total + 1, wrong + bool(said)
                    click.echo(f"{name:32} {kind:7} {scale:<6g} {step:<4g} {said or 'right'}")
    click.echo(f"{wrong} of {total} wrong")


if __name__ == "__main__":
    main()

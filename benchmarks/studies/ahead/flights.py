"""Within a step: do two separated bodies touch, and does the service report it? Compared with another library.

A body is thrown at another, spinning, from so near that about half of the flights end in contact within the step.
`lookahead` is the step. *Missed*: they touch, deeper than epsilon before the step ends, and nothing is listed; *ghost*:
something is listed, and they come no nearer than one and a half detection tolerances.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from benchmarks.studies.ahead.against import (
    MOST_SPIN,
    SPEED_OF_TARGET,
    SPIN_OF_TARGET,
    STEPS,
    Size,
    tables_of,
    trials_of,
)
from benchmarks.studies.pictures import BLUE, RED, finish, new_figure
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, markdown_table, number
from fracture_collision.geometry.generators import TetGeometry, ball, brick, l_block
from fracture_collision.geometry.stored_meshes import bunny
from fracture_collision.geometry.tetrahedra import boundary_triangles
from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentStates, SolidPrimitive
from fracture_collision.world import CollisionWorld, Settings

sys.path.append(str(Path(__file__).resolve().parents[3] / "test"))  # the ground truth lives with the tests

# [m]
THROWN: dict[str, Callable[[], TetGeometry]] = {
    "shard": lambda: brick((0.06, 0.06, 0.004), 0.02),
    "rod": lambda: brick((0.1, 0.008, 0.008), 0.02),
    "pane": lambda: brick((0.12, 0.12, 0.006), 0.03),
    "bunny": lambda: bunny(0.1),
}
THROWN_ID, TARGET_ID, HEAP_PIECES = 5000, 1, 6
TARGETS = ("plate", "rod", "plane", "box", "sphere", "triangles", "heap")
BOX_SIZE, SPHERE_RADIUS = (0.1, 0.08, 0.06), 0.05  # [m]
PLANE_SIZE = 4.0  # [m] of what represents a plane in the other library
FROM = 0.6  # [m] at this distance they are surely apart
LATEST = 1.8  # [steps] of straight motion before contact: a good half of the flights touch
NEAR, EPSILON = Settings().detection_tolerance, Settings().penetration_tolerance  # of the smaller R
GRAZES = 1.5  # detection tolerances: the distance that counts as near
MOMENTS = 200  # sampled to find the depth of two bodies that touch and are not listed
MOST_DRAWS = 50
TOGETHER = 6  # flights per trial


class Target(NamedTuple):
    """Bodies that stand or move as one."""

    bodies: list[CollisionBody]
    events: list[Any]
    parts: list[tuple[int, np.ndarray, np.ndarray]]  # fragment id, vertices (n, 3) [m], triangles (t, 3)
    center: np.ndarray  # (3,) [m] of mass
    low: np.ndarray  # of the box that throws aim at
    high: np.ndarray
    radius: float  # [m] R in the service


class Flight(NamedTuple):
    touches: bool
    is_near: bool  # they come within GRAZES tolerances
    depth: float  # [R] maximum before the step ends, if they touch and nothing is listed; else 0
    is_listed: bool


def trials(size: Size) -> list[Trial]:
    return trials_of(fly, TOGETHER, size)


def fly(thrown: str, target: str, speed: float, first: int, end: int) -> list[Flight]:
    """Flights first .. end - 1, which differ in their random numbers."""
    made, aim = THROWN[thrown](), _target(target)
    world = _world(made, aim)
    key = [list(THROWN).index(thrown), TARGETS.index(target), int(speed)]
    return [_one(made, aim, world, target, speed, np.random.default_rng([*key, k])) for k in range(first, end)]


def _one(
    made: TetGeometry, aim: Target, world: CollisionWorld, target: str, speed: float, random: Any
) -> Flight:
    from benchmarks.studies.ahead import flight_truth as truth

    step = float(random.choice(STEPS))
    surface, origin = boundary_triangles(made.tetrahedra), np.zeros(3)
    center = _center(made)
    still = Rotation.identity()
    parts = [truth.Mover(v, t, aim.center, origin, still, origin, origin) for _, v, t in aim.parts]
    smaller = min(aim.radius, 0.5 * float(np.ptp(made.vertices, axis=0).max()))
    for _ in range(MOST_DRAWS):
        way = random.normal(size=3)
        way /= np.linalg.norm(way)
        if target == "plane":
            way[2] = -abs(way[2])
        at = random.uniform(aim.low, aim.high)
        turn = Rotation.random(random_state=int(random.integers(1 << 30)))
        mover = truth.Mover(made.vertices, surface, center, at - FROM * way - turn.apply(center), turn, way, origin)
        reaches = min(truth.Flight(mover, part).first_touch(2.0 * FROM) for part in parts)
        if np.isfinite(reaches):
            break
    else:
        raise RuntimeError(f"none of {MOST_DRAWS} throws meets the {target}")
    back = max(random.uniform(0.05, LATEST) * speed * step, 4.0 * NEAR * smaller)
    spin = random.normal(size=3)
    spin *= random.uniform(0.0, MOST_SPIN) / np.linalg.norm(spin)
    place = mover.position + (reaches - back) * way
    mover = mover._replace(
        position=place, velocity=speed * way - np.cross(spin, turn.apply(center)), spin=spin,
    )  # fmt: skip
    moving = origin, origin
    if target not in ("plane", "heap") and random.random() < 0.5:
        moving = tuple(random.uniform(-most, most, 3) for most in (SPEED_OF_TARGET, SPIN_OF_TARGET))
    parts = [part._replace(velocity=moving[0], spin=moving[1]) for part in parts]
    flights = [truth.Flight(mover, part) for part in parts]
    first = min(flight.first_touch(step) for flight in flights)
    is_near = np.isfinite(first) or any(
        np.isfinite(flight.first_touch(step, GRAZES * NEAR * smaller)) for flight in flights
    )
    is_listed = _is_listed(world, aim, mover, moving, step, target)
    depth = 0.0
    if np.isfinite(first) and not is_listed:
        depth = _deepest(mover, parts, first, step) / smaller
    return Flight(bool(np.isfinite(first)), bool(is_near), depth, is_listed)


def _is_listed(world: CollisionWorld, aim: Target, mover, moving, step: float, target: str) -> bool:
    world.change_settings(world.settings._replace(lookahead=step))
    ids, linear, angular = [THROWN_ID], [mover.velocity], [mover.spin]
    if target != "plane":
        ids += [fragment for fragment, _, _ in aim.parts]
        linear += [moving[0]] * len(aim.parts)
        angular += [moving[1]] * len(aim.parts)
    n = len(ids)
    positions, turns = np.zeros((n, 3)), np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
    positions[0], turns[0] = mover.position, mover.turn.as_quat()
    answer = world.contacts(
        FragmentStates(
            1, len(aim.events), np.array(ids), positions.ravel(), turns.ravel(), np.ravel(linear), np.ravel(angular)
        )
    )
    rows = [k for k in range(len(answer.fragment_a)) if THROWN_ID in (answer.fragment_a[k], answer.fragment_b[k])]
    return any(answer.pair_begin[k + 1] > answer.pair_begin[k] for k in rows)


def _deepest(mover, parts, first: float, step: float) -> float:
    """[m] Maximum depth of a point of either surface in the other, from the first contact to the end of the step."""
    from truth.surface_truth import Solid

    deepest = 0.0
    for part in parts:
        for t in np.linspace(first, step, MOMENTS):
            one, other = mover.at(t)[mover.triangles], part.at(t)[part.triangles]
            if np.any(one.min((0, 1)) > other.max((0, 1))) or np.any(other.min((0, 1)) > one.max((0, 1))):
                continue
            finest = 0.05 * max(float(np.ptp(one.reshape(-1, 3), axis=0).max()), 1e-3)
            deepest = max(deepest, Solid(other).deepest_of(one, deepest, finest).depth)
            deepest = max(deepest, Solid(one).deepest_of(other, deepest, finest).depth)
    return deepest


def _center(made: TetGeometry) -> np.ndarray:
    """Of mass [m]."""
    corners = made.vertices[made.tetrahedra]
    sides = corners[:, 1:] - corners[:, :1]
    volumes = np.abs(np.linalg.det(sides))
    return (corners.mean(axis=1) * volumes[:, None]).sum(axis=0) / volumes.sum()


def _world(made: TetGeometry, aim: Target) -> CollisionWorld:
    world = CollisionWorld(Settings(threads=1))
    world.add_body(_tetrahedral(THROWN_ID, made))
    for body in aim.bodies:
        world.add_body(body)
    for event in aim.events:
        world.add_fracture(event)
    return world


def _tetrahedral(body_id: int, made: TetGeometry) -> CollisionBody:
    vertices, tetrahedra = made.vertices.ravel(), made.tetrahedra.ravel()
    return CollisionBody(body_id, body_id, vertices=vertices, tetrahedra=tetrahedra, density=2400.0)


def _target(name: str) -> Target:
    """One body with the id TARGET_ID, broken or whole."""
    from worlds.rigid_shapes import boundary_of

    if name in ("plate", "rod"):
        made = brick((0.25, 0.25, 0.006), 0.05) if name == "plate" else brick((0.2, 0.01, 0.01), 0.03)
        return _of_one(_tetrahedral(TARGET_ID, made), made.vertices, boundary_triangles(made.tetrahedra), np.zeros(3))
    if name == "plane":
        slab = brick((PLANE_SIZE, PLANE_SIZE, 1.0), PLANE_SIZE)
        body = CollisionBody(TARGET_ID, TARGET_ID, plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True)
        vertices = slab.vertices - [0.0, 0.0, 0.5]
        target = _of_one(body, vertices, boundary_triangles(slab.tetrahedra), np.zeros(3))
        return target._replace(low=np.full(3, -0.05), high=np.full(3, 0.05), radius=np.inf)
    if name == "box":
        body = CollisionBody(TARGET_ID, TARGET_ID, primitive=SolidPrimitive(BOX, BOX_SIZE), density=1000.0)
        made = brick(BOX_SIZE, max(BOX_SIZE))
        return _of_one(body, made.vertices, boundary_triangles(made.tetrahedra), np.zeros(3))
    if name == "sphere":
        body = CollisionBody(TARGET_ID, TARGET_ID, primitive=SolidPrimitive(SPHERE, (SPHERE_RADIUS,)), density=1000.0)
        made = ball(SPHERE_RADIUS, 0.15 * SPHERE_RADIUS)
        return _of_one(body, made.vertices, boundary_triangles(made.tetrahedra), np.zeros(3))
    if name == "triangles":
        made = l_block((0.1, 0.08, 0.03), (0.06, 0.045), 0.0125)
        shape = boundary_of(made)
        flat = shape.vertices.ravel(), shape.triangles.ravel()
        body = CollisionBody(TARGET_ID, TARGET_ID, vertices=flat[0], triangles=flat[1], density=1000.0)
        return _of_one(body, shape.vertices, shape.triangles, _center(made))
    return _heap()


def _of_one(body: CollisionBody, vertices: np.ndarray, triangles: np.ndarray, center: np.ndarray) -> Target:
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    return Target([body], [], [(TARGET_ID, vertices, triangles)], center, low, high, 0.5 * float((high - low).max()))


def _heap() -> Target:
    """A block that has just broken into pieces."""
    from worlds.fractured_worlds import fractured_world

    case = fractured_world(brick(BOX_SIZE, 0.02), HEAP_PIECES)
    parts = []
    for fragment in case.oracle.fragment_ids:
        corners = case.oracle.surface_triangles(fragment)
        parts.append((fragment, corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)))
    half = 0.5 * np.array(BOX_SIZE)
    return Target(*case.messages, parts, np.zeros(3), -half, half, float(half.max()))


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    return tables_of(fly, TOGETHER, size, results, _row)


def _row(flights: list[Flight]) -> Row:
    unlisted = [flight for flight in flights if flight.touches and not flight.is_listed]
    return {
        "flights": len(flights), "touch": sum(flight.touches for flight in flights),
        "missed": sum(flight.depth > EPSILON for flight in unlisted),
        "ghosts": sum(flight.is_listed and not flight.is_near for flight in flights),
        "deepest_percent": 100.0 * max((flight.depth for flight in unlisted), default=0.0),
    }  # fmt: skip


def draw(tables: Mapping[str, Table]) -> Figure:
    table = tables["speeds"]
    figure, ((axes,),) = new_figure(1, 1, width=6.0, height=3.2)
    for what, colour in (("missed", RED), ("ghosts", BLUE)):
        among = table.column("touch" if what == "missed" else "flights")
        share = 100.0 * table.column(what) / np.maximum(among, 1)
        axes.plot(table.column("speed"), share, "-o", color=colour, markersize=4, linewidth=1.3, label=what)
    axes.set_xscale("log")
    axes.set_ylim(bottom=0.0)
    finish(axes, "missed: of those that touch; ghosts: of all", "speed [m/s]", "flights [%]")
    return figure


def section(tables: Mapping[str, Table]) -> str:
    body = [
        (
            f"{row['thrown']} at {row['target']}", *(str(row[name]) for name in ("flights", "touch", "missed")),
            number(row["deepest_percent"]), str(row["ghosts"]),
        )
        for row in tables[""].rows
    ]  # fmt: skip
    total = {name: int(tables["speeds"].column(name).sum()) for name in ("flights", "touch", "missed", "ghosts")}
    speeds = ", ".join(f"{speed:g}" for speed in tables["speeds"].values("speed"))
    steps = ", ".join(f"{1e3 * step:g}" for step in STEPS)
    return f"""\
{total["flights"]} flights of one step of {steps} ms at {speeds} m/s, spinning at up to {MOST_SPIN:g} rad/s. Half of the
targets move. Flights start so near that, by ipctk's continuous collision detection, {total["touch"]} of them touch
within the step.

- *Missed:* the bodies touch and get deeper than 0.2 % of the smaller R before the step ends, but no contact is listed:
  {total["missed"]}.
- *Ghost:* a contact is listed, but the bodies come no nearer than 1.5 detection tolerances: {total["ghosts"]}.

Unlisted: the depth of the deepest touch that is not listed.

{markdown_table(("", "flights", "touch", "missed", "unlisted, % R", "ghosts"), body)}"""


STUDY = Study(
    "flights", "Lookahead: contacts within a step", Size(2, tuple(THROWN), TARGETS),
    Size(2 * TOGETHER, tuple(THROWN), TARGETS), trials, tables, {"": draw}, section,
)  # fmt: skip

"""The scenes that everybody tries first, and what they must end like.

Lengths in a scene are of order 0.1 to 1 m at scale 1. At another scale lengths change, and times with their root, so
that under the same gravity everything happens alike. A turned scene is the same off the axes.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.elementary.shapes import TRIANGLES, box_spins, flat, needle, tetrahedron, tube, voussoir
from fracture_collision.simulation.scene.scene import Scene, SceneBody, parse_scene
from fracture_collision.simulation.solver.contact_solver import SolverSettings

KINDS = ("box", "brick1", "brick2", "brick8", TRIANGLES)
GRAVITY = 9.81  # [m/s2]
PLANE = {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}
STICKY, ROUGH, ICE, BOUNCY = "sticky", "rough", "ice", "bouncy"
FRICTION = 0.5  # of STICKY
MATERIALS = {
    STICKY: {"density": 1000.0, "friction": FRICTION},
    ROUGH: {"density": 1000.0, "friction": 0.8},
    ICE: {"density": 1000.0, "friction": 0.0},
    BOUNCY: {"density": 1000.0, "friction": 0.0, "restitution": 1.0},
}


class Setting(NamedTuple):
    """A variant of a scene."""

    # Of bodies with flat sides: a box, a brick of so many cells along its shortest side, or triangles, two a side.
    kind: str = "box"
    scale: float = 1.0
    step: float = 0.0025  # [s] at scale 1
    turn: float = 0.0  # [degrees] of the whole scene about the vertical axis


class Trace(NamedTuple):
    """What a run was like after each step; lengths and times at scale 1, in the frame of the scene not turned."""

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
    gravity: float = GRAVITY
    has_kinds: bool = True  # whether the setting's kind changes anything
    least_duration: float = 0.0  # [s] at any scale: bodies in each other part at speeds in R/s


def body(name: str, shape: dict[str, Any], at: Any = (0.0, 0.0, 0.0), material: str = STICKY, **more: Any) -> dict:
    return {"name": name, "material": material, "shape": shape, "position": [float(x) for x in at], **more}


def ground() -> dict[str, Any]:
    return body("ground", PLANE, static=True)


LENGTHS = (
    "size", "size_xyz", "notch_xy", "edge_length", "radius", "diameter", "thickness", "rim_height", "depth",
    "major_radius", "minor_radius", "vertices", "position",
)  # fmt: skip


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


def about_vertical(turn: float) -> np.ndarray:
    """The matrix of a rotation by `turn` [degrees]."""
    c, s = math.cos(math.radians(turn)), math.sin(math.radians(turn))
    return np.array([(c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)])


def turned(bodies: list[dict[str, Any]], turn: float) -> list[dict[str, Any]]:
    """Bodies turned by `turn` [degrees] about the vertical axis; planes are horizontal and stay."""
    if not turn:
        return bodies

    def one(each: dict[str, Any]) -> dict[str, Any]:
        vectors = {key: each[key] for key in ("position", "linear_velocity", "angular_velocity") if key in each}
        x, y, z = each.get("rotation", (0.0, 0.0, 0.0))  # about x, y and then z
        moved = {key: (about_vertical(turn) @ vector).tolist() for key, vector in vectors.items()}
        return each | moved | {"rotation": [x, y, z + turn]}

    return [each if "plane" in each["shape"] else one(each) for each in bodies]


def turned_back(trace: Trace, turn: float) -> Trace:
    """The trace of a scene turned by `turn` [degrees], in the frame of the scene not turned."""
    if not turn:
        return trace
    back = about_vertical(turn)  # on rows from the right: its transpose
    return trace._replace(places=trace.places @ back, linear=trace.linear @ back, angular=trace.angular @ back)


def scene_of(name: str, elementary: Elementary, setting: Setting) -> Scene:
    """The scene in this setting."""
    root = math.sqrt(setting.scale)
    bodies = turned(scaled(elementary.bodies(setting), setting.scale), setting.turn)
    with tempfile.TemporaryDirectory() as folder:
        for k, each in enumerate(bodies):
            if "mesh" in each["shape"]:
                np.savez(Path(folder, f"{k}.npz"), **each["shape"]["mesh"])
                each["shape"] = {"stored_mesh": {"file": f"{k}.npz"}}
        scene = parse_scene(
            {
                "gravity": [0.0, 0.0, -elementary.gravity], "time_step": setting.step * root,
                "duration": max(elementary.duration * root, elementary.least_duration), "materials": MATERIALS,
                "solver": {"sleep_time": SolverSettings().sleep_time * root},
                "bodies": bodies,
            }, name, folder=Path(folder),
        )  # fmt: skip
    return scene if setting.kind != TRIANGLES else scene._replace(bodies=tuple(map(of_triangles, scene.bodies)))


def of_triangles(body: SceneBody) -> SceneBody:
    """The body marked by its shape's kind, if it has a mesh, as one of which the service gets the surface alone."""
    return body if body.shape.mesh is None else body._replace(shape=body.shape._replace(kind=TRIANGLES))


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


def stays(trace: Trace, within: float) -> Iterator[str]:
    off = np.abs(trace.places - trace.places[0]).max()
    if not off <= within:
        yield f"moves by {1e3 * off:.2f} mm"


def gains(trace: Trace, most: float = 2e-3) -> Iterator[str]:
    """Energy must never rise by more than `most` of the first, that above the ground included."""
    rise = (trace.energy - np.minimum.accumulate(trace.energy)).max() / abs(trace.energy[0])
    if not rise <= most:
        yield f"gains {100 * rise:.2f} % of the energy"


def is_near(what: str, found: float, right: float, share: float) -> Iterator[str]:
    if not abs(found - right) <= share * abs(right):
        yield f"{what} {found:.4g}, not {right:.4g}"


def times(trace: Trace, duration: float) -> np.ndarray:
    """[s] of each row."""
    return duration * np.arange(1, len(trace.places) + 1) / len(trace.places)


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
        # it lands first, which may take a step
        yield from is_near("goes [m]", trace.places[-1, 0, 0] + 1.5, 2.0, 0.01 + 1.0 / len(trace.places))

    return Elementary(bodies, 2.0 / speed, faults)


def roll(speed: float) -> Elementary:
    """A sphere that rolls over seams; friction has nothing to do."""
    radius = 0.05

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        tiles = [
            body(f"t{k}", flat(setting.kind, 0.25, 1.0, 0.2), (-1.875 + 0.25 * k, 0, -0.1), static=True)
            for k in range(16)
        ]
        ball = {"sphere": {"radius": radius}}
        velocity, spin = [speed, 0.1 * speed, 0.0], [-0.1 * speed / radius, speed / radius, 0.0]
        at = (-1.5, 0.03, radius + 5e-5)  # where it rests
        return [*tiles, body("ball", ball, at, linear_velocity=velocity, angular_velocity=spin)]

    def faults(trace: Trace) -> Iterator[str]:
        left = trace.linear[-1, 0] @ (1.0, 0.1, 0.0) / (1.01 * speed)
        if not 0.999 < left < 1.001:
            yield f"{100 * left:.2f} % of the speed left"
        left = trace.angular[-1, 0] @ (-0.1, 1.0, 0.0) * radius / (1.01 * speed)
        if not 0.999 < left < 1.001:
            yield f"{100 * left:.2f} % of the spin left"
        yield from is_near("goes [m]", trace.places[-1, 0, 0] + 1.5, 2.0, 0.01)

    return Elementary(bodies, 2.0 / speed, faults)


def overhang(share: float, yaw: float = 0.0) -> Elementary:
    def bodies(setting: Setting) -> list[dict[str, Any]]:
        table = flat(setting.kind, 1.0, 1.0, 0.2)
        at = (-0.1 + 0.2 * share, 0.03, 0.1 + 2e-5)
        block = flat(setting.kind, 0.2, 0.2, 0.2)
        return [
            body("table", table, (-0.5, 0, -0.1), static=True),
            body("block", block, at, rotation=[0.0, 0.0, yaw]),
        ]

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

    return Elementary(bodies, 8.0, faults, gravity=0.0, least_duration=1.2)


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

    return Elementary(bodies, 5.0, faults, least_duration=1.2)


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


def pyramid(rows: int) -> Elementary:
    side, pitch = 0.1, 0.105
    places = [
        ((k - 0.5 * (rows - 1 - row)) * pitch, 0.0, (row + 0.5) * side)
        for row in range(rows) for k in range(rows - row)
    ]  # fmt: skip

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        cube = flat(setting.kind, side, side, side)
        return [ground()] + [body(f"b{k}", cube, at) for k, at in enumerate(places)]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, places, 1e-3)
        yield from rests(trace)
        yield from gains(trace)

    return Elementary(bodies, 1.0, faults)


def cards() -> Elementary:
    """Two cards that lean on each other, 20 degrees from upright: they stand if friction exceeds tan(20) / 2 = 0.18."""
    length, thickness, lean = 0.2, 0.02, 20.0
    c, s = math.cos(math.radians(lean)), math.sin(math.radians(lean))
    # Of the one at -x: its lower edge is on the ground, its upper one touches that of the other.
    aside, height = 0.5 * (length * s + thickness * c), 0.5 * (length * c + thickness * s)

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        card = flat(setting.kind, thickness, 0.1, length)
        return [ground()] + [
            body(f"c{k}", card, (-side * aside, 0, height), rotation=[0.0, side * lean, 0.0])
            for k, side in enumerate((1, -1))
        ]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, [(-aside, 0, height), (aside, 0, height)], 1e-3)
        yield from rests(trace)

    return Elementary(bodies, 1.0, faults)


def ladder(material: str) -> Elementary:
    """A board against a wall, 20 degrees from upright: slips if friction at both ends is less than tan(10) = 0.18."""
    length, thickness, lean = 0.4, 0.04, 20.0
    c, s = math.cos(math.radians(lean)), math.sin(math.radians(lean))
    at = -0.5 * (length * s + thickness * c), 0.0, 0.5 * (length * c + thickness * s)

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        board = flat(setting.kind, thickness, 0.2, length)
        wall = body("wall", flat(setting.kind, 0.1, 1.0, 1.0), (0.05, 0, 0.5), static=True)
        return [ground(), wall, body("board", board, at, material, rotation=[0.0, lean, 0.0])]

    def faults(trace: Trace) -> Iterator[str]:
        if material == ICE:
            if trace.places[-1, 0, 2] > 0.5 * at[2]:
                yield f"slips to a height of {1e3 * trace.places[-1, 0, 2]:.1f} mm alone"
        else:
            yield from ends_at(trace, [at], 1e-3)
            yield from rests(trace)
        yield from gains(trace)
        yield from depth(trace, 2e-3)

    return Elementary(bodies, 1.0, faults)


def arch(count: int) -> Elementary:
    """Half a ring of stones. A third as thick as its mean radius, it stands: 0.107 is enough (Heyman 1969)."""

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        stone = voussoir(setting.kind, 0.4, 0.56, 0.2, math.pi / count)
        return [ground()] + [
            body(f"v{k}", stone, (0, 0, 0), ROUGH, rotation=[0.0, 180.0 / count * (k - 0.5 * (count - 1)), 0.0])
            for k in range(count)
        ]

    def faults(trace: Trace) -> Iterator[str]:
        yield from stays(trace, 2e-3)
        yield from rests(trace)

    return Elementary(bodies, 1.0, faults)


def bridge() -> Elementary:
    places = [(-0.4, 0, 0.1), (0.4, 0, 0.1), (0, 0, 0.225), (0.1, 0, 0.35)]

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        sides = [(0.2, 0.2, 0.2), (0.2, 0.2, 0.2), (1.0, 0.2, 0.05), (0.2, 0.2, 0.2)]
        return [ground()] + [
            body(f"b{k}", flat(setting.kind, *each), at) for k, (each, at) in enumerate(zip(sides, places, strict=True))
        ]

    def faults(trace: Trace) -> Iterator[str]:
        yield from ends_at(trace, places, 1e-3)
        yield from rests(trace)
        yield from gains(trace)

    return Elementary(bodies, 1.0, faults)


def slope(tangent: float, material: str = STICKY) -> Elementary:
    """A block on an inclined plane: stays within the friction cone, else slides at g (sin - mu cos)."""
    angle, duration = math.atan(tangent), 0.6
    along, up = np.array([math.cos(angle), 0.0, -math.sin(angle)]), np.array([math.sin(angle), 0.0, math.cos(angle)])
    friction = FRICTION if material == STICKY else 0.0
    weight = GRAVITY * math.sin(angle)
    acceleration = max(0.0, weight - friction * GRAVITY * math.cos(angle))

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        rotation = [0.0, math.degrees(angle), 0.0]
        cube, hill = flat(setting.kind, 0.1, 0.1, 0.1), flat(setting.kind, 2.4, 0.4, 0.1)
        return [
            body("hill", hill, rotation=rotation, static=True),
            body("block", cube, -0.9 * along + (0.1 + 2e-5) * up, material, rotation=rotation),
        ]

    def faults(trace: Trace) -> Iterator[str]:
        speed = trace.linear[-1, 0] @ along
        # At the edge of the cone rounding decides: it may creep.
        most = 0.01 * duration * (acceleration or weight)
        if not abs(speed - acceleration * duration) <= most:
            yield f"slides at {speed:.4f} m/s, not {acceleration * duration:.4f}"
        aside = np.abs((trace.places[:, 0] - trace.places[0, 0]) @ np.column_stack((up, (0.0, 1.0, 0.0)))).max()
        if aside > 1e-3:
            yield f"leaves the slope by {1e3 * aside:.2f} mm"
        if tangent < friction:
            yield from stays(trace, 1e-3)
            yield from rests(trace)

    return Elementary(bodies, duration, faults)


def coin(material: str) -> Elementary:
    """A coin on edge that spins about its upright diameter, 5 degrees from upright, not fast enough to stay there."""
    radius, thickness, lean = 0.05, 0.01, math.radians(5.0)
    shape = {"plate": {"diameter": 0.1, "thickness": thickness, "edge_length": 0.0125, "rim_height": 0.0}}

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        at = (0, 0, radius * math.cos(lean) + 0.5 * thickness * math.sin(lean) + 1e-4)
        more = {"rotation": [90.0 - math.degrees(lean), 0.0, 0.0], "angular_velocity": [0.0, 0.0, 25.0]}
        return [ground(), body("coin", shape, at, material, **more)]

    def faults(trace: Trace) -> Iterator[str]:
        yield from gains(trace)
        yield from depth(trace, 1e-3)
        height = trace.places[:, 0, 2]
        if not (height.min() > 0.5 * thickness - 5e-4 and height.max() < math.hypot(radius, 0.5 * thickness) + 1e-3):
            yield f"its centre is {1e3 * height.min():.2f} to {1e3 * height.max():.2f} mm above the ground"

    return Elementary(bodies, 2.0, faults, has_kinds=False)


def in_bowl() -> Elementary:
    """A sphere slides in a bowl without friction, a pendulum; the bowl's facets take some energy out of it."""
    outer, inner, radius, start = 0.325, 0.295, 0.05, 0.6  # the bowl's spheres; [rad] from the lowest point
    centre, length = np.array([0.0, 0.0, outer - 0.2]), inner - radius
    duration = 1.5

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        bowl = {"bowl": {"diameter": 0.6, "thickness": outer - inner, "edge_length": 0.03, "depth": 0.2}}
        at = centre + (length - 5e-4) * np.array([math.sin(start), 0.0, -math.cos(start)])
        return [body("bowl", bowl, static=True), body("ball", {"sphere": {"radius": radius}}, at, ICE)]

    def faults(trace: Trace) -> Iterator[str]:
        quarter = 0.5 * math.pi * math.sqrt(length / GRAVITY) * (1.0 + start**2 / 16.0)
        x = trace.places[:, 0, 0]
        k = int(np.argmax(x <= 0.0))  # between rows: a step may be a 25th of the quarter
        first = times(trace, duration)[k] * (1.0 + x[k] / ((k + 1) * (x[k - 1] - x[k]))) if k else math.inf
        yield from is_near("at the bottom after [s]", float(first), quarter, 0.05)
        away = np.sqrt(np.square(trace.places[:, 0] - centre).sum(axis=1))
        if not length - 3e-3 < away.min() <= away.max() < length + 5e-4:
            yield f"{1e3 * away.min():.2f} to {1e3 * away.max():.2f} mm from the bowl's centre, not {1e3 * length:g}"
        swing = np.sqrt(2.0 * GRAVITY * length * (1.0 - math.cos(start)))
        fastest = np.sqrt(np.square(trace.linear).sum(axis=2)).max()
        if not 0.9 * swing < fastest < 1.005 * swing:
            yield f"{fastest:.3f} m/s at most, not {swing:.3f}"

    return Elementary(bodies, duration, faults, has_kinds=False)


def pin_in_hole(is_through: bool) -> Elementary:
    """A pin falls, 2 mm of clearance on each side, into a hole with or without a bottom."""
    length, half, gap, block = 0.2, 0.02, 0.002, 0.2
    raised = 0.3 if is_through else 0.0

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        hole = tube(setting.kind, half + gap, 0.08, block, 4)
        pin = flat(setting.kind, 2.0 * half, 2.0 * half, length)
        return [
            ground(), body("block", hole, (0, 0, raised + 0.5 * block), static=True),
            body("pin", pin, (0.001, 0, raised + block + 0.5 * length - 0.02), rotation=[0.0, 0.5, 0.0]),
        ]  # fmt: skip

    def faults(trace: Trace) -> Iterator[str]:
        yield from gains(trace)
        yield from depth(trace, 2e-3)
        if is_through:
            if trace.places[-1, 0, 2] > 0.5 * length + 1e-3:
                yield f"ends {1e3 * trace.places[-1, 0, 2]:.1f} mm above the ground"
        else:
            # It stands at the bottom, or leans in a corner by the clearance.
            yield from ends_at(trace, [[0, 0, 0.5 * length]], gap + 5e-4)
            yield from rests(trace)

    return Elementary(bodies, 1.0, faults)


def chain(links: int) -> Elementary:
    """Rings that hang in each other, every other one turned; the first is fixed."""
    major, minor, fall = 0.1, 0.02, 0.005
    apart = 2.0 * (major - minor)

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        ring = {"torus": {"major_radius": major, "minor_radius": minor, "edge_length": 0.015}}
        return [
            body(f"r{k}", ring, (0, 0, -k * (apart - fall)), static=k == 0, rotation=[90.0, 0.0, 90.0 * (k % 2)])
            for k in range(links)
        ]

    def faults(trace: Trace) -> Iterator[str]:
        rings = np.concatenate((np.zeros((len(trace.places), 1, 3)), trace.places), axis=1)
        way = np.sqrt(np.square(np.diff(rings, axis=1)).sum(axis=2))
        if not way.max() < apart + 2e-3:
            yield f"rings {1e3 * way.max():.1f} mm apart, not {1e3 * apart:.1f}"
        yield from ends_at(trace, [[0, 0, -k * apart] for k in range(1, links)], 3e-3)
        yield from gains(trace)

    return Elementary(bodies, 0.6, faults, has_kinds=False)


def dominoes(count: int) -> Elementary:
    thickness, height, pitch, duration = 0.02, 0.2, 0.1, 1.3
    spin = 2.5  # [rad/s] of the first about its lower edge; 0.85 would just topple it

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        shape = flat(setting.kind, thickness, 0.1, height)
        made = [body(f"d{k}", shape, (pitch * k, 0, 0.5 * height)) for k in range(count)]
        velocity = [0.5 * spin * height, 0.0, 0.5 * spin * thickness]
        made[0] |= {"angular_velocity": [0.0, spin, 0.0], "linear_velocity": velocity}
        return [ground(), *made]

    def faults(trace: Trace) -> Iterator[str]:
        standing = trace.places[:, :, 2] > 0.25 * height
        if standing[-1].any():
            yield f"{standing[-1].sum()} stand"
        else:
            fallen = times(trace, duration)[standing.any(axis=1).sum()]
            yield from is_near("fallen after [s]", float(fallen), 1.0, 0.1)  # as it converges with smaller steps
        yield from gains(trace)
        yield from depth(trace, 2e-3)

    return Elementary(bodies, duration, faults)


def cradle(count: int, gap: float) -> Elementary:
    """A ball hits a row of others: only the last one leaves, at its speed."""
    radius, speed = 0.05, 1.0

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        ball = {"sphere": {"radius": radius}}
        row = [body(f"b{k}", ball, ((2.0 * radius + gap) * k, 0, radius + 5e-5), BOUNCY) for k in range(1, count)]
        first = body("b0", ball, (-0.05, 0, radius + 5e-5), BOUNCY, linear_velocity=[speed, 0.0, 0.0])
        return [ground(), first, *row]

    def faults(trace: Trace) -> Iterator[str]:
        right = np.zeros((count, 3))
        right[-1, 0] = speed
        off = np.abs(trace.linear[-1] - right).max()
        if not off <= 0.01 * speed:
            yield f"leave at {', '.join(f'{v:.2f}' for v in trace.linear[-1, :, 0])} m/s"

    return Elementary(bodies, 0.3, faults, has_kinds=False)


def sharp(shape: dict[str, Any], at_rest: float, *rotation: float) -> Elementary:
    """A sharp hull falls onto a table, tip first, and ends on one of its faces, its centre `at_rest` [m] above."""

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        table = flat(setting.kind, 1.0, 1.0, 0.2)
        return [body("table", table, (0, 0, -0.1), static=True), body("hull", shape, (0, 0, 0.3), rotation=[*rotation])]

    def faults(trace: Trace) -> Iterator[str]:
        height = trace.places[-1, 0, 2]
        if not abs(height - at_rest) <= 5e-4:
            yield f"ends {1e3 * height:.2f} mm above the table, not {1e3 * at_rest:.2f}"
        yield from rests(trace)
        yield from gains(trace)
        yield from depth(trace, 1e-3)

    return Elementary(bodies, 1.5, faults)


def free_spin() -> Elementary:
    """A box spins about its middle axis, tumbles, and keeps its angular momentum."""
    sides, spin = (0.1, 0.2, 0.3), np.array([0.1, 10.0, 0.1])
    inertia = box_spins(*sides)
    momentum, twice = inertia * spin, float(inertia @ spin**2)
    # Spins about x and z when it has half tumbled over, from angular momentum and energy.
    halfway = np.linalg.solve([inertia[::2], inertia[::2] ** 2], [twice, float(momentum @ momentum)])

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        return [body("box", flat(setting.kind, *sides), angular_velocity=spin.tolist())]

    def faults(trace: Trace) -> Iterator[str]:
        # Along the angular momentum the spin is 2 E / L, whatever the pose.
        along = trace.angular[:, 0] @ momentum / twice
        if not np.abs(along - 1.0).max() <= 1e-3:
            yield f"the angular momentum turns: {100 * (along.min() - 1.0):.2f} to {100 * (along.max() - 1.0):.2f} %"
        fastest = np.square(trace.angular[:, 0]).sum(axis=1).max()
        yield from is_near("fastest spin [rad/s]", math.sqrt(fastest), math.sqrt(halfway.sum()), 0.005)
        if not np.abs(trace.kinetic - 1.0).max() <= 1e-3:
            yield f"{100 * trace.kinetic.min():.2f} to {100 * trace.kinetic.max():.2f} % of the energy"

    return Elementary(bodies, 2.0, faults, gravity=0.0)


def bounce(shape: Callable[[str], dict[str, Any]]) -> Elementary:
    """Without loss a body returns to its height, again and again."""
    height = 0.5

    def bodies(setting: Setting) -> list[dict[str, Any]]:
        return [ground(), body("ball", shape(setting.kind), (0, 0, height + 0.05), BOUNCY)]

    def faults(trace: Trace) -> Iterator[str]:
        z = trace.places[:, 0, 2] - 0.05
        peaks = z[1:-1][(z[1:-1] >= z[:-2]) & (z[1:-1] > z[2:])]
        if len(peaks) != 3:  # 2 sqrt(2 h / g) = 0.64 s apart
            yield f"bounces {len(peaks)} times, not 3"
        for k, peak in enumerate(peaks):
            yield from is_near(f"height [m] of bounce {k + 1}", float(peak), height, 0.005)

    return Elementary(bodies, 2.1, faults)


SCENES: dict[str, Elementary] = {
    **{f"drop {h} m, {1e3 * aside:g} mm aside": drop(h, aside) for h in (0.01, 0.5) for aside in (0.0, 0.001)},
    "stack of five": stack(5, 0.0),
    "stack of two, gaps": stack(2, 1e-4),
    **{f"slide a {what} at {v} m/s": slide(what, v) for what in SLIDERS for v in (1.0, 5.0)},
    **{f"roll at {v} m/s": roll(v) for v in (1.0, 5.0)},
    **{f"overhang {s}": overhang(s) for s in (0.1, 0.3, 0.45, 0.55)},
    **{f"overhang {s}, turned": overhang(s, 30.0) for s in (0.45, 0.55)},
    "crossed bars": crossed(),
    **{f"{d} m in a wall": in_wall(d) for d in (0.11, 0.7)},
    "boxes at one place": one_place(lambda kind: flat(kind, 1.0, 1.0, 1.0), 0.0),
    "l block 4 mm in a table": l_in_table(),
    "boxes half in each other": one_place(lambda kind: flat(kind, 1.0, 1.0, 1.0), 0.5),
    "pyramid": pyramid(4),
    "card house": cards(),
    "ladder": ladder(STICKY),
    "ladder on ice": ladder(ICE),
    "arch": arch(9),
    "bridge": bridge(),
    **{f"slope {t}": slope(t) for t in (0.45, FRICTION, 0.52, 0.7)},
    "slope of ice 0.3": slope(0.3, ICE),
    "coin": coin(STICKY),
    "coin on ice": coin(ICE),
    "ball in a bowl": in_bowl(),
    "pin in a hole": pin_in_hole(False),
    "pin through a hole": pin_in_hole(True),
    "chain": chain(3),
    "dominoes": dominoes(10),
    "cradle": cradle(5, 0.0),
    "cradle with gaps": cradle(5, 0.005),
    "tetrahedron on its tip": sharp(tetrahedron(0.1), 0.1 / math.sqrt(24.0), 177.0, 2.0, 0.0),
    "needle on its tip": sharp(needle(0.1, 0.01), 1.0 / math.sqrt(1e2 + 2e4), 10.0, 80.0, 20.0),
    "free spin": free_spin(),
    "sphere bounces": bounce(lambda kind: {"sphere": {"radius": 0.05}})._replace(has_kinds=False),
    "box bounces": bounce(lambda kind: flat(kind, 0.1, 0.1, 0.1)),
}

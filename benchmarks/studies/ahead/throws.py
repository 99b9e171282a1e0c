"""Whether a fast body passes through another within steps, in a simulation with a lookahead of one step.

A body is thrown at another and simulated with `lookahead` at the time step. Judged is the motion within steps (a body
that will touch moves until it does), at moments between which nothing moves farther than LEAP of its thickness.
*Through*: more than half way through the thinner of the two at some moment. *Deep*: deeper than DEEP. The same throw is
simulated without contacts: a body that passes at more than epsilon there, and does not move so here, has met a *ghost*.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from benchmarks.studies.ahead.throw_witness import DEEP, TARGET_ID, THROWN_ID, Step, Witness
from benchmarks.studies.pictures import BLUE, ORANGE, RED, finish, new_figure
from benchmarks.studies.study import Study, Trial
from benchmarks.studies.table import Row, Table, markdown_table, number
from fracture_collision.records import FragmentStates
from fracture_collision.simulation.engine import BodyStates
from fracture_collision.simulation.own_dynamics import OwnDynamics
from fracture_collision.simulation.scene.scene import Scene, parse_scene
from fracture_collision.simulation.simulation import Simulation
from fracture_collision.world import CollisionWorld, Settings

# [m]
SHAPES: dict[str, dict[str, Any]] = {
    "shard": {"brick": {"size_xyz": (0.06, 0.06, 0.004), "edge_length": 0.02}},
    "rod": {"brick": {"size_xyz": (0.1, 0.008, 0.008), "edge_length": 0.02}},
    "pane": {"brick": {"size_xyz": (0.12, 0.12, 0.006), "edge_length": 0.03}},
    "bunny": {"bunny": {"longest_side": 0.1}},
    "plate": {"brick": {"size_xyz": (0.25, 0.25, 0.006), "edge_length": 0.05}},
    "plane": {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}},
    "box": {"box": {"size": [0.1, 0.08, 0.06]}},
    "sphere": {"sphere": {"radius": 0.05}},
    "heap": {"brick": {"size_xyz": (0.1, 0.08, 0.06), "edge_length": 0.02}},
}
THROWN = ("shard", "rod", "pane", "bunny")
TARGETS = ("plate", "fixed plate", "rod", "bunny", "plane", "box", "sphere", "heap")
# [m] thickness at the thinnest part; of a bunny, its ears; of a heap, that of its pieces
THINNEST = {
    "shard": 0.004, "rod": 0.008, "pane": 0.006, "bunny": 0.01, "plate": 0.006, "plane": np.inf, "box": 0.06,
    "sphere": 0.1, "heap": 0.02,
}  # fmt: skip
ATTITUDES = ("flat on", "edge on", "turning", "turning")  # of the thrown body; half of the throws spin
BESIDE = 0.6  # of the thrown body's reach: aim points lie up to this far beyond the target's box
STEPS_AFTER = 12
OVERLOAD = 2.0  # of the impact that breaks a heap
LEAP, FINER = 0.25, 25.0  # a small step as a share of the smallest thickness; for ghosts smaller by this factor
HALF_WAY = 0.9  # of half of the smaller thickness: no sample is exactly in the middle
SAME = 1e-9  # [m, m/s, rad/s] rounding
TINY = 1e-12  # a body that moves for a smaller share of a step does not move
TOGETHER = 8  # throws per trial


class Throw(NamedTuple):
    touches: bool  # they come within epsilon of each other when simulated without contacts
    deviates: bool  # the thrown body moves differently from that
    is_ghost: bool
    is_through: bool
    deepest: float  # [m] at any moment
    energy_gain: float  # in any step, as a share of the initial energy


class _Dynamics(OwnDynamics):
    """Records how bodies move within each step."""

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene.time_step, scene.gravity, scene.solver, looks_ahead=True)
        self.moves: tuple[BodyStates, np.ndarray, np.ndarray] | None = None

    def advance(self, linear, angular, drift_linear, drift_angular) -> None:
        self.moves = self.states(), linear + drift_linear, angular + drift_angular
        super().advance(linear, angular, drift_linear, drift_angular)


def trials(size: Size) -> list[Trial]:
    return trials_of(throw, TOGETHER, size)


def throw(thrown: str, target: str, speed: float, first: int, end: int) -> list[Throw]:
    """Throws first .. end - 1, which differ in their random numbers."""
    key = [THROWN.index(thrown), TARGETS.index(target), int(speed)]
    return [_one(thrown, target, speed, np.random.default_rng([*key, k])) for k in range(first, end)]


def _one(thrown: str, target: str, speed: float, random: np.random.Generator) -> Throw:
    scene = _scene(thrown, target, speed, random)
    witness, thinner = Witness(scene), min(THINNEST[thrown], THINNEST[target.removeprefix("fixed ")])
    leap = LEAP * thinner
    free = list(_run(scene, target, witness.world, False))
    touches = any(True for _ in witness.gaps(free, leap))
    settings = Settings(threads=1, lookahead=scene.time_step)
    steps = list(_run(scene, target, CollisionWorld(settings), True))
    deepest = max(0.0, -min(witness.gaps(steps, leap), default=0.0))
    deviates = any(_differ(*pair) for pair in zip(free, steps, strict=True))
    is_ghost = deviates and not touches and not any(True for _ in witness.gaps(free, leap / FINER))
    energies = np.array([step.energy for step in steps])
    gain = float(np.diff(energies).max(initial=0.0)) / energies[0]
    return Throw(touches, deviates, is_ghost, deepest > HALF_WAY * 0.5 * thinner, deepest, gain)


def _differ(one: Step, other: Step) -> bool:
    """Whether the thrown body is elsewhere or moves differently."""
    own, its = _motion_of_thrown(one.before), _motion_of_thrown(other.before)
    return bool(np.abs(own - its).max() > SAME)


def _motion_of_thrown(bodies: BodyStates) -> np.ndarray:
    columns = bodies.frame_positions, bodies.frame_orientations, bodies.linear, bodies.angular
    return np.hstack(columns)[bodies.fragment_ids == THROWN_ID]


def _scene(thrown: str, target: str, speed: float, random: np.random.Generator) -> Scene:
    """The thrown body flies towards the origin, where the target is."""
    time_step, attitude = float(random.choice(STEPS)), ATTITUDES[random.integers(len(ATTITUDES))]
    way = random.normal(size=3)
    way /= np.linalg.norm(way)
    if target in ("plane", "plate", "fixed plate"):
        way[2] = -max(abs(way[2]), 0.2)
        way /= np.linalg.norm(way)
    turn, spin = Rotation.random(random_state=int(random.integers(1 << 30))), np.zeros(3)
    if attitude == "turning":
        spin = random.normal(size=3)
        spin *= random.uniform(0.0, MOST_SPIN) / np.linalg.norm(spin)
    else:
        flat = Rotation.align_vectors([way], [[0.0, 0.0, 1.0] if attitude == "flat on" else [1.0, 0.0, 0.0]])[0]
        turn = Rotation.from_rotvec(random.uniform(0.0, 2.0 * np.pi) * way) * flat
    reach, half = _reach(thrown), _half(target)
    aim = random.uniform(-1.0, 1.0, 3) * (half + BESIDE * reach)
    away = reach + float(np.linalg.norm(aim)) + float(np.linalg.norm(half)) + 0.01
    if target == "plane":
        away /= abs(way[2])
    before = away + random.uniform(1.0, 2.0) * speed * time_step  # the spin of the first step is not published yet
    steps = int(np.ceil(2.0 * before / speed / time_step)) + STEPS_AFTER
    porcelain = {"density": 2400.0, "friction": 0.5, "restitution": 0.1}
    brittle = porcelain | {"fracture": {"strength": 1e9, "minimum_mass": 0.02}}
    body = {"name": "target", "material": "porcelain", "shape": SHAPES[target.removeprefix("fixed ")]}
    if target in ("plane", "fixed plate"):
        body["static"] = True
    elif target == "heap":
        body["material"] = "brittle"
    elif random.random() < 0.5:
        body["linear_velocity"] = random.uniform(-SPEED_OF_TARGET, SPEED_OF_TARGET, 3).tolist()
        body["angular_velocity"] = random.uniform(-SPIN_OF_TARGET, SPIN_OF_TARGET, 3).tolist()
    flying = {
        "name": "thrown", "material": "porcelain", "shape": SHAPES[thrown],
        "position": (aim - before * way).tolist(), "rotation": turn.as_euler("xyz", degrees=True).tolist(),
        "linear_velocity": (speed * way).tolist(), "angular_velocity": spin.tolist(),
    }  # fmt: skip
    content = {
        "gravity": [0.0, 0.0, 0.0], "time_step": time_step, "duration": steps * time_step,
        "materials": {"porcelain": porcelain, "brittle": brittle}, "bodies": [body, flying],
    }  # fmt: skip
    return parse_scene(content, "throws")


def _reach(thrown: str) -> float:
    """[m] from its centre, approximately."""
    size = next(iter(SHAPES[thrown].values()))
    return 0.5 * float(np.linalg.norm(size.get("size_xyz", (0.1, 0.1, 0.1))))


def _half(target: str) -> np.ndarray:
    """[m] (3,) of the box that throws aim at."""
    ((kind, size),) = SHAPES[target.removeprefix("fixed ")].items()
    if kind == "plane":
        return np.array([0.05, 0.05, 0.0])
    return 0.5 * np.array(size.get("size_xyz") or size.get("size") or 3 * (2.0 * size.get("radius", 0.05),))


_NO_CONTACTS = CollisionWorld(Settings(threads=1)).contacts(
    FragmentStates(0, 0, np.zeros(0, np.uint32), np.zeros(0), np.zeros(0))
)  # fmt: skip


def _run(scene: Scene, target: str, world: CollisionWorld, is_told: bool) -> Iterator[Step]:
    """The scene's steps, `is_told`: the simulation gets the world's contacts. A heap breaks after the first step."""
    engine = _Dynamics(scene)
    simulation = Simulation(scene, None, engine, looks_ahead=True)
    for body in simulation.start_bodies():
        world.add_body(body)
    while not simulation.finished:
        request = simulation.begin_step()
        for event in request.events:
            world.add_fracture(event)
        states = request.states
        if is_told:
            answer = world.contacts(states)
        else:
            world.present(states)
            answer = _NO_CONTACTS._replace(
                step=states.step, fracture_sequence=states.fracture_sequence, lookahead=scene.time_step
            )
        report = simulation.finish_step(answer, world.fragments())
        if target == "heap" and states.step == 0:
            simulation.strike(TARGET_ID, np.zeros(3), OVERLOAD)
        shares = engine.shares
        linear, angular = (moves / np.maximum(shares, TINY)[:, None] for moves in engine.moves[1:])
        yield Step(states, scene.time_step, engine.moves[0], linear, angular, shares, report.kinetic_energy)
    simulation.close()


def tables(size: Size, results: Mapping[Trial, Any]) -> dict[str, list[Row]]:
    return tables_of(throw, TOGETHER, size, results, _row)


def _row(throws: list[Throw]) -> Row:
    return {
        "throws": len(throws), "touch": sum(it.touches for it in throws),
        "through": sum(it.is_through for it in throws), "deep": sum(it.deepest > DEEP for it in throws),
        "deepest_mm": 1e3 * max(it.deepest for it in throws), "ghosts": sum(it.is_ghost for it in throws),
        "energy_gain": max(it.energy_gain for it in throws),
    }  # fmt: skip


def draw(tables: Mapping[str, Table]) -> Figure:
    table = tables["speeds"]
    figure, ((axes,),) = new_figure(1, 1, width=6.0, height=3.2)
    for what, colour in (("deep", ORANGE), ("through", RED), ("ghosts", BLUE)):
        among = table.column("throws" if what == "ghosts" else "touch")
        share = 100.0 * table.column(what) / np.maximum(among, 1)
        axes.plot(table.column("speed"), share, "-o", color=colour, markersize=4, linewidth=1.3, label=what)
    axes.set_xscale("log")
    axes.set_ylim(bottom=0.0)
    finish(axes, "of the throws that touch; ghosts: of all", "speed [m/s]", "throws [%]")
    return figure


def section(tables: Mapping[str, Table]) -> str:
    body = [
        (
            f"{row['thrown']} at {row['target']}", *(str(row[name]) for name in ("throws", "touch", "through", "deep")),
            number(row["deepest_mm"]), str(row["ghosts"]),
        )
        for row in tables[""].rows
    ]  # fmt: skip
    total = {n: int(tables["speeds"].column(n).sum()) for n in ("throws", "touch", "through", "deep", "ghosts")}
    speeds = ", ".join(f"{speed:g}" for speed in tables["speeds"].values("speed"))
    steps = ", ".join(f"{1e3 * step:g}" for step in STEPS)
    gain = float(tables["speeds"].column("energy_gain").max())
    return f"""\
{total["throws"]} throws at {speeds} m/s, in steps of {steps} ms: a quarter flat on, a quarter edge on, the others
spinning at up to {MOST_SPIN:g} rad/s. They are simulated with `lookahead` set to the time step.
The motion within each step is checked at times between which nothing moves farther than a quarter of the thinner body's
thickness. A body that will touch moves until it does, then waits for the end of the step. Deep penetrations are
measured with libigl. {total["touch"]} throws touch.

- *Through:* more than half way through the thinner body at any time: {total["through"]}.
- *Deep:* deeper than 0.5 mm at any time: {total["deep"]}.
- *Ghosts:* held back or deflected by a body that they would have passed at more than 0.2 % R: {total["ghosts"]}.

The largest rise of the energy in a step, as a fraction of the initial energy, is {gain:.1g}.

{markdown_table(("", "throws", "touch", "through", "deep", "deepest, mm", "ghosts"), body)}"""


STUDY = Study(
    "throws", "Lookahead: tunnelling between steps", Size(4, THROWN, TARGETS), Size(53, THROWN, TARGETS), trials,
    tables, {"": draw}, section,
)  # fmt: skip

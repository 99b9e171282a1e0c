"""The cases of the kit: scenes with a closed form, and what their runs are judged by.

Lengths in m, h = 2.5 ms, friction 0.5 unless a case changes it. Bodies do not sleep, or standing still would prove
nothing. R is half the longest side of the smaller body of a pair.

A judge yields figures; `cause` is the likely cause of a failure.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.share import share_directory
from fracture_collision.solver_check.recorded import Recorded, Track
from fracture_collision.solver_check.solver_runs import Change, Strike, shuffled, thinned, with_bare_pairs

STEP = 0.0025  # [s]
FRICTION = 0.5
G = 9.81  # [m/s2]
EARTH = (0.0, 0.0, -G)  # [m/s2]
WEIGHTLESS = (0.0, 0.0, 0.0)
# The service lists contacts up to this gap, its detection_tolerance, and calls deeper ones penetrations. Share of R.
TOLERANCE = 0.002


class Figure(NamedTuple):
    """One number of a case."""

    what: str  # with its unit
    measured: float
    exact: float | None  # None: there is none, the figure is for information
    bound: float | None  # of |measured - exact|; None: not judged
    cause: str = ""

    @property
    def passes(self) -> bool:
        """False also if it is not a number."""
        return self.bound is None or bool(abs(self.measured - (self.exact or 0.0)) <= self.bound)


    @property
    def share(self) -> float:
        """Of its bound that it uses up; above 1 or not a number: it fails. 0 if it is not judged."""
        if self.bound is None:
            return 0.0
        off = abs(self.measured - (self.exact or 0.0))
        return off / self.bound if self.bound > 0.0 else math.inf if off else 0.0 * off


Figures = Iterator[Figure]


class Part(NamedTuple):
    """One run of a case."""

    content: dict[str, Any]  # of a scene file
    change: Change | None = None  # of the service's answers; needs a solver in this process
    strike: Strike | None = None  # likewise


class Case(NamedTuple):
    """Some runs, and what is right."""

    name: str
    title: str
    parts: Mapping[str, Part]  # by name
    judge: Callable[[Mapping[str, Recorded]], Figures]  # of the runs, by the names of the parts
    not_by_node: str = ""  # why it cannot be judged over topics; "": it can
    is_core: bool = False  # what any simulator must pass, without restitution, breaking and long stacks


def body(name: str, shape: dict[str, Any], at: tuple[float, float, float], **more: Any) -> dict[str, Any]:
    """A body of a scene, of `plain` material."""
    return {"name": name, "material": "plain", "shape": shape, "position": [float(x) for x in at], **more}


def box(*size: float) -> dict[str, Any]:
    """A shape."""
    return {"box": {"size": list(size)}}


def ball(radius: float) -> dict[str, Any]:
    """A shape."""
    return {"sphere": {"radius": radius}}


def floor() -> dict[str, Any]:
    """A half-space below z = 0."""
    return body("floor", {"plane": {"coefficients": [0.0, 0.0, 1.0, 0.0]}}, (0, 0, 0), static=True)


def scene(
    bodies: list[dict[str, Any]], duration: float, gravity: tuple[float, ...] = EARTH,
    materials: Mapping[str, dict[str, Any]] | None = None,
) -> dict[str, Any]:  # fmt: skip
    """A scene's content. materials: changes of `plain`, by the names of further materials."""
    materials = materials or {}
    plain = {"density": 1000.0, "friction": FRICTION, "restitution": 0.0}
    return {
        "time_step": STEP, "duration": duration, "gravity": [float(x) for x in gravity], "solver": {"sleep_time": 0.0},
        "materials": {"plain": plain, **{name: plain | change for name, change in materials.items()}},
        "bodies": bodies,
    }  # fmt: skip


def largest(values: np.ndarray) -> float:
    """Of absolute values; not a number if one of them is not."""
    return float(np.abs(values).max(initial=0.0))


def norms(vectors: np.ndarray) -> np.ndarray:
    """Lengths (n,) of vectors (n, 3)."""
    return np.sqrt((vectors * vectors).sum(axis=-1))


def norm(vector: np.ndarray) -> float:
    """Length of a vector (3,)."""
    return math.sqrt(float(vector @ vector))


def total(vectors: Iterable[np.ndarray]) -> np.ndarray:
    """Sum (3,) of vectors (3,)."""
    found = np.zeros(3)
    for vector in vectors:
        found = found + vector
    return found


# Flight


def _flight() -> Case:
    start = np.array([3.0, 1.0, 4.0])
    thrown = body("thrown", box(0.2, 0.1, 0.05), (0, 0, 0), linear_velocity=[3.0, 1.0, 4.0])
    tumbling = body("tumbling", box(0.3, 0.2, 0.05), (0, 0, 0), angular_velocity=[20.0, 8.0, 21.0])

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        track = runs["throw"].track("thrown")
        times = STEP * np.arange(len(track.centers))[:, None]
        changes = np.diff(track.velocities(), axis=0) / STEP
        yield Figure(
            "acceleration off gravity [m/s2]", largest(changes - [0.0, 0.0, -G]), 0.0, 1e-6,
            "gravity acts on velocities once a step, as a whole, or damping is on",
        )  # fmt: skip
        course = start * times + 0.5 * times**2 * np.array([0.0, 0.0, -G])
        yield Figure(
            "off the parabola [mm]", 1e3 * largest(track.centers - course), 0.0,
            1e3 * (0.5 * G * STEP * float(times[-1, 0]) * 1.001),
            "more than g h t / 2, the error of semi-implicit Euler: the time step or gravity is another",
        )  # fmt: skip
        yield from _tumbles(runs["tumble"].track("tumbling"))

    return Case(
        "flight", "A body falls along a parabola; another tumbles at 30 rad/s",
        {"throw": Part(scene([thrown], 0.5)), "tumble": Part(scene([tumbling], 2.0, WEIGHTLESS))}, judge, is_core=True,
    )  # fmt: skip


def _tumbles(track: Track) -> Figures:
    spins, momenta = track.smooth_spins(), track.smooth_spin_momenta()
    energies = 0.5 * (spins * momenta).sum(axis=1)
    # Spins derived from poses oscillate by (w h)^2 / 12 about those of the solver: means show gain and loss.
    quarter = len(energies) // 4
    gained = float(energies[-quarter:].mean() / energies[:quarter].mean() - 1.0)
    yield Figure(
        "change of the energy of spin, last quarter to first", gained, 0.0, 1e-4,
        "the gyroscopic torque is missing or explicit: use the implicit midpoint rule",
    )  # fmt: skip
    yield Figure(
        "change of angular momentum", largest(norms(momenta - momenta[0]) / norm(momenta[0])), 0.0, 0.02,
        "the inertia is not turned with the body, or angular velocity is taken in body axes",
    )  # fmt: skip


def _frames() -> Case:
    shape = {"l_block": {"size_xyz": [0.2, 0.2, 0.06], "notch_xy": [0.12, 0.1], "edge_length": 0.1}}
    thrown = body(
        "thrown", shape, (0, 0, 0), rotation=[20.0, 30.0, 40.0], linear_velocity=[1.0, 0.0, 2.0],
        angular_velocity=[2.0, 1.0, 3.0],
    )  # fmt: skip

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        track = runs["throw"].track("thrown")
        velocities = track.velocities()
        yield Figure(
            "change of the centre of mass's velocity [m/s]", largest(velocities - velocities[0]), 0.0, 1e-9,
            "the body turns about its frame's origin instead of its centre of mass: position = c - R center_of_mass",
        )  # fmt: skip
        arm = track.centers[0] - track.origins[0]
        first = np.array([1.0, 0.0, 2.0]) + np.cross([2.0, 1.0, 3.0], arm)
        yield Figure(
            "velocity off that of the thrown frame [m/s]", largest(velocities[0] - first), 0.0, 1e-3,
            "linear_velocity is that of the body frame's origin: that of the centre of mass is v + w x (c - origin)",
        )  # fmt: skip
        yield from _tumbles(track)
        if len(track.published):
            moved = np.diff(track.origins, axis=0) / STEP
            spin = norms(track.spins()).max()
            yield Figure(
                "published velocity off the origin's [m/s]", largest(norms(moved - track.published[:-1])), 0.0,
                float(spin * spin * norm(arm) * STEP),
                "the published linear velocity is not that of the body frame's origin: v + w x (origin - c)",
            )  # fmt: skip

    return Case(
        "frames", "A body whose frame is not at its centre of mass, with products of inertia, flies straight",
        {"throw": Part(scene([thrown], 0.5, WEIGHTLESS))}, judge, is_core=True,
    )  # fmt: skip


# Impulses


def _signs() -> Case:
    def pair(y: float, ball_first: bool) -> list[dict[str, Any]]:
        number, throw = int(ball_first), [2.0, 0.3, 0.0]
        both = [
            body(f"ball {number}", ball(0.05), (-0.2, y + 0.02, 0.01), material="bouncy", linear_velocity=throw),
            body(f"cube {number}", box(0.1, 0.1, 0.1), (0, y, 0), material="bouncy"),
        ]
        return both if ball_first else both[::-1]

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["collide"]
        for number in (0, 1):
            tracks = [run.track(f"{what} {number}") for what in ("cube", "ball")]
            low, high = sorted(tracks, key=lambda track: track.fragment_id)
            pushes = high.mass * np.diff(high.velocities(), axis=0)
            k = int(np.argmax(norms(pushes)))
            push = pushes[k]
            answers = [run.pair(j, low.fragment_id, high.fragment_id)[1] for j in (k + 1, k)]
            normals = next((each for each in answers if len(each)), answers[0])
            along = float((normals @ push).min() / norm(push)) if len(normals) and norm(push) else math.nan
            yield Figure(
                f"impulse on b along n, over its size, a is the {'ball' if number else 'cube'}", along, 1.0, 0.5,
                "the sign of normals: n points from a to b, an impulse on b is along n, that on a along -n",
            )  # fmt: skip
            before = [track.momenta(slice(0, 8)) for track in tracks]
            after = [track.momenta(slice(-60, None)) for track in tracks]
            for k, what in enumerate(("linear", "angular")):
                scale = norm(before[1][0]) * (0.1 if k else 1.0)
                change = total(each[k] for each in after) - total(each[k] for each in before)
                yield Figure(
                    f"change of {what} momentum, relative", largest(change) / scale, 0.0, 1e-10,
                    "the impulses on the two bodies are not equal and opposite" if k == 0 else
                    "the two impulses do not act at one point: take the middle of both witness points",
                )  # fmt: skip

    bodies = [*pair(0.0, False), *pair(1.0, True)]
    return Case(
        "signs", "A ball hits a cube off its centre, in free space: impulses are equal and opposite, along n",
        {"collide": Part(scene(bodies, 0.5, WEIGHTLESS, {"bouncy": {"restitution": 0.5}}))}, judge,
        is_core=True,
    )  # fmt: skip


# Angles [degrees] of the slope and of its direction about z.
SLOPES = {
    "24": (24.0, 0.0), "24 diagonal": (24.0, 45.0), "at the cone": (math.degrees(math.atan(FRICTION)), 0.0),
    "40": (40.0, 0.0), "40 diagonal": (40.0, 45.0), "40 oblique": (40.0, 22.5),
}  # fmt: skip


def _slope() -> Case:
    def content(angle: float, direction: float) -> dict[str, Any]:
        slope, turn = math.radians(angle), math.radians(direction)
        along = G * math.sin(slope)
        gravity = (along * math.cos(turn), along * math.sin(turn), -G * math.cos(slope))
        return scene([floor(), body("block", box(0.2, 0.2, 0.1), (0, 0, 0.0501))], 1.0, gravity)

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for name, (angle, direction) in SLOPES.items():
            run, slope, turn = runs[name], math.radians(angle), math.radians(direction)
            block = run.track("block")
            downhill = np.array([math.cos(turn), math.sin(turn), 0.0])
            along = block.velocities() @ downhill
            after = 80  # steps, in which it settles
            exact = G * max(math.sin(slope) - FRICTION * math.cos(slope), 0.0)
            if angle < 26.0:
                creep = float(norms(block.velocities()[after:, :2]).max())
                yield Figure(
                    f"{name} deg: creep [mm/s]", 1e3 * creep, 0.0, 0.01,
                    "friction is missing, not converged, too soft, or a pyramid that is weaker along its diagonal",
                )  # fmt: skip
            else:
                found = float(along[-1] - along[after]) / (STEP * (len(along) - 1 - after))
                yield Figure(
                    f"{name} deg: acceleration [m/s2]", found, exact, 1e-3 * G,
                    "Coulomb's cone is not met: friction is missing, or differs with the direction (a pyramid)",
                )  # fmt: skip
            sideways = block.centers[:, :2] @ [-math.sin(turn), math.cos(turn)]
            yield Figure(
                f"{name} deg: sideways [mm]", 1e3 * largest(sideways), 0.0, 0.05,
                "friction does not oppose the direction of sliding: it is solved along each tangent alone",
            )  # fmt: skip
            heights = block.centers[after:, 2]
            yield Figure(
                f"{name} deg: height, largest less smallest [mm]", 1e3 * float(np.ptp(heights)), 0.0, 0.05,
                "a sliding contact lifts off: the friction model is convex (no complementarity), or contacts are soft",
            )  # fmt: skip
            floor_id = run.id_of("floor")
            missing = sum(
                not len(gaps) or gaps.min() > 2.0 * TOLERANCE * 0.1
                for gaps in (run.pair(k, floor_id, block.fragment_id)[0] for k in range(after, len(run.contacts)))
            )
            yield Figure(
                f"{name} deg: steps without contact", float(missing), 0.0, 0.0,
                "a sliding contact lifts off: the friction model is convex (no complementarity)",
            )  # fmt: skip

    parts = {name: Part(content(*angles)) for name, angles in SLOPES.items()}
    return Case(
        "slope", "A block on a slope below, at and above the friction cone, along and across the tangents",
        parts, judge, is_core=True,
    )  # fmt: skip


def _restitution() -> Case:
    bounces = {"dead": 0.0, "wood": 0.3, "rubber": 0.8}
    bodies = [floor()]
    for k, material in enumerate(bounces):
        for j, (what, shape) in enumerate((("ball", ball(0.05)), ("box", box(0.1, 0.1, 0.1)))):
            at, fall = (0.5 * k, 0.5 * j, 0.2), [0.0, 0.0, -3.0]
            bodies.append(body(f"{what} of {material}", shape, at, material=material, linear_velocity=fall))
    dropped = [floor(), body("ball", ball(0.05), (0, 0, 0.55), material="rubber")]
    materials = {name: {"restitution": e} for name, e in bounces.items()}

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for material, e in bounces.items():
            for what in ("ball", "box"):
                track = runs["hit"].track(f"{what} of {material}")
                up = track.velocities()[:, 2]
                yield Figure(
                    f"{what}, e = {e}: speed after over speed before", float(up[-1] / 3.0), e, 0.01,
                    "restitution is left out, or the speed before the blow is that after a contact ahead has slowed"
                    " the body down (speculative contacts)",
                )  # fmt: skip
                energies = (track.velocities() ** 2).sum(axis=1)
                yield Figure(
                    f"{what}, e = {e}: energy over that at first", float(energies.max() / energies[0]), 1.0, 1e-9,
                    "energy rises: restitution is added to a velocity that was already reversed",
                )  # fmt: skip
        heights = runs["bounce"].track("ball").centers[:, 2] - 0.05
        inside = heights[1:-1]
        peaks = inside[(inside >= heights[:-2]) & (inside > heights[2:])]
        before = 0.5
        for k in range(2):
            peak = float(peaks[k]) if k < len(peaks) else math.nan
            yield Figure(
                f"e from the height of bounce {k + 1}", math.sqrt(peak / before), 0.8, 0.01,
                "gravity in the step of the blow is counted as speed of approach, or the touch is late",
            )  # fmt: skip
            before = peak

    return Case(
        "restitution", "Balls and flat boxes bounce with e = 0, 0.3 and 0.8",
        {
            "hit": Part(scene(bodies, 0.25, WEIGHTLESS, materials)),
            "bounce": Part(scene(dropped, 1.4, materials=materials)),
        },
        judge,
    )  # fmt: skip


# Rest


def tower(count: int) -> list[dict[str, Any]]:
    """Cubes of 0.2 m, one on the other, 0.1 mm apart."""
    return [body(f"cube {k}", box(0.2, 0.2, 0.2), (0, 0, 0.1 + 0.2 * k + 1e-4 * (k + 1))) for k in range(count)]


def _rests(label: str, run: Recorded, names: list[str]) -> Figures:
    """What holds for bodies of R = 0.1 m that stand one on the other."""
    tracks = [run.track(name) for name in names]
    last = 100  # steps
    speed = max(float(norms(track.velocities()[-last:]).max()) for track in tracks)
    yield Figure(
        f"{label}: speed at the end [mm/s]", 1e3 * speed, 0.0, 0.01,
        "impulses are not converged: carry them from step to step by contact_ids, or use more iterations; a soft"
        " contact still sinks",
    )  # fmt: skip
    sideways = max(largest(track.centers[:, :2] - track.centers[0, :2]) for track in tracks)
    yield Figure(
        f"{label}: sideways [mm]", 1e3 * sideways, 0.0, 0.01,
        "friction is missing or not converged, or a contact of a pair is ignored, so that bodies tilt",
    )  # fmt: skip
    tilt = max(largest(track.turns - track.turns[0]) for track in tracks)
    yield Figure(
        f"{label}: tilt [1e-3 rad]", 1e3 * tilt, 0.0, 0.05,
        "a corner sinks: one contact of each pair is ignored; row i has the contacts pair_begin[i] .."
        " pair_begin[i + 1] - 1",
    )  # fmt: skip
    deepest = -min(float(contacts.gaps.min(initial=0.0)) for contacts in run.contacts[-last:])
    yield Figure(
        f"{label}: depth at the end [mm]", 1e3 * deepest, 0.0, 1e3 * TOLERANCE * 0.1,
        "contacts are soft, or penetrations are not corrected",
    )  # fmt: skip


HEAVY = {"light": {"density": 100.0}, "heavy": {"density": 10000.0}}


def _rest() -> Case:
    two = tower(2)
    two[0]["material"], two[1]["material"] = HEAVY

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for name, count in (("box", 1), ("stack", 10), ("heavy on light", 2)):
            yield from _rests(name, runs[name], [f"cube {k}" for k in range(count)])
        marble = runs["ball"].track("ball")
        yield Figure(
            "ball: height at the end [mm]", 1e3 * float(marble.centers[-1, 2]), 50.0, 1e3 * TOLERANCE * 0.05,
            "it falls through: the only contact of its pair is ignored; row i has the contacts pair_begin[i] .."
            " pair_begin[i + 1] - 1",
        )  # fmt: skip

    return Case(
        "rest", "A box, a stack of ten, 100 kg on 1 kg, and a ball on one contact stand still",
        {
            "box": Part(scene([floor(), *tower(1)], 2.5)),
            "stack": Part(scene([floor(), *tower(10)], 2.5)),
            "heavy on light": Part(scene([floor(), *two], 2.5, materials=HEAVY)),
            "ball": Part(scene([floor(), body("ball", ball(0.05), (0, 0, 0.05005))], 0.5)),
        },
        judge,
    )  # fmt: skip


def _lists() -> Case:
    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for name in ("shuffled", "thinned"):
            yield from _rests(name, runs[name], [f"cube {k}" for k in range(5)])
        plain, bare = runs["plain"], runs["bare pairs"]
        off = max(
            largest(bare.track(name).centers - plain.track(name).centers) for name in ("cube 0", "cube 1", "ball")
        )
        yield Figure(
            "pairs without contacts: course changed by [mm]", 1e3 * off, 0.0, 0.01,
            "a pair may have no contacts, only a bound: pair_begin[i] == pair_begin[i + 1]",
        )  # fmt: skip

    content = scene([floor(), *tower(5)], 1.5)
    few = scene([floor(), *tower(2), body("ball", ball(0.05), (0.5, 0, 0.2))], 0.5)
    return Case(
        "lists", "Lists in another order each step, every second contact left out by turns, pairs without contacts",
        {
            "shuffled": Part(content, change=shuffled), "thinned": Part(content, change=thinned),
            "plain": Part(few), "bare pairs": Part(few, change=with_bare_pairs),
        },
        judge, "a node gets the lists of the service as they are",
    )  # fmt: skip


def _floor_force() -> Case:
    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for name, count in (("box", 1), ("stack", 5)):
            run = runs[name]
            assert run.impulses is not None
            weight = sum(run.track(f"cube {k}").mass for k in range(count)) * G
            forces = [_normal_impulse(run, k, run.id_of("floor"))[2] / STEP for k in range(-100, 0)]
            yield Figure(
                f"{name}: force on the floor over weight", float(np.mean(forces) / weight), 1.0, 1e-4,
                "the impulses returned are not those applied: those of the solve for velocities, in N s, on b",
            )  # fmt: skip

    return Case(
        "floor_force", "The floor bears the weight of what stands on it",
        {"box": Part(scene([floor(), *tower(1)], 1.0)), "stack": Part(scene([floor(), *tower(5)], 1.0))},
        judge, "a node does not publish impulses",
    )  # fmt: skip


def _normal_impulse(run: Recorded, k: int, fragment_id: int) -> np.ndarray:
    """Sum (3,) [N s] of the absolute normal impulses on a fragment in the k-th step, by axis."""
    assert run.impulses is not None
    step = run.impulses[k]
    counts: np.ndarray = np.diff(step.contacts.pair_begin.astype(np.int64))
    mine = np.repeat((step.contacts.fragment_a == fragment_id) | (step.contacts.fragment_b == fragment_id), counts)
    total: np.ndarray = np.abs(step.contacts.normals[mine] * step.normal[mine, None]).sum(axis=0)
    return total


# Gaps


def _gaps() -> Case:
    bodies = [
        floor(),
        body("falling", ball(0.05), (0, 0, 0.15), linear_velocity=[0.0, 0.0, -1.0]),
        body("passing", ball(0.05), (0.5, 0, 0.051), linear_velocity=[2.0, 0.0, 0.0]),
        body("leaving", ball(0.05), (0, 0.5, 0.05005), linear_velocity=[0.0, 0.0, 0.1]),
    ]
    wall = [
        body("wall", box(0.008, 0.4, 0.4), (0, 0, 0), static=True),
        body("bullet", ball(0.05), (-0.47, 0, 0), linear_velocity=[20.0, 0.0, 0.0]),
        body("plate", box(0.008, 0.4, 0.4), (0, 2, 0)),
        body("second bullet", ball(0.05), (-0.47, 2, 0), linear_velocity=[20.0, 0.0, 0.0]),
    ]

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["open"]
        for name, why in (
            ("passing", "a contact with an open gap was pushed: u >= -gap / h, not u >= 0"),
            ("leaving", "a contact that opens was held: normal impulses must not be negative"),
        ):
            velocities = run.track(name).velocities()
            yield Figure(
                f"{name}: change of velocity [mm/s]", 1e3 * largest(velocities - velocities[0]), 0.0, 1e-6, why
            )
        falling = run.track("falling")
        free = 0.15 - STEP * np.arange(len(falling.centers))
        early = free > 0.05 + TOLERANCE * 0.05
        yield Figure(
            "falling: pushed before the gap closes by [mm]", 1e3 * largest((falling.centers[:, 2] - free)[early]),
            0.0, 1e-6, "a contact with an open gap was pushed: u >= -gap / h, not u >= 0",
        )  # fmt: skip
        yield Figure(
            "falling: height at the end [mm]", 1e3 * float(falling.centers[-1, 2]), 50.0, 1e3 * TOLERANCE * 0.05,
            "the touch was missed or its only contact is ignored, or the body was held back for ever",
        )  # fmt: skip
        bullets = runs["fast"]
        through = 1e3 * float(bullets.track("bullet").centers[:, 0].max() + 0.054)
        yield Figure(
            "20 m/s into 8 mm: depth of the bullet [mm]", max(through, 0.0), 0.0, 1e3 * TOLERANCE * 0.05,
            "contacts with large gaps (lookahead) were left out, or the only contact of a pair is ignored: bodies pass"
            " through thin ones",
        )  # fmt: skip
        ahead = bullets.track("plate").centers[:, 0] - bullets.track("second bullet").centers[:, 0]
        yield Figure(
            "20 m/s into a plate that gives way: depth [mm]", max(1e3 * (0.054 - float(ahead.min())), 0.0), 0.0,
            1e3 * TOLERANCE * 0.05, "contacts with large gaps (lookahead) between two moving bodies were left out",
        )  # fmt: skip

    return Case(
        "gaps", "Open gaps push nothing before they close; no touch is missed at 20 m/s through 8 mm",
        {"open": Part(scene(bodies, 0.3, WEIGHTLESS)), "fast": Part(scene(wall, 0.1, WEIGHTLESS))}, judge,
        is_core=True,
    )  # fmt: skip


# Fracture

BRICK = {"brick": {"size_xyz": [0.2, 0.1, 0.06], "edge_length": 0.02}}
BRICK_DENSITY = 2000.0
BRICK_MASS = 0.2 * 0.1 * 0.06 * BRICK_DENSITY  # [kg]
PATTERN = {"seeds": 4, "curvature": 0.2}


def brittle(strength: float) -> dict[str, Any]:
    """A material that breaks once: pieces are too light to break again."""
    fracture = {"strength": strength, "minimum_mass": 0.95 * BRICK_MASS, "pattern": PATTERN}
    return {"density": BRICK_DENSITY, "fracture": fracture}


def _pieces(run: Recorded) -> list[Track]:
    ids = [int(i) for event in run.events for i in event.new_fragment_ids]
    return [run.track_of(i) for i in ids]


UNBROKEN = "nothing broke: the sum of the normal impulses on a fragment in a step has to be compared with its strength"


def _fracture() -> Case:
    weight = BRICK_MASS * G * STEP
    resting = [floor(), body("brick", BRICK, (0, 0, 0.0301), material="brittle")]
    hit = [
        body("brick", BRICK, (0, 0, 0), material="brittle", angular_velocity=[1.0, 2.0, 3.0]),
        body("ball", ball(0.05), (0.02, 0.01, 0.4), linear_velocity=[0.0, 0.0, -4.0]),
    ]

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["rest"]
        yield Figure("at rest: breaks", float(len(run.events)), 1.0, 0.0, UNBROKEN)
        pieces = _pieces(run)
        if pieces:
            moved = max(largest(piece.origins - piece.origins[0]) for piece in pieces)
            yield Figure(
                "at rest: pieces move by [mm]", 1e3 * moved, 0.0, 1e3 * TOLERANCE * 0.1,
                "pieces that lie crack on crack are pushed apart: their gap of 0 is where they rest (no rest gap)",
            )  # fmt: skip
            mass = sum(piece.mass for piece in pieces)
            yield Figure(
                "at rest: mass of the pieces over the whole", mass / BRICK_MASS, 1.0, 1e-9,
                "a piece is missing: states must name all new fragments of an event",
            )  # fmt: skip
        run = runs["hit"]
        yield Figure("hit in flight: breaks", float(len(run.events)), 1.0, 0.0, UNBROKEN)
        if pieces := _pieces(run):
            striker = run.track("ball")
            before = striker.mass * np.array([0.0, 0.0, -4.0])
            end = slice(-20, None)
            after = total(track.mass * track.velocities()[end].mean(axis=0) for track in (*pieces, striker))
            yield Figure(
                "hit in flight: change of momentum, relative", largest(after - before) / norm(before), 0.0, 1e-9,
                "pieces do not get v + w x (x_new - x_old) of the old fragment, or the striker loses what the fragment"
                " could not bear",
            )  # fmt: skip

    return Case(
        "fracture", "A brick breaks where it lies; another is broken in flight by a ball",
        {
            "rest": Part(scene(resting, 0.5, materials={"brittle": brittle(0.5 * weight)})),
            "hit": Part(scene(hit, 0.5, WEIGHTLESS, {"brittle": brittle(0.2)})),
        },
        judge,
    )  # fmt: skip


def _fracture_in_flight() -> Case:
    thrown = body(
        "brick", BRICK, (0, 0, 0), material="brittle", linear_velocity=[1.0, 2.0, 0.5], angular_velocity=[3.0, 2.0, 1.0]
    )

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["break"]
        whole, pieces = run.track("brick"), _pieces(run)
        linear = total(piece.mass * piece.velocities()[0] for piece in pieces)
        before = whole.mass * whole.velocities()[-1]
        yield Figure(
            "change of linear momentum, relative", largest(linear - before) / norm(before), 0.0, 1e-12,
            "pieces do not get the velocities of the old rigid motion: v + w x (x_new - x_old)",
        )  # fmt: skip
        after = total(
            piece.smooth_spin_momenta()[0]
            + piece.mass * np.cross(piece.centers[2], (piece.centers[3] - piece.centers[1]) / (2.0 * STEP))
            for piece in pieces
        )
        first = whole.smooth_spin_momenta()[-1] + whole.mass * np.cross(whole.centers[-3], whole.velocities()[-1])
        yield Figure(
            "change of angular momentum, relative", largest(after - first) / norm(first), 0.0, 1e-3,
            "pieces do not get the velocities of the old rigid motion, or inertias are about another point",
        )  # fmt: skip

    strike = Strike(40, "brick", (0.0, 0.0, 0.03), 1.5)
    return Case(
        "fracture_in_flight", "A turning brick breaks in flight without a blow",
        {"break": Part(scene([thrown], 0.2, WEIGHTLESS, {"brittle": brittle(1.0)}), strike=strike)}, judge,
        "a scene file cannot break a body without a blow",
    )  # fmt: skip


def _strength() -> Case:
    speed = 1.0
    impulse = BRICK_MASS * speed
    bodies = [floor()]
    for k, material in enumerate(("strong", "weak")):
        bodies.append(
            body(material, BRICK, (0.5 * k, 0, 0.08), material=material, linear_velocity=[0.0, 0.0, -speed])
        )

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["fall"]
        for name, exact, why in (
            ("strong", 0.0, "more than m v counted: position correction, several steps or both bodies' loads"),
            ("weak", 1.0, "less than m v counted: the blow is spread over steps by speculative contacts or soft ones"),
        ):
            broken = float(run.id_of(name) in [event.fragment_id for event in run.events])
            share = "0.99" if name == "strong" else "1.01"
            yield Figure(f"hit with {share} of its strength: breaks", broken, exact, 0.0, why)

    materials = {"strong": brittle(impulse / 0.99), "weak": brittle(impulse / 1.01)}
    return Case(
        "strength", "A brick breaks at the impulse that its material bears, not at 0.99 of it",
        {"fall": Part(scene(bodies, 0.2, WEIGHTLESS, materials))}, judge,
    )  # fmt: skip


# Position correction


def _drift() -> Case:
    ceiling = body("ceiling", {"plane": {"coefficients": [0.0, 0.0, -1.0, 0.199]}}, (0, 0, 0), static=True)
    cube = box(0.2, 0.2, 0.2)
    cause = "position correction ends up in the velocities: correct poses in a solve of their own (split impulse)"

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["squeezed"]
        block = run.track("cube")
        yield Figure(
            "squeezed by 1 mm: fastest [mm/s]", 1e3 * float(norms(block.velocities()).max()), 0.0, 0.5 / STEP,
            cause,
        )  # fmt: skip
        if len(block.published):
            yield Figure(
                "squeezed by 1 mm: fastest as published [mm/s]", 1e3 * float(norms(block.published).max()), 0.0, 1.0,
                cause,
            )  # fmt: skip
        if run.impulses is not None:
            pushes = [_normal_impulse(run, k, block.fragment_id)[2] for k in range(len(run.impulses))]
            yield Figure(
                "squeezed by 1 mm: largest impulse over weight h", max(pushes) / (block.mass * G * STEP), 0.0, 10.0,
                cause + "; such blows break bodies that lie still",
            )  # fmt: skip
        up = runs["sunk"].track("cube").velocities()[:, 2]
        yield Figure("1 mm in the floor: speed at the end [mm/s]", 1e3 * largest(up[-20:]), 0.0, 0.1, cause)
        gaps = runs["sunk"].contacts[-1].gaps
        yield Figure(
            "1 mm in the floor: depth at the end [mm]", -1e3 * float(gaps.min(initial=0.0)), 0.0, 1e3 * TOLERANCE * 0.1,
            "penetrations are not corrected",
        )  # fmt: skip

    return Case(
        "drift", "A box squeezed between floor and ceiling, and one that starts inside the floor, get no velocity",
        {
            "squeezed": Part(scene([floor(), ceiling, body("cube", cube, (0, 0, 0.0993))], 0.5, WEIGHTLESS)),
            "sunk": Part(scene([floor(), body("cube", cube, (0, 0, 0.099))], 0.5, WEIGHTLESS)),
        },
        judge, is_core=True,
    )  # fmt: skip


# Piles and robots


def _pile() -> Case:
    spots = [(0.12 * math.cos(2.4 * k), 0.12 * math.sin(2.4 * k), 0.12 + 0.09 * k) for k in range(16)]
    bodies = [
        floor(),
        *(body(f"box {k}", box(0.2, 0.12, 0.08), spot, rotation=[25.0 * k, 40.0 * k, 0.0])
          for k, spot in enumerate(spots)),
    ]  # fmt: skip

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["fall"]
        tracks = [run.track(f"box {k}") for k in range(len(spots))]
        fastest = max(float(norms(track.velocities()[-20:]).max()) for track in tracks)
        yield Figure(
            "fastest at the end [mm/s]", 1e3 * fastest, 0.0, 1.0,
            "bodies creep or jitter: start from the last step's impulses, matched by contact id",
        )  # fmt: skip
        yield Figure(
            "deepest at the end [mm]", -1e3 * float(run.contacts[-1].gaps.min(initial=0.0)), 0.0, 1e3 * TOLERANCE * 0.1,
            "penetrations are not corrected, or faster than bodies can come to rest",
        )  # fmt: skip
        lowest = min(float(track.centers[:, 2].min()) for track in tracks)
        yield Figure(
            "centres of mass that were below the floor", float(lowest < 0.0), 0.0, 0.0, "bodies fall through each other"
        )
        if run.reports is not None:
            energy = np.array([report.kinetic_energy + report.potential_energy for report in run.reports])
            lifted = np.array([report.drift_energy for report in run.reports])
            gain = float((np.diff(energy) - lifted[1:]).max())
            yield Figure(
                "largest gain of energy in a step, over the total", gain / energy[0], 0.0, 1e-6,
                "restitution of resting contacts, or position correction that ends up in velocities",
            )  # fmt: skip

    return Case(
        "pile", "Sixteen boxes fall on a heap and come to rest", {"fall": Part(scene(bodies, 2.5))}, judge
    )


# Of config/robots/three_links.urdf: (mass [kg], x of its centre [m]) beyond its joint `lift`, and the top of its hand.
BEYOND_LIFT, HAND_TOP = ((3.0, 0.2), (1.5, 0.5)), 0.495
LEAST = 60.0  # [N m] that `lift` has in the part `weak`: 60.3 are needed


def _robot() -> Case:
    def holding(density: float, torque: float) -> Part:
        content = scene(
            [body("load", box(0.2, 0.1, 0.06), (0.5, 0.0, HAND_TOP + 0.0302), material="load")], 0.75,
            materials={"load": {"density": density, "friction": 0.6}},
        )  # fmt: skip
        motors = [
            {"joint": joint, "torque": limit, "position": [[0.0, 0.0]]}
            for joint, limit in (("turn", 200.0), ("lift", torque), ("tilt", 60.0))
        ]
        urdf = str(share_directory() / "config" / "robots" / "three_links.urdf")
        return Part(content | {"robot": {"urdf": urdf, "material": "load", "motors": motors}})

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        for name in ("2.4 kg", "9.6 kg"):
            run = runs[name]
            load = run.track("load")
            assert run.torques is not None
            statics = -G * (sum(m * x for m, x in BEYOND_LIFT) + load.mass * load.centers[-1, 0])
            yield Figure(
                f"{name}: torque of the lifting motor [N m]", float(run.torques[-1][1]), statics, 1e-3 * abs(statics),
                "the robot does not feel its load, or twice: its links' impulses are those on the load, reversed",
            )  # fmt: skip
            yield Figure(
                f"{name}: fastest at the end [mm/s]", 1e3 * float(norms(load.velocities()[-20:]).max()), 0.0, 0.1,
                "the load is solved against a wrong mobility of the hand",
            )  # fmt: skip
        weak = runs["weak motor"]
        assert weak.torques is not None
        yield Figure(
            "weak motor: largest torque at the end [N m]", max(abs(float(each[1])) for each in weak.torques[-100:]),
            LEAST, 1e-6 * LEAST, "the motor's limit does not count",
        )  # fmt: skip
        fallen = weak.track("load").centers
        yield Figure(
            "weak motor: the load sinks", float(fallen[-1, 2] < fallen[100, 2] - 1e-4), 1.0, 0.0,
            "the hand holds more than its motor can",
        )  # fmt: skip

    parts = {
        "2.4 kg": holding(2000.0, 200.0), "9.6 kg": holding(8000.0, 200.0), "weak motor": holding(8000.0, LEAST)
    }  # fmt: skip
    return Case(
        "robot", "A robot holds loads with the torques of equilibrium, and gives way where a motor is too weak", parts,
        judge, "motors' torques are not part of what is recorded",
    )  # fmt: skip


# Bytes and cost


def _bytes() -> Case:
    bodies = [
        floor(),
        *(body(f"cube {k}", box(0.2, 0.15, 0.1), (0.05 * k, 0.03 * k, 0.2 + 0.25 * k), rotation=[30.0 * k, 20.0, 0.0])
          for k in range(4)),
    ]  # fmt: skip

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        first, second = runs["first"].digest(), runs["second"].digest()
        yield Figure(
            "runs that differ from the first", float(first != second), 0.0, 0.0,
            "something depends on addresses, hash order, threads, the clock, or what an earlier run left behind",
        )  # fmt: skip

    parts = dict.fromkeys(("first", "second"), Part(scene(bodies, 0.75)))
    return Case("bytes", "Two runs of a tumbling pile are equal to the last bit", parts, judge)


def _cost() -> Case:
    bodies = [floor(), *(
        body(f"cube {i} {j}", box(0.2, 0.2, 0.2), (0.3 * i, 0.3 * j, 0.1001)) for i in range(6) for j in range(6)
    )]  # fmt: skip

    def judge(runs: Mapping[str, Recorded]) -> Figures:
        run = runs["rest"]
        assert run.impulses is not None
        steps = run.impulses[20:]
        each = [1e6 * step.seconds / max(len(step.normal), 1) for step in steps]
        yield Figure("ms for 1,000 contacts, median step", float(np.median(each)), None, None)
        yield Figure("contacts in a step", float(len(steps[-1].normal)), None, None)

    return Case(
        "cost", "Time of the solver for 36 boxes at rest; reported, not judged",
        {"rest": Part(scene(bodies, 0.3))}, judge, "a node's time for the solver alone is not published",
    )  # fmt: skip


CASES: dict[str, Case] = {
    case.name: case
    for case in (
        _flight(), _frames(), _signs(), _slope(), _restitution(), _rest(), _floor_force(), _gaps(), _fracture(),
        _fracture_in_flight(), _strength(), _drift(), _lists(), _pile(), _robot(), _bytes(), _cost(),
    )
}  # fmt: skip

"""Errors of contacts at steps of a recorded scene, ours and those of peers that list theirs.

They are missed and false pairs, and solver errors (`benchmarks.peers.judging.solver_error`), from exact distances
between fragment surfaces.

The states are those that a solver reached with our contacts: it has mostly resolved the penetrations that we report,
and those that we miss remain. So our share of missed penetrating pairs is larger here than in `benchmarks.peers`, where
fragments are placed at random. Balls and planes have no exact triangle surface; pairs with one are left out.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from benchmarks.frames.measure import at_last_registry, is_busy, tell
from benchmarks.frames.peer import Peer, Shape, radius_of, shape_of
from benchmarks.frames.recording import Recording
from benchmarks.peers.boxes import local_boxes, near_pairs
from benchmarks.peers.judging.score import TOLERANCE, FrameTruth, JudgedPair, judged_pairs, mean_max
from benchmarks.peers.judging.solver_error import RESOLVED, solver_errors
from benchmarks.peers.judging.truth import Solids
from benchmarks.peers.libraries.ours import listed_contacts
from benchmarks.peers.method import Contacts
from benchmarks.peers.worlds import Frame, published_surface
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

OURS = "ours"
PERCENT = 100.0


class Errors(NamedTuple):
    """One method in one scene, at some steps. Lengths in % of the smaller R of a pair."""

    scene: str
    method: str
    steps: int
    pairs: int  # with overlapping boxes, overlapping or reported; all steps together
    penetrating: int  # deeper than 0.2 % R
    missed: int  # of these
    apart: int  # pairs without overlap
    false: int  # of these, reported deeper than 0.2 % R
    remaining_mean: float
    remaining_worst: float
    unnecessary_mean: float
    unnecessary_worst: float


class _Places(NamedTuple):
    """All fragments at one step: n fragments, numbered by ascending id."""

    solids: Solids
    truth: FrameTruth
    radii: np.ndarray  # (n,) [m] R of their bodies
    may_touch: np.ndarray  # (n, n) bool: pairs that are judged


def errors_of(recording: Recording, settings: Settings, makers: dict[str, type[Peer]], count: int) -> list[Errors]:
    """At `count` steps, evenly spaced among the busy ones, or among all steps if none is busy.

    Peers that can follow only the last registry are judged at those of the steps that have it, the others at all.
    """
    chosen, last = _chosen(recording, count), at_last_registry(recording)
    world, peers = CollisionWorld(settings), {name: make() for name, make in makers.items() if make.lists_contacts}
    bodies: dict[int, CollisionBody] = {}
    judged: dict[str, list[_Judged]] = {name: [] for name in (OURS, *peers)}
    for k, step in enumerate(recording.steps):
        tell(world, step)
        bodies |= {body.body_id: body for body in step.bodies}
        for peer in peers.values():
            peer.tell(step.bodies)
        if k not in chosen:
            continue
        answer, ids = world.contacts(step.states), world.present(step.states).ids
        places = _places(world, step.states, bodies)
        judged[OURS].append(_judge(places, listed_contacts(answer, ids)))
        for name, peer in peers.items():
            if last[k] or not peer.last_registry_only:
                peer.follow(world, ids.tolist())
                peer.step(step.states)
                judged[name].append(_judge(places, peer.contacts(ids, places.truth.frame)))
    return [_row(recording.name, name, steps) for name, steps in judged.items() if steps]


def _chosen(recording: Recording, count: int) -> set[int]:
    busy = np.flatnonzero(is_busy(recording))
    of = busy if len(busy) else np.arange(len(recording.steps))
    return set(of[np.linspace(0, len(of) - 1, min(count, len(of))).round().astype(int)].tolist())


def _places(world: CollisionWorld, states: FragmentStates, bodies: dict[int, CollisionBody]) -> _Places:
    present, registry = world.present(states), world.fragments()
    body_of = dict(zip(registry.fragment_ids.tolist(), registry.body_ids.tolist(), strict=True))
    of = [bodies[body_of[i]] for i in present.ids.tolist()]
    surfaces = [published_surface(world, i) for i in present.ids.tolist()]
    frame = Frame("step", present.positions, present.rotations, np.zeros((len(of), 4)), present.positions)
    has_surface = np.array([
        shape_of(body if body.fragment_id == i else None) not in (Shape.BALL, Shape.PLANE)
        for i, body in zip(present.ids.tolist(), of, strict=True)
    ])  # fmt: skip
    may_touch = has_surface[:, None] & has_surface & ~(present.is_static[:, None] & present.is_static)
    solids = Solids(surfaces)
    near = {pair for pair in near_pairs(local_boxes(solids.surfaces), frame) if may_touch[pair]}
    true = {pair: it for pair, it in solids.truth(frame).items() if may_touch[pair]}
    return _Places(solids, FrameTruth(frame, true, near, {}), np.array([radius_of(b) for b in of]), may_touch)


class _Judged(NamedTuple):
    """One step; k pairs whose ground truth is known."""

    pairs: list[JudgedPair]
    radii: np.ndarray  # (pairs,) [m] the smaller R
    remaining: np.ndarray  # (k,) [% R]
    unnecessary: np.ndarray  # (k,) [% R]


def _judge(places: _Places, answer: Contacts) -> _Judged:
    chosen = places.may_touch[answer.first, answer.second]
    answer = Contacts(*(column[chosen] for column in answer[:-1]), answer.native)
    pairs = list(judged_pairs(places.solids, places.truth, answer))
    radii = np.array([places.radii[list(it.pair)].min() for it in pairs])
    known = np.array([not it.crosses for it in pairs], bool)
    errors = solver_errors(places.solids, [it.way for it in pairs if not it.crosses], RESOLVED * radii[known])
    return _Judged(pairs, radii, *(PERCENT * error / radii[known] for error in errors))


def _row(scene: str, method: str, steps: list[_Judged]) -> Errors:
    pairs = [(it, TOLERANCE * radius) for step in steps for it, radius in zip(step.pairs, step.radii, strict=True)]
    deep = [it for it, least in pairs if it.way.depth > least]
    apart = [it.depth > least for it, least in pairs if it.true is None and not (it.crosses and it.depth > least)]
    remaining, unnecessary = (np.concatenate([step[k] for step in steps]) for k in (2, 3))
    return Errors(
        scene, method, len(steps), len(pairs), len(deep), sum(it.depth <= 0.0 for it in deep),
        len(apart), int(sum(apart)), *mean_max(remaining), *mean_max(unnecessary),
    )  # fmt: skip

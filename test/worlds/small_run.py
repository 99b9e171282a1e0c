"""A small run as records: two bricks over a floor, one of which breaks."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeVar

import numpy as np
from oracles.fracture_patterns import curved_event
from oracles.fragmented_body import ORIGINAL, FragmentedBody

from fracture_collision.geometry.generators import brick
from fracture_collision.records import BOX, SPHERE, CollisionBody, FragmentMesh, FragmentStates, SolidPrimitive

if TYPE_CHECKING:
    from fracture_collision.viewer.page.page import Page

BREAKS_AT, BREAKS = 30, 3  # the step and the body

Kind = TypeVar("Kind")


def fragment_mesh(body: FragmentedBody, fragment_id: int) -> FragmentMesh:
    fans = [
        ((p.points[0], b, c), p.kind != ORIGINAL)
        for p in body.surface_polygons(fragment_id)
        for b, c in zip(p.points[1:-1], p.points[2:], strict=True)
    ]
    vertices = np.array([corner for triangle, _ in fans for corner in triangle], dtype=np.float32)
    is_crack = np.array([crack for _, crack in fans])
    return FragmentMesh(fragment_id, vertices, np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3), is_crack)


def small_run(with_meshes: bool = True, steps: int = 60) -> list[tuple[float, object]]:
    """Two bricks over a floor, a box and a ball beside them; one brick breaks half way and its pieces drift apart."""
    mesh = brick((0.4, 0.3, 0.3), 0.15)
    tets = {"vertices": mesh.vertices, "tetrahedra": mesh.tetrahedra.astype(np.uint32)}
    records: list[tuple[float, object]] = [
        (0.0, CollisionBody(1, 1, name="floor", plane=np.array([0.0, 0.0, 1.0, 0.0]), is_static=True)),
        (0.0, CollisionBody(2, 2, name="shelf", primitive=SolidPrimitive(BOX, (2.0, 0.6, 0.1)), is_static=True)),
        (0.0, CollisionBody(3, 3, name="brick", **tets)),
        (0.0, CollisionBody(4, 4, name="other brick", **tets)),
        (0.0, CollisionBody(5, 5, name="ball", primitive=SolidPrimitive(SPHERE, (0.1,)))),
    ]
    body = FragmentedBody(*mesh, fragment_id=BREAKS)
    event = curved_event(body, BREAKS, np.random.default_rng(4).uniform(-0.2, 0.2, size=(4, 3)), 6, body_id=BREAKS)
    pieces = event.new_fragment_ids.tolist()
    for step in range(steps):
        time, broken = step * 0.02, step >= BREAKS_AT
        if step == BREAKS_AT:
            records.append((time, event))
            body.apply(event)
            records += [(time, fragment_mesh(body, f)) for f in pieces if with_meshes]
        ids = [2, 4, 5, *(pieces if broken else [3])]
        places = [(0, 0, 0.2), (0.4, 0, 0.6), (0.0, -1.0 + 0.02 * step, 0.5)]
        spread = 0.004 * (step - BREAKS_AT)
        places += [(-0.4 + spread * (i - 1.5), 0, 0.6) for i in range(len(pieces))] if broken else [(-0.4, 0, 0.6)]
        states = FragmentStates(
            step, int(broken), np.array(ids), np.array(places, dtype=float), np.tile([0.0, 0, 0, 1], (len(ids), 1))
        )
        records.append((time, states))
    return records


def records_of(kind: type[Kind]) -> list[Kind]:
    return [record for _, record in small_run() if isinstance(record, kind)]


def show(page: Page, step: int = 0, with_meshes: bool = False, shift: float = 0.0) -> None:
    """Shows all bodies at a step, `shift` [m] to the right of where they are in the run."""
    for body in records_of(CollisionBody):
        page.add_body(body)
    for mesh in records_of(FragmentMesh) if with_meshes else ():
        page.add_fragment(mesh, BREAKS)
    states = records_of(FragmentStates)[step]
    page.show_states(states._replace(positions=states.positions + (shift, 0.0, 0.0)))
    page.flush()

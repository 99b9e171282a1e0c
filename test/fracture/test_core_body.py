"""Invariants of a fractured body's polygons, boxes, cells and masses, whatever the planes (property tests)."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.fracture_patterns import disagreeing_event, voronoi_event
from oracles.fragmented_body import FragmentedBody

from fracture_collision.core.bodies.body_validator import validate_body
from fracture_collision.core.memory.pools import FANNED, FRONT, LABELS, OWNER, PARTED, PLANE
from fracture_collision.geometry.generators import TetGeometry, ball, brick, plate
from fracture_collision.records import CollisionBody, FragmentStates
from fracture_collision.world import CollisionWorld, Settings

MESHES = {
    "ball": ball(1.0, 0.6),
    "brick": brick((2.0, 1.0, 0.8), 0.6),
    "plate": plate(2.0, 0.2, 0.4, 0.2),
}


def _validated(mesh: TetGeometry, generations: int, pieces: int, tilt: float | None, seed: int) -> CollisionWorld:
    """Break a body again and again, validating after each event; `tilt` None: planes that agree."""
    random = np.random.default_rng(seed)
    world, oracle = CollisionWorld(Settings(threads=1)), FragmentedBody(mesh.vertices, mesh.tetrahedra)
    world.add_body(CollisionBody(1, 1, vertices=mesh.vertices.ravel(), tetrahedra=mesh.tetrahedra.ravel()))
    victim, next_id = 1, 2
    for sequence in range(1, generations + 1):
        own = mesh.vertices[oracle.labels == victim]
        seeds = random.uniform(own.min(axis=0), own.max(axis=0), (pieces, 3))
        try:
            if tilt is None:
                event = voronoi_event(oracle, victim, seeds, next_id, sequence)
            else:
                event = disagreeing_event(oracle, victim, seeds, next_id, sequence, tilt, random)
        except ValueError:  # all nodes nearest to one seed: nothing breaks
            break
        oracle.apply(event)
        world.add_fracture(event)
        ids = np.array(oracle.fragment_ids)
        world.contacts(FragmentStates(1, sequence, ids, np.zeros(3 * len(ids)), np.tile([0.0, 0, 0, 1], len(ids))))
        validate_body(world._registry.geometry, [world._registry.row_of(f) for f in ids.tolist()])
        next_id += len(event.new_fragment_ids)
        names, counts = np.unique(oracle.labels, return_counts=True)
        victim = int(names[np.argmax(counts)])
    return world


@pytest.mark.timeout(3600)
@pytest.mark.parametrize("bodies", [30, pytest.param(1000, marks=pytest.mark.slow)])
def test_a_body_is_valid_after_every_event(bodies: int) -> None:
    @settings(max_examples=bodies, deadline=None)
    @given(
        st.sampled_from(sorted(MESHES)), st.integers(1, 3 if bodies < 100 else 5), st.integers(2, 12),
        st.one_of(st.none(), st.floats(0.0, 3.0)), st.integers(0, 2**32 - 1),
    )  # fmt: skip
    def is_valid(name: str, generations: int, pieces: int, tilt: float | None, seed: int) -> None:
        _validated(MESHES[name], generations, pieces, tilt, seed)

    is_valid()


@pytest.mark.parametrize(
    ("words", "field", "spoil"),
    [
        ("not closed", "triangles", lambda a: a.__setitem__((0, slice(0, 3)), a[0, 3:6])),
        ("beside its plane", "faces", lambda a: a.__setitem__((0, 3), a[0, 3] + 0.1)),
        ("a retired owner", "sides", lambda a: a.__setitem__((0, 0), 0)),
        ("owner has no node of it", "regions", lambda a: a.__setitem__((0, 0), 99)),
        ("front is not that of", "regions", lambda a: a.__setitem__((a[:, OWNER] == PARTED, FRONT), 0)),
        ("labels of a tetrahedron", "regions", lambda a: a.__setitem__((a[:, OWNER] == FANNED, LABELS), 0)),
        ("a plane turned", "regions", lambda a: a.__setitem__((a[:, OWNER] == PARTED, PLANE), 0)),
        ("if and only if its ends differ", "edge_plane", lambda a: a.fill(-1)),
    ],
)
def test_the_validator_rejects_a_corrupted_body(words: str, field: str, spoil) -> None:
    world = _validated(MESHES["ball"], 1, 4, None, 1)
    geometry = world._registry.geometry
    rows = [world._registry.row_of(f) for f in world.fragments().fragment_ids.tolist()]
    spoil(getattr(geometry.pools.body, field))
    with pytest.raises(AssertionError, match=words):
        validate_body(geometry, rows)

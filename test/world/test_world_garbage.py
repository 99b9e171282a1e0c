"""Random garbage in every field: raises InvalidMessage or is accepted, never anything else."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from worlds.gate_world import REFERENCE, SECOND, TET, TRI, made_world, observed, plane, rigid, sphere
from worlds.rigid_shapes import RigidShape

from fracture_collision.records import CollisionBody
from fracture_collision.world import CollisionWorld, InvalidMessage

ANY_ARRAY = st.one_of(
    arrays.arrays(
        st.one_of(
            arrays.floating_dtypes(), arrays.integer_dtypes(), arrays.unsigned_integer_dtypes(),
            arrays.boolean_dtypes(), arrays.complex_number_dtypes(), arrays.unicode_string_dtypes(max_len=3),
            st.just(np.dtype(object)),
        ),
        arrays.array_shapes(min_dims=0, max_dims=2, min_side=0, max_side=20),
    ),
    st.lists(st.one_of(st.none(), st.integers(), st.floats(), st.lists(st.integers(), max_size=2)), max_size=13),
    st.none(),
)  # fmt: skip
ANY_SCALAR = st.one_of(
    st.integers(-(2**70), 2**70), st.floats(), st.none(), st.booleans(), st.text(max_size=3), ANY_ARRAY
)
GARBAGE_WORLD: list[CollisionWorld] = []


def _garbage_world() -> tuple[CollisionWorld, tuple[bytes, bytes]]:
    if not GARBAGE_WORLD:
        GARBAGE_WORLD.append(made_world())
    return GARBAGE_WORLD[0], observed(GARBAGE_WORLD[0])


def _never_anything_but_invalid_message(record, deliver, changes: dict) -> None:
    world, before = _garbage_world()
    try:
        deliver(world)(record._replace(**changes))
    except InvalidMessage as refusal:
        assert refusal.kind and str(refusal)
        assert observed(world) == before
    else:
        GARBAGE_WORLD.clear()  # accepted, so this world has changed


BODY_ARRAYS = ("vertices", "triangles", "tetrahedra", "plane", "primitive")
BODY_SCALARS = ("body_id", "fragment_id", "operation", "name", "is_static", "density", "friction", "restitution")
EVENT_ARRAYS = ("new_fragment_ids", "nodes", "node_fragments", "cut_edges", "cut_planes")
STATES_ARRAYS = ("fragment_ids", "positions", "orientations", "linear_velocities", "angular_velocities")


def _changes(array_fields: tuple[str, ...], scalar_fields: tuple[str, ...]):
    fields = {name: ANY_ARRAY for name in array_fields} | {name: ANY_SCALAR for name in scalar_fields}
    return st.lists(st.sampled_from(sorted(fields)), min_size=1, max_size=2, unique=True).flatmap(
        lambda names: st.fixed_dictionaries({name: fields[name] for name in names})
    )


# Except ResourceWarning: files left open by earlier tests warn at any garbage collection.
warnings_are_errors = pytest.mark.filterwarnings("error", "ignore::ResourceWarning")


@settings(max_examples=150, deadline=None, derandomize=True)
@given(st.sampled_from([TET, TRI, sphere(20), plane(20)]), _changes(BODY_ARRAYS, BODY_SCALARS))
@warnings_are_errors
def test_random_changes_of_bodies_raise_only_invalid_message(body: CollisionBody, changes: dict) -> None:
    _never_anything_but_invalid_message(body, lambda world: world.add_body, changes)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(_changes(EVENT_ARRAYS, ("sequence", "body_id", "fragment_id")))
@warnings_are_errors
def test_random_changes_of_events_raise_only_invalid_message(changes: dict) -> None:
    _never_anything_but_invalid_message(SECOND, lambda world: world.add_fracture, changes)


@settings(max_examples=150, deadline=None, derandomize=True)
@given(_changes(STATES_ARRAYS, ("step", "fracture_sequence")))
@warnings_are_errors
def test_random_changes_of_states_raise_only_invalid_message(changes: dict) -> None:
    _never_anything_but_invalid_message(REFERENCE, lambda world: world.contacts, changes)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(4, 12), st.integers(4, 30))
def test_random_triangles_are_rejected(seed: int, vertices: int, triangles: int) -> None:
    random = np.random.default_rng(seed)
    soup = RigidShape(random.normal(size=(vertices, 3)), random.integers(0, vertices, (triangles, 3)))
    with pytest.raises(InvalidMessage) as refusal:
        _garbage_world()[0].add_body(rigid(20, soup))
    assert refusal.value.kind == "bad_mesh"

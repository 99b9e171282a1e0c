"""Possible faults of a CollisionBody."""

from __future__ import annotations

from typing import Any

import numpy as np
from worlds.gate_world import TET, TRI, box, plane, sphere

from campaigns.bad_input.clean_scene import REMOVED
from campaigns.bad_input.mutations import (
    FINE,
    Mutation,
    Pick,
    Rules,
    float_mutations,
    identifier_type_mutations,
    index_mutations,
    mutation,
    one_of,
    scalar_type_mutations,
    value_mutations,
)
from fracture_collision.geometry.generators import brick
from fracture_collision.records import BOX, CONE, CYLINDER, REMOVE, SPHERE, SolidPrimitive

SPHERE_BODY, BOX_BODY, PLANE_BODY = sphere(20), box(20), plane(20)
SHAPES = (TET, TRI, SPHERE_BODY, BOX_BODY, PLANE_BODY)
LARGER = brick((1.0, 0.5, 0.5), 0.125)
MESH_FIELDS = ("vertices", "tetrahedra", "triangles")
NO_SHAPE_FIELDS = ("primitive", "plane", *MESH_FIELDS)

SCALARS = [
    *value_mutations("body_id", (1, 2, 3, 4), "doubled", what="is taken"),
    *value_mutations("body_id", (REMOVED,), "retired_id", what="was removed"),
    *value_mutations("body_id", (0, 2**32 - 1, 2**31), FINE, what="is one of the ends"),
    *identifier_type_mutations("body_id", 32),
    *value_mutations("fragment_id", (1, 2, 3, 4, REMOVED, 10, 11), "doubled", what="exists or existed"),
    *value_mutations("fragment_id", (0, 2**32 - 1), FINE, what="is one of the ends"),
    *identifier_type_mutations("fragment_id", 32),
    *value_mutations("operation", (2, 3, 255), "out_of_range"),
    *value_mutations("operation", (REMOVE,), "unknown_id", ("body_id",)),
    *identifier_type_mutations("operation", 32),
    *value_mutations("sequence", (1, 2, 3, 4, 5, 6), "sequence_repeat", what="is another body's"),
    *value_mutations("sequence", (0, 7, 8, 2**64 - 1), FINE, what="is free"),
    *identifier_type_mutations("sequence", 64),
    *value_mutations("name", ("x" * 257, "é" * 300), "limit_exceeded"),
    *scalar_type_mutations("name", ("\0" * 1000,), "limit_exceeded"),
    *value_mutations("name", ("", "x" * 256, "\U0001f9f1", "$(reboot)", "../../etc"), FINE),
    *scalar_type_mutations("name", (None, 1, b"x", ["x"], np.zeros(2))),
    *scalar_type_mutations("is_static", (None, 1, 0.0, "yes", [True], np.ones(2, bool))),
    *value_mutations("density", (np.nan, np.inf, -np.inf), "not_finite"),
    *value_mutations("density", (0.0, -0.0, -1.0, 1e308, -1e308, 1.1e9, -1e-320), "out_of_range"),
    *value_mutations("density", (1e-320, 5e-324, 1e9, 1e-300), FINE),
    *value_mutations("friction", (np.nan, np.inf), "not_finite"),
    *value_mutations("friction", (-1e-320, -0.1, 1e308, 1.1e6), "out_of_range"),
    *value_mutations("friction", (0.0, -0.0, 1e-320, 1e6), FINE),
    *value_mutations("restitution", (np.nan, -np.inf), "not_finite"),
    *value_mutations("restitution", (-1e-320, 1.0 + 1e-15, 2.0, 1e308), "out_of_range"),
    *value_mutations("restitution", (0.0, 1.0, 1e-320), FINE),
    *[
        each
        for field in ("density", "friction", "restitution")
        for each in scalar_type_mutations(field, (None, "heavy", [1.0, 2.0], {}, 1j, b"\xff", np.ones(3)))
    ],
]  # fmt: skip


def _primitive(kinds: str, what: str, *values: Any, fields: tuple = ("primitive.dimensions",), wire: bool = True):
    return mutation(
        "primitive", what, lambda r, p: r._replace(primitive=one_of(values, p)), kinds, fields, on_the_wire=wire
    )


PRIMITIVES = [
    _primitive("out_of_range", "of another type", *(SolidPrimitive(t, (1.0, 1.0)) for t in (5, 6, 255)),
               fields=("primitive.type",)),
    _primitive("size_mismatch", "of too few dimensions", SolidPrimitive(BOX, (1.0, 1.0)), SolidPrimitive(BOX, ()),
               SolidPrimitive(SPHERE, ()), SolidPrimitive(BOX, (1.0,))),
    _primitive("size_mismatch", "of too many dimensions", SolidPrimitive(SPHERE, (1.0, 1.0)),
               SolidPrimitive(SPHERE, (1.0, 1.0, 1.0))),
    _primitive("not_finite", "not finite", *(SolidPrimitive(BOX, (1.0, x, 1.0)) for x in (np.nan, np.inf, -np.inf)),
               *(SolidPrimitive(SPHERE, (x,)) for x in (np.nan, np.inf))),
    _primitive("out_of_range", "huge", *(SolidPrimitive(BOX, (1.0, x, 1.0)) for x in (1e308, 1e10, -1e308))),
    _primitive("out_of_range", "too small",
               *(SolidPrimitive(SPHERE, (x,)) for x in (0.0, -1.0, 1e-320, 1e-7, -1e-320))),
    _primitive("", "a legal one", SolidPrimitive(SPHERE, (1e-6,)), SolidPrimitive(BOX, (1e9, 1e-6, 1.0)),
               SolidPrimitive(CYLINDER, (1.0, 0.5)), SolidPrimitive(CONE, (1.0, 0.5))),
    _primitive("no_shape", "of no type", SolidPrimitive(0, ()), SolidPrimitive(0, (1.0,)), fields=NO_SHAPE_FIELDS),
    _primitive("wrong_type", "of wrong types", SolidPrimitive(SPHERE, "abc"), SolidPrimitive("BOX", (1.0,)), None, 3,
               SolidPrimitive(1.0, (1.0,)), fields=("primitive.dimensions", "primitive.type"), wire=False),
    _primitive("out_of_range", "of a type beyond 8 bits", SolidPrimitive(-1, (1.0,)), SolidPrimitive(256, (1.0,)),
               fields=("primitive.type",), wire=False),
]  # fmt: skip

# A message's plane has four numbers, whatever their values.
VALUES_ONLY = {
    f"{which} {what}" for which in ("an entry is", "all are")
    for what in ("NaN", "infinite", "huge", "tiny", "any float")
}  # fmt: skip
PLANES = [
    *(each._replace(on_the_wire=each.on_the_wire and each.what in VALUES_ONLY) for each in float_mutations(
        "plane", Rules(4, "size_mismatch", "out_of_range", "no_shape out_of_range", names=NO_SHAPE_FIELDS))),
    mutation("plane", "without a normal", lambda r, p: r._replace(plane=np.array([0.0, 0.0, 0.0, 1.0])),
             "out_of_range"),
    mutation("plane", "of zeros", lambda r, p: r._replace(plane=np.zeros(4)), "no_shape", NO_SHAPE_FIELDS),
    mutation("plane", "out of sight", lambda r, p: r._replace(plane=np.array([0.0, one_of((1e-9, 1e-320), p), 0, 1e3])),
             "out_of_range"),
    mutation("plane", "of a tiny normal", lambda r, p: r._replace(
        plane=np.array([0.0, 0.0, one_of((1e-320, 5e-324), p), 0.0])), FINE),
    mutation("is_static", "a plane that moves", lambda r, p: r._replace(is_static=False), "out_of_range"),
]  # fmt: skip


def _second_shape(record: Any, pick: Pick) -> Any:
    """Adds what another kind of body has."""
    parts: list[dict[str, Any]] = []
    if not record.primitive.type:
        parts += [{"primitive": SPHERE_BODY.primitive}, {"primitive": BOX_BODY.primitive}]
    if not record.plane.any():
        parts += [{"plane": PLANE_BODY.plane}]
    if not len(record.vertices):
        parts += [
            {"vertices": TET.vertices, "tetrahedra": TET.tetrahedra},
            {"vertices": TRI.vertices, "triangles": TRI.triangles},
            {"triangles": TRI.triangles[:0], "vertices": np.zeros(3)},
        ]
    return record._replace(**parts[pick(len(parts))])


def _vertices(record: Any) -> np.ndarray:
    return np.array(record.vertices).reshape(-1, 3)


def _rows(record: Any, field: str) -> np.ndarray:
    columns = 4 if field == "tetrahedra" else 3
    return np.array(getattr(record, field)).reshape(-1, columns)


def _with_rows(record: Any, field: str, rows: np.ndarray) -> Any:
    return record._replace(**{field: rows.ravel()})


def _turned_over(field: str):
    def change(record: Any, pick: Pick) -> Any:
        rows = _rows(record, field)
        i = pick(len(rows))
        rows[i, [0, 1]] = rows[i, [1, 0]]
        return _with_rows(record, field, rows)

    return change


def _same_corner(field: str):
    def change(record: Any, pick: Pick) -> Any:
        rows = _rows(record, field)
        i = pick(len(rows))
        rows[i, 0] = rows[i, 1]
        return _with_rows(record, field, rows)

    return change


def _once_more(field: str, times: int):
    def change(record: Any, pick: Pick) -> Any:
        rows = _rows(record, field)
        return _with_rows(record, field, np.append(rows, [rows[pick(len(rows))]] * times, axis=0))

    return change


def _vertex_on_another(record: Any, pick: Pick) -> Any:
    points = _vertices(record)
    i = pick(len(points))
    points[i] = points[(i + 1 + pick(len(points) - 1)) % len(points)]
    return record._replace(vertices=points.ravel())


def _vertex_beyond(record: Any, pick: Pick) -> Any:
    points = _vertices(record)
    points[pick(len(points))] *= one_of((-3.0, 50.0, 1e5), pick)
    return record._replace(vertices=points.ravel())


def _scaled(*factors: float):
    return lambda record, pick: record._replace(vertices=np.array(record.vertices) * one_of(factors, pick))


def _flattened(record: Any, pick: Pick) -> Any:
    points = _vertices(record)
    points[:, pick(3)] *= one_of((0.0, 1e-320, 1e-12), pick)
    return record._replace(vertices=points.ravel())


def _copies(offset: float, field: str):
    def change(record: Any, pick: Pick) -> Any:
        points, rows = _vertices(record), _rows(record, field)
        return record._replace(
            vertices=np.concatenate([points, points + offset]).ravel(),
            **{field: np.concatenate([rows, rows + len(points)]).ravel()},
        )

    return change


def _two_tetrahedra(record: Any, pick: Pick) -> Any:
    corner = np.concatenate([np.zeros((1, 3)), np.eye(3)])
    points = np.concatenate([corner, corner + one_of((0.1, 1.0, 5.0), pick)])
    return record._replace(vertices=points.ravel(), tetrahedra=np.arange(8))


def _noise(record: Any, pick: Pick) -> Any:
    generator = np.random.default_rng(pick(2**32))
    size = one_of((1e-9, 1e-3, 0.1, 1.0), pick)
    return record._replace(vertices=record.vertices + size * generator.normal(size=len(record.vertices)))


def _one_point(record: Any, pick: Pick) -> Any:
    return record._replace(vertices=np.tile(_vertices(record)[0], len(_vertices(record))))


BAD, MESH = "bad_mesh", {"names": MESH_FIELDS}
TETRAHEDRA = [
    *float_mutations("vertices", Rules(3, "bad_mesh out_of_range limit_exceeded size_mismatch", "out_of_range",
                                       "bad_mesh out_of_range",
                                       empty="out_of_range", names=MESH_FIELDS)),
    *index_mutations("tetrahedra", Rules(4, BAD, "out_of_range", BAD, empty="no_shape", names=NO_SHAPE_FIELDS)),
    mutation("triangles", "not the boundary", lambda r, p: r._replace(triangles=np.array([0, 1, 2])), BAD),
    mutation("triangles", "out of range", lambda r, p: r._replace(triangles=np.array([0, 1, 2**32 - 1])),
             "out_of_range"),
    mutation("triangles", "huge", lambda r, p: r._replace(triangles=np.zeros(600_000, int)), BAD),
    mutation("tetrahedra", "one inverted", _turned_over("tetrahedra"), BAD),
    mutation("tetrahedra", "one with a corner twice", _same_corner("tetrahedra"), BAD, **MESH),
    mutation("tetrahedra", "one twice", _once_more("tetrahedra", 1), BAD, **MESH),
    mutation("tetrahedra", "one three times", _once_more("tetrahedra", 2), BAD, **MESH),
    mutation("vertices", "one where another is", _vertex_on_another, BAD, MESH_FIELDS, True),
    mutation("vertices", "one far off", _vertex_beyond, BAD, MESH_FIELDS, True),
    mutation("vertices", "a body too small", _scaled(1e-7, 1e-20, 1e-320, 0.0), "out_of_range bad_mesh", MESH_FIELDS),
    mutation("vertices", "another scale", _scaled(1e-5, 1e3, 1e8, 1.9e9), "", MESH_FIELDS, True),
    mutation("vertices", "inside out", _scaled(-1.0), BAD, MESH_FIELDS),
    mutation("vertices", "flat", _flattened, BAD, MESH_FIELDS),
    mutation("vertices", "noise", _noise, "bad_mesh", MESH_FIELDS, True),
    mutation("vertices", "all in one point", _one_point, "out_of_range"),
    mutation("vertices", "more than there is room for", lambda r, p: r._replace(
        vertices=LARGER.vertices.ravel(), tetrahedra=LARGER.tetrahedra.ravel()), "limit_exceeded"),
    mutation("tetrahedra", "two bodies in one", _two_tetrahedra, BAD, MESH_FIELDS),
]  # fmt: skip
TRIANGLES = [
    *float_mutations("vertices", Rules(3, "bad_mesh out_of_range limit_exceeded size_mismatch", "out_of_range",
                                       "bad_mesh out_of_range",
                                       empty="out_of_range", names=MESH_FIELDS)),
    *index_mutations("triangles", Rules(3, BAD, "out_of_range", BAD, empty="no_shape", names=NO_SHAPE_FIELDS)),
    mutation("triangles", "one turned over", _turned_over("triangles"), BAD),
    mutation("triangles", "one with a corner twice", _same_corner("triangles"), BAD, **MESH),
    mutation("triangles", "one twice", _once_more("triangles", 1), BAD),
    mutation("triangles", "all turned over", lambda r, p: _with_rows(
        r, "triangles", _rows(r, "triangles")[:, ::-1]), BAD),
    mutation("triangles", "two solids", _copies(5.0, "triangles"), BAD),
    mutation("triangles", "two solids in one another", _copies(0.1, "triangles"), BAD),
    mutation("vertices", "one where another is", _vertex_on_another, BAD, MESH_FIELDS, True),
    mutation("vertices", "a body too small", _scaled(1e-7, 1e-20, 1e-320, 0.0), "out_of_range bad_mesh", MESH_FIELDS),
    mutation("vertices", "inside out", _scaled(-1.0), BAD, MESH_FIELDS),
    mutation("vertices", "flat", _flattened, BAD, MESH_FIELDS),
    mutation("vertices", "noise", _noise, BAD, MESH_FIELDS, True),
    mutation("vertices", "all in one point", _one_point, "out_of_range"),
    mutation("vertices", "more than there is room for", lambda r, p: _copies(0.0, "triangles")(
        _copies(0.0, "triangles")(_copies(0.0, "triangles")(_copies(0.0, "triangles")(r, p), p), p), p),
             "limit_exceeded"),
]  # fmt: skip
SHAPE_MUTATIONS = [mutation("primitive", "two shapes", _second_shape, "no_shape", NO_SHAPE_FIELDS)]

# (the body to corrupt, how)
BODY_MUTATIONS: list[tuple[Any, Mutation]] = [
    *((shape, each) for shape in SHAPES for each in [*SCALARS, *SHAPE_MUTATIONS]),
    *((shape, each) for shape in (SPHERE_BODY, BOX_BODY) for each in PRIMITIVES),
    *((PLANE_BODY, each) for each in PLANES),
    *((TET, each) for each in TETRAHEDRA),
    *((TRI, each) for each in TRIANGLES),
]

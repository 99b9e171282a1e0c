"""Validation of closed triangle meshes: the preconditions of the exact signed distance (triangle_field.py)."""

from __future__ import annotations

import numpy as np

from fracture_collision.core.mesh.connected_pieces import joined
from fracture_collision.core.mesh.ray_crossings import UNDECIDED, windings_of_others
from fracture_collision.geometry.tetrahedra import pyramid_volumes
from fracture_collision.portable_math import dots, lengths
from fracture_collision.world.gates.checks import refuse

# Twice the area over the longest side squared; below it, rounding determines the direction of the normal.
FLAT_TRIANGLE = 1e-9


def check_surface(vertices: np.ndarray, triangles: np.ndarray) -> None:
    """Raise InvalidMessage unless triangles (t, 3) of vertices (n, 3) [m] bound one solid, seen counter-clockwise.

    Closed: each edge in two triangles, in opposite directions; one fan of triangles around each vertex; one outer
    surface, with or without cavities in it. Not checked: that no two triangles cut each other.
    """
    unused = np.flatnonzero(np.bincount(triangles.ravel(), minlength=len(vertices)) == 0)
    if len(unused):
        refuse("bad_mesh", f"vertices: vertex {unused[0]} belongs to no triangle; leave out unused vertices")
    corners = vertices[triangles]
    sides = np.roll(corners, -1, axis=1) - corners
    twice_area = lengths(np.cross(sides[:, 0], sides[:, 1]))
    flat = np.flatnonzero(twice_area <= FLAT_TRIANGLE * dots(sides, sides).max(axis=1))
    if len(flat):
        refuse(
            "bad_mesh",
            f"triangles: triangle {flat[0]} has no area ({0.5 * twice_area[flat[0]]:.3g} m2); merge vertices at equal "
            "places",
        )
    opposite = _opposite_sides(triangles, len(vertices))
    _one_fan_a_vertex(triangles, opposite, len(vertices))
    _one_solid(triangles, corners, opposite)


def _opposite_sides(triangles: np.ndarray, vertex_count: int) -> np.ndarray:
    """For each side (3 x triangle + corner it starts at) the same edge seen from the other triangle."""
    start, end = triangles.ravel(), np.roll(triangles, -1, axis=1).ravel()
    _, edge, uses = np.unique(
        np.minimum(start, end) * vertex_count + np.maximum(start, end), return_inverse=True, return_counts=True
    )
    shared = np.flatnonzero(uses[edge] > 2)
    if len(shared):
        side = shared[0]
        refuse("bad_mesh", f"triangles: edge {start[side]}-{end[side]} belongs to {uses[edge[side]]} triangles, not 2")
    direction = start * vertex_count + end
    order = np.argsort(direction, kind="stable")
    ordered = direction[order]
    twice = np.flatnonzero(ordered[1:] == ordered[:-1])
    if len(twice):
        side = order[twice[0]]
        refuse(
            "bad_mesh",
            f"triangles: edge {start[side]}-{end[side]} runs the same way in two triangles; "
            "one of them is seen clockwise from outside",
        )
    back = end * vertex_count + start
    found = np.minimum(np.searchsorted(ordered, back), len(ordered) - 1)
    unmatched = np.flatnonzero(ordered[found] != back)
    if len(unmatched):
        side = unmatched[0]
        ends = f"{start[side]}-{end[side]}"
        refuse("bad_mesh", f"triangles: edge {ends} belongs to one triangle; the surface is open: close its holes")
    return order[found]


def _one_fan_a_vertex(triangles: np.ndarray, opposite: np.ndarray, vertex_count: int) -> None:
    """Join each corner with the next one around its vertex and require as many circles of corners as vertices."""
    triangle, corner = opposite // 3, opposite % 3
    next_corner = 3 * triangle + (corner + 1) % 3  # side a-b starts at a, where the other triangle's b-a ends
    fan = joined(np.arange(triangles.size), next_corner, triangles.size)
    if fan.max() + 1 == vertex_count:
        return
    pairs = np.unique(np.column_stack([triangles.ravel(), fan]), axis=0)
    vertex = np.flatnonzero(np.bincount(pairs[:, 0]) > 1)[0]
    refuse("bad_mesh", f"triangles: the surface touches itself in vertex {vertex}; give each sheet a vertex of its own")


def _one_solid(triangles: np.ndarray, corners: np.ndarray, opposite: np.ndarray) -> None:
    piece = joined(np.arange(len(triangles)).repeat(3), opposite // 3, len(triangles))
    volumes = np.bincount(piece, pyramid_volumes(corners))
    outer = np.flatnonzero(volumes > 0.0)
    if not len(outer):
        refuse("bad_mesh", f"triangles: inside out (volume {volumes.sum():.3g} m3); order them counter-clockwise")
    if len(outer) > 1:
        refuse("bad_mesh", f"triangles: {len(outer)} separate solids; each needs a body of its own")
    cavities = np.flatnonzero(volumes <= 0.0)
    _, first = np.unique(piece, return_index=True)
    first = first[cavities]
    windings = windings_of_others(corners, piece, corners[first, 0], cavities)
    if (windings != 1).any():
        wrong = int(np.argmax(windings != 1))
        where = "touches another piece" if windings[wrong] == UNDECIDED else "is inside out and no cavity of the solid"
        refuse("bad_mesh", f"triangles: the piece with triangle {first[wrong]} {where}")

"""Distances at vertices: the depth of every vertex in another fragment's box. Exact, or from grids.

libigl's and the grids' method share the numpy part; `warp_distances` is another exact method.
"""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import igl
import numpy as np
from scipy.interpolate import RegularGridInterpolator

from benchmarks.peers.boxes import Vertices, all_vertices, candidates
from benchmarks.peers.method import Contacts, Method, contacts_of
from benchmarks.peers.worlds import Frame, Surface, World

CELLS = 24  # nodes along each axis of a fragment's grid
PADDING = 0.02  # [R] around its box
SIGNED = igl.SignedDistanceType.SIGNED_DISTANCE_TYPE_FAST_WINDING_NUMBER


class _State(NamedTuple):
    vertices: Vertices
    fields: list


class VertexDistances(Method):
    """Subclasses differ in `make_field` and `depths`."""

    def make_field(self, surface: Surface):
        raise NotImplementedError

    def depths(self, surface: Surface, field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth (n,) [m], negative outside, and the outward direction (n, 3), unit, of points in the fragment frame."""
        raise NotImplementedError

    def update(self, world: World, before) -> _State:
        surfaces = [f.mesh for f in world.fragments]
        return _State(all_vertices([s.vertices for s in surfaces]), [self.make_field(s) for s in surfaces])

    def query(self, world: World, state: _State, frame: Frame) -> Contacts:
        near = candidates(state.vertices, frame)
        depths, outward, native = np.full(len(near.own), -1.0), np.zeros((len(near.own), 3)), 0.0
        begin = np.searchsorted(near.other, np.arange(len(world.fragments) + 1))
        for v, fragment in enumerate(world.fragments):
            rows = slice(begin[v], begin[v + 1])
            if rows.start < rows.stop:
                started = perf_counter()
                depths[rows], ways = self.depths(fragment.mesh, state.fields[v], near.local[rows])
                native += perf_counter() - started
                outward[rows] = ways @ frame.rotations[v].T
        inside = depths > 0.0
        own, other, points = near.own[inside], near.other[inside], near.world[inside]
        depths, outward = depths[inside], outward[inside]
        return contacts_of(own, other, points, points + depths[:, None] * outward, -outward, depths, native)


class Exact(VertexDistances):
    name = "exact vertices (libigl)"

    def make_field(self, surface: Surface):
        tree = igl.AABB()
        tree.init(surface.vertices, surface.triangles)
        return tree

    def depths(self, surface: Surface, field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # the binding does not keep the winding-number tree: each call rebuilds it
        numbers = np.atleast_1d(igl.fast_winding_number(surface.vertices, surface.triangles, points))
        depths, outward, inside = np.full(len(points), -1.0), np.zeros((len(points), 3)), numbers > 0.5
        if inside.any():
            asked = np.ascontiguousarray(points[inside])
            squared, _, closest = field.squared_distance(surface.vertices, surface.triangles, asked)
            depths[inside] = np.sqrt(squared)
            outward[inside] = (np.atleast_2d(closest) - asked) / np.maximum(depths[inside], 1e-12)[:, None]
        return depths, outward


class Grid(VertexDistances):
    """Signed distances and their gradient on a grid around each fragment, interpolated linearly."""

    name = f"grids {CELLS}^3"
    is_quick = False

    def make_field(self, surface: Surface) -> RegularGridInterpolator:
        low, high = surface.vertices.min(axis=0) - PADDING, surface.vertices.max(axis=0) + PADDING
        axes = np.linspace(low, high, CELLS).T
        points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        signed = igl.signed_distance(points, surface.vertices, surface.triangles, SIGNED)[0].reshape((CELLS,) * 3)
        values = np.stack([signed, *np.gradient(signed, *axes)], axis=-1)
        return RegularGridInterpolator(axes, values, bounds_error=False, fill_value=1.0)

    def depths(self, surface: Surface, field, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        values = field(points)
        return -values[:, 0], values[:, 1:] / np.maximum(np.linalg.norm(values[:, 1:], axis=1), 1e-9)[:, None]


class NodeField(Method):
    """The full exact field, recomputed: each node's signed distance to its fragment's surface. Has an update only."""

    name = "exact field at nodes (libigl)"
    answers = False

    def update(self, world: World, before) -> list[np.ndarray]:
        return [
            igl.signed_distance(f.nodes, f.mesh.vertices, f.mesh.triangles, SIGNED)[0] for f in world.fragments
        ]  # fmt: skip


def methods() -> list[Method]:
    return [Exact(), Grid(), NodeField()]

"""Fragments as binary glTF 2.0, which browsers load directly: a glazed outside, and cracks of another material.

General writers support one material or vertex colours, not both, and a fragment needs a rough crack beside its smooth
outside. The reader recomputes normals from the corners that triangles share. So corners are shared where the surface is
smooth, and never on cracks, whose facets are then shaded one by one.
"""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fracture_collision.geometry.unique_rows import unique_rows
from fracture_collision.viewer.pictures.body_mesh import BodyMesh
from fracture_collision.viewer.pictures.palette import Paint

ROUGHNESS = ((0.5, 0.18), (0.2, 0.32), (0.0, 0.75))  # by least shine of a paint
CRACK_ROUGHNESS = 1.0
GRAIN = 0.22  # share of a crack's brightness that varies from corner to corner
_STEPS = 255  # normals that agree when rounded to 1/255 belong to one smooth surface

# Numbers of the glTF 2.0 specification.
_FLOAT, _UINT32, _UINT8 = 5126, 5125, 5121
_MAGIC, _VERSION, _JSON, _BIN = 0x46546C67, 2, 0x4E4F534A, 0x004E4942


class Surface(NamedTuple):
    """What a material does with light."""

    roughness: float  # 0..1
    is_metal: bool = False


def glb_of_mesh(mesh: BodyMesh, paint: Paint) -> bytes:
    """The whole file, with a mesh of up to two primitives: outside and crack, if present."""
    file = GltfFile()
    number = file.add_mesh(mesh, paint)
    return file.bytes([] if number is None else [file.add_node({"mesh": number})])


def _smooth_corners(triangles: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners (n, 3) and indices (3 t,): corners with the same place and normal are merged."""
    corners = triangles.reshape(-1, 3)
    steps = np.round(_STEPS * normals.reshape(-1, 3))
    chosen, index = unique_rows(np.column_stack((corners, steps)))
    return corners[chosen], index


class GltfFile:
    """Collects meshes, nodes and their movements, and the arrays that describe them."""

    def __init__(self) -> None:
        self._data: list[bytes] = []
        self._size = 0
        self._views: list[dict] = []
        self._accessors: list[dict] = []
        self._materials: list[dict] = []
        self._meshes: list[dict] = []
        self._nodes: list[dict] = []
        self._samplers: list[dict] = []
        self._channels: list[dict] = []
        self._times: dict[bytes, int] = {}  # accessors of equal times are shared

    def add_mesh(self, mesh: BodyMesh, paint: Paint) -> int | None:
        """The number of the mesh; None if it has no triangles."""
        primitives = []
        outside, crack = ~mesh.is_crack, mesh.is_crack
        if outside.any():
            corners, index = _smooth_corners(mesh.triangles[outside], mesh.normals[outside])
            roughness = next(rough for shine, rough in ROUGHNESS if paint.shine >= shine)
            primitives.append(self._primitive(corners, index, paint.outside, Surface(roughness, paint.is_metal)))
        if crack.any():
            corners = mesh.triangles[crack].reshape(-1, 3)
            grain = 1.0 - GRAIN * np.random.default_rng(len(corners)).random(len(corners))
            index = np.arange(len(corners))
            primitives.append(self._primitive(corners, index, paint.crack, Surface(CRACK_ROUGHNESS), grain))
        if not primitives:
            return None
        self._meshes.append({"primitives": primitives})
        return len(self._meshes) - 1

    def add_node(self, node: dict[str, Any]) -> int:
        """The number of a node with these fields of glTF: name, mesh, translation, rotation, children."""
        self._nodes.append(node)
        return len(self._nodes) - 1

    def move(self, node: int, path: str, times: np.ndarray, values: np.ndarray, steps: bool = False) -> None:
        """Let a node's translation (n, 3), rotation (n, 4) x y z w or scale (n, 3) have `values` at `times` (n,) [s].

        Between two times it is interpolated, or with `steps` keeps the earlier value.
        """
        times, values = times.astype("<f4"), values.astype("<f4")
        if times.tobytes() not in self._times:
            bounds = {"min": [float(times[0])], "max": [float(times[-1])]}
            self._times[times.tobytes()] = self._add(times, _FLOAT, "SCALAR", bounds)
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append(
            {
                "input": self._times[times.tobytes()],
                "output": self._add(values, _FLOAT, f"VEC{values.shape[1]}", {}),
                "interpolation": "STEP" if steps else "LINEAR",
            }
        )

    def bytes(self, roots: Sequence[int]) -> bytes:
        """The file; `roots`: the nodes that are in the scene, with their children."""
        description: dict[str, Any] = {
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(roots)} if roots else {}],
        }  # fmt: skip
        if self._size:
            description["buffers"] = [{"byteLength": self._size}]
        for name, entries in (
            ("nodes", self._nodes), ("meshes", self._meshes), ("materials", self._materials),
            ("accessors", self._accessors), ("bufferViews", self._views),
        ):  # fmt: skip
            if entries:
                description[name] = entries
        if self._channels:
            description["animations"] = [{"channels": self._channels, "samplers": self._samplers}]
        text = json.dumps(description, separators=(",", ":")).encode()
        chunks = [(_JSON, text + b" " * (-len(text) % 4))]
        if self._size:
            chunks.append((_BIN, b"".join(self._data)))
        body = b"".join(struct.pack("<II", len(chunk), kind) + chunk for kind, chunk in chunks)
        return struct.pack("<III", _MAGIC, _VERSION, 12 + len(body)) + body

    def _primitive(
        self,
        corners: np.ndarray,
        index: np.ndarray,
        colour: tuple[float, float, float],
        surface: Surface,
        brightness: np.ndarray | None = None,
    ) -> dict:
        """`colour`: linear RGB; `brightness` (n,): its factor at each corner."""
        corners = corners.astype("<f4")
        columns = np.ascontiguousarray(corners.T)  # along rows numpy's minimum takes ten times as long
        bounds = {"min": columns.min(axis=1).tolist(), "max": columns.max(axis=1).tolist()}
        attributes = {"POSITION": self._add(corners, _FLOAT, "VEC3", bounds)}
        if brightness is not None:
            rgba = np.full((len(corners), 4), 255, dtype=np.uint8)
            rgba[:, :3] = np.round(255.0 * brightness)[:, None]
            attributes["COLOR_0"] = self._add(rgba, _UINT8, "VEC4", {"normalized": True})
        material = {
            "baseColorFactor": [*colour, 1.0], "metallicFactor": float(surface.is_metal),
            "roughnessFactor": surface.roughness,
        }  # fmt: skip
        self._materials.append({"pbrMetallicRoughness": material})
        return {
            "attributes": attributes,
            "indices": self._add(index.astype("<u4"), _UINT32, "SCALAR", {}),
            "material": len(self._materials) - 1,
        }

    def _add(self, array: np.ndarray, component: int, kind: str, more: dict) -> int:
        """All arrays have elements of a multiple of four bytes, so their offsets are aligned to four bytes."""
        data = np.ascontiguousarray(array).tobytes()
        self._views.append({"buffer": 0, "byteOffset": self._size, "byteLength": len(data)})
        self._accessors.append(
            {
                "bufferView": len(self._views) - 1,
                "componentType": component,
                "count": len(array),
                "type": kind,
                **more,
            }
        )
        self._data.append(data)
        self._size += len(data)
        return len(self._accessors) - 1

"""A fragment's mesh as binary glTF 2.0, which browsers load directly: a glazed outside, and cracks of another material.

General writers support one material or vertex colours, not both, and a fragment needs a rough crack beside its smooth
outside. The reader recomputes normals from the corners that triangles share. So corners are shared where the surface is
smooth, and never on cracks, whose facets are then shaded one by one.
"""

from __future__ import annotations

import json
import struct
from typing import NamedTuple

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
    file = _File()
    outside, crack = ~mesh.is_crack, mesh.is_crack
    if outside.any():
        corners, index = _smooth_corners(mesh.triangles[outside], mesh.normals[outside], mesh.places[outside])
        roughness = next(rough for shine, rough in ROUGHNESS if paint.shine >= shine)
        file.add_primitive(corners, index, paint.outside, Surface(roughness, paint.is_metal), None)
    if crack.any():
        corners = mesh.triangles[crack].reshape(-1, 3)
        grain = 1.0 - GRAIN * np.random.default_rng(len(corners)).random(len(corners))
        file.add_primitive(corners, np.arange(len(corners)), paint.crack, Surface(CRACK_ROUGHNESS), grain)
    return file.bytes()


def _smooth_corners(
    triangles: np.ndarray, normals: np.ndarray, places: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Corners (n, 3) and indices (3 t,): corners with the same place and normal are merged."""
    steps = np.round(_STEPS * normals.reshape(-1, 3))
    chosen, index = unique_rows(np.column_stack((places.ravel(), steps)))
    return triangles.reshape(-1, 3)[chosen], index


class _File:
    """Collects arrays and their descriptions in the file."""

    def __init__(self) -> None:
        self._data: list[bytes] = []
        self._size = 0
        self._views: list[dict] = []
        self._accessors: list[dict] = []
        self._materials: list[dict] = []
        self._primitives: list[dict] = []

    def add_primitive(
        self,
        corners: np.ndarray,
        index: np.ndarray,
        colour: tuple[float, float, float],
        surface: Surface,
        brightness: np.ndarray | None,
    ) -> None:
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
        self._primitives.append(
            {
                "attributes": attributes,
                "indices": self._add(index.astype("<u4"), _UINT32, "SCALAR", {}),
                "material": len(self._materials),
            }
        )
        self._materials.append({"pbrMetallicRoughness": material})

    def bytes(self) -> bytes:
        description = {
            "asset": {"version": "2.0"},
            "scene": 0,
            "scenes": [{"nodes": [0] if self._primitives else []}],
            "buffers": [{"byteLength": self._size}] if self._size else [],
        }
        if self._primitives:
            description |= {
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": self._primitives}],
                "materials": self._materials,
                "accessors": self._accessors,
                "bufferViews": self._views,
            }
        else:
            del description["buffers"]
        text = json.dumps(description, separators=(",", ":")).encode()
        chunks = [(_JSON, text + b" " * (-len(text) % 4)), (_BIN, b"".join(self._data))]
        body = b"".join(struct.pack("<II", len(chunk), kind) + chunk for kind, chunk in chunks)
        return struct.pack("<III", _MAGIC, _VERSION, 12 + len(body)) + body

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

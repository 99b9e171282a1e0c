"""The messages of msg/*.msg as plain numpy records: what all folders exchange, with or without ROS.

Fields are named and shaped as in the messages (flat arrays, SI units, frames and signs as written there), less
`header` and `run_id`. Nothing is validated here: `world/gates` does that.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

ADD = 0
REMOVE = 1
BUDGET_EXHAUSTED = 1
INVALID_STATES = 2


def _floats(n: int = 0) -> np.ndarray:
    return np.zeros(n, dtype=np.float64)


def _indices(n: int = 0) -> np.ndarray:
    return np.zeros(n, dtype=np.uint32)


class SolidPrimitive(NamedTuple):
    """shape_msgs/SolidPrimitive: BOX with dimensions (x, y, z) [m] edge lengths, SPHERE with (radius,) [m]; 0: none."""

    type: int = 0
    dimensions: tuple[float, ...] = ()


BOX = 1
SPHERE = 2


class CollisionBody(NamedTuple):
    """One body before any fracture (CollisionBody.msg)."""

    body_id: int
    fragment_id: int
    operation: int = ADD
    name: str = ""
    primitive: SolidPrimitive = SolidPrimitive()
    plane: np.ndarray = _floats(4)  # a x + b y + c z + d = 0, solid where negative; all 0: none
    vertices: np.ndarray = _floats()  # 3n [m], body frame
    triangles: np.ndarray = _indices()  # 3t, closed, seen counter-clockwise from outside
    tetrahedra: np.ndarray = _indices()  # 4m, positive volume; empty: rigid, cannot break
    is_static: bool = False
    density: float = 1000.0  # [kg/m3]
    friction: float = 0.5  # Coulomb coefficient
    restitution: float = 0.0  # 0..1


class FractureEvent(NamedTuple):
    """The instantaneous fracture of one fragment, in the body frame (FractureEvent.msg)."""

    sequence: int
    body_id: int
    fragment_id: int
    new_fragment_ids: np.ndarray
    nodes: np.ndarray  # every tet-mesh node of the breaking fragment, once
    node_fragments: np.ndarray  # for each, an index into new_fragment_ids
    cut_edges: np.ndarray  # 2k node indices
    cut_planes: np.ndarray  # 4k: unit normal from first node to second, offset: n.x = offset


class FragmentStates(NamedTuple):
    """Poses and velocities of the fragments at one step (FragmentStates.msg)."""

    step: int
    fracture_sequence: int
    fragment_ids: np.ndarray
    positions: np.ndarray  # 3n [m], of the body frame of each fragment, in the world
    orientations: np.ndarray  # 4n, unit quaternions x y z w, body frame to world
    linear_velocities: np.ndarray = _floats()  # 3n [m/s], of that frame's origin; empty: zero
    angular_velocities: np.ndarray = _floats()  # 3n [rad/s], world axes; empty: zero


class ContactConstraintArray(NamedTuple):
    """The answer to one FragmentStates (ContactConstraintArray.msg)."""

    step: int
    fracture_sequence: int
    status: int
    fragment_a: np.ndarray  # ascending by (a, b), a < b
    fragment_b: np.ndarray
    pair_begin: np.ndarray  # pairs + 1
    missed_depth_bound: np.ndarray  # [m]
    friction: np.ndarray
    restitution: np.ndarray
    points_a: np.ndarray  # 3N [m], world
    points_b: np.ndarray  # 3N [m], world
    normals: np.ndarray  # 3N, unit, from a to b
    gaps: np.ndarray  # N [m] = normal . (point_b - point_a); negative: penetration; large: a touch to come
    contact_ids: np.ndarray  # uint64


def refusal_of(states: FragmentStates) -> ContactConstraintArray:
    """The answer to invalid states: no contacts, and the status INVALID_STATES."""
    floats, ids = _floats(), _indices()
    return ContactConstraintArray(
        step=states.step, fracture_sequence=states.fracture_sequence, status=INVALID_STATES,
        fragment_a=ids, fragment_b=ids, pair_begin=_indices(1), missed_depth_bound=floats,
        friction=floats, restitution=floats, points_a=floats, points_b=floats, normals=floats, gaps=floats,
        contact_ids=np.zeros(0, dtype=np.uint64),
    )  # fmt: skip


class FragmentRegistry(NamedTuple):
    """All living fragments after `fracture_sequence` events (FragmentRegistry.msg)."""

    fracture_sequence: int
    fragment_ids: np.ndarray
    body_ids: np.ndarray
    parent_ids: np.ndarray
    masses: np.ndarray  # [kg]
    centers_of_mass: np.ndarray  # 3n [m], body frame
    inertias: np.ndarray  # 6n [kg m2], about the centre of mass, body axes: xx xy xz yy yz zz
    sampling_gaps: np.ndarray  # [m]
    digest: str


class FragmentMesh(NamedTuple):
    """One fragment's surface for viewers (FragmentMesh.msg)."""

    fragment_id: int
    vertices: np.ndarray  # float32 3n [m], body frame
    triangles: np.ndarray  # 3t
    is_crack: np.ndarray  # t

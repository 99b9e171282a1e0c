"""Surface kinds of fragments, and what a fragment of a kind has.

A search asks for what it needs (`has_faces`, `is_bounded`, `is_mesh`), not for kinds. Only the elementary operations
choose by kind how they compute: the probe (field/elementary_queries.py), the sphere's contacts, a sample's own normal
(contacts/facing_normal.py), hulls, ridges and surface elements.
"""

from __future__ import annotations

from fracture_collision.core.memory.compiled import query_kernel

PLANE = 0
SPHERE = 1
BOX = 2
TETRAHEDRA = 3
TRIANGLES = 4
WITH_FACES, MESHES = (BOX, TETRAHEDRA, TRIANGLES), (TETRAHEDRA, TRIANGLES)


@query_kernel
def is_bounded(kind):
    """Whether a fragment has a finite box."""
    return kind != PLANE


@query_kernel
def has_faces(kind):
    """Whether a fragment has flat faces, edges between them, and samples whose hull contains its surface."""
    return kind in WITH_FACES


@query_kernel
def is_mesh(kind):
    """Whether queries search a mesh, and are slow: other kinds have a closed form."""
    return kind in MESHES

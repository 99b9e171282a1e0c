"""Points carried from one fragment's frame to another's."""

from __future__ import annotations

from fracture_collision.core.compiled import inlined_kernel


@inlined_kernel
def rotated(rotation, x, y, z):
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@inlined_kernel
def to_other(rotation, translation, x, y, z):
    """rotation (3, 3) applied, then translation (3,)."""
    x, y, z = rotated(rotation, x, y, z)
    return x + translation[0], y + translation[1], z + translation[2]

"""Transforms of points between fragment frames."""

from __future__ import annotations

from fracture_collision.core.memory.compiled import query_kernel


@query_kernel
def rotated(rotation, x, y, z):
    """Apply rotation (3, 3) to (x, y, z)."""
    return (
        rotation[0, 0] * x + rotation[0, 1] * y + rotation[0, 2] * z,
        rotation[1, 0] * x + rotation[1, 1] * y + rotation[1, 2] * z,
        rotation[2, 0] * x + rotation[2, 1] * y + rotation[2, 2] * z,
    )


@query_kernel
def to_other(rotation, translation, x, y, z):
    """Apply rotation (3, 3), then translation (3,) [m] to the point (x, y, z)."""
    x, y, z = rotated(rotation, x, y, z)
    return x + translation[0], y + translation[1], z + translation[2]


@query_kernel
def turned_back(rotation, x, y, z):
    """Apply the inverse of rotation (3, 3) to (x, y, z)."""
    return (
        rotation[0, 0] * x + rotation[1, 0] * y + rotation[2, 0] * z,
        rotation[0, 1] * x + rotation[1, 1] * y + rotation[2, 1] * z,
        rotation[0, 2] * x + rotation[1, 2] * y + rotation[2, 2] * z,
    )


@query_kernel
def relative_pose(rotation_from, position_from, rotation_to, position_to, rotation, translation):
    """Write the pose from one fragment's body frame to another's to rotation (3, 3) and translation (3,) [m].

    rotation_from, position_from, rotation_to, position_to: world poses of the two fragments.
    """
    for i in range(3):
        translation[i] = 0.0
        for k in range(3):
            translation[i] += rotation_to[k, i] * (position_from[k] - position_to[k])
        for j in range(3):
            rotation[i, j] = (
                rotation_to[0, i] * rotation_from[0, j]
                + rotation_to[1, i] * rotation_from[1, j]
                + rotation_to[2, i] * rotation_from[2, j]
            )


@query_kernel
def put_rotation(x, y, z, w, out):
    """Write the rotation matrix (3, 3) of a quaternion of any length."""
    s = 2.0 / (x * x + y * y + z * z + w * w)
    out[0, 0] = 1.0 - s * (y * y + z * z)
    out[0, 1] = s * (x * y - z * w)
    out[0, 2] = s * (x * z + y * w)
    out[1, 0] = s * (x * y + z * w)
    out[1, 1] = 1.0 - s * (x * x + z * z)
    out[1, 2] = s * (y * z - x * w)
    out[2, 0] = s * (x * z - y * w)
    out[2, 1] = s * (y * z + x * w)
    out[2, 2] = 1.0 - s * (x * x + y * y)

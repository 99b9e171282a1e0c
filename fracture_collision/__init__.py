"""Collision detection for fracturing rigid bodies, as a ROS 2 service and as a Python library.

The public Python API is `fracture_collision.world` (CollisionWorld, the messages as records, Settings),
`fracture_collision.fracture` (voronoi, planes, labels) and `fracture_collision.meshing` (read_mesh).
"""

from pkgutil import extend_path

__all__ = ["__version__", "fracture", "meshing", "world"]
__version__ = "0.1.0"

# Working from a source tree, the generated half of this package (fracture_collision.msg) is installed elsewhere.
__path__ = extend_path(__path__, __name__)

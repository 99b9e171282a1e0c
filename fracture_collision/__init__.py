"""Collision detection for fracturing rigid bodies, as a ROS 2 service and as a Python library."""

from pkgutil import extend_path

__version__ = "0.1.0"

# Working from a source tree, the generated half of this package (fracture_collision.msg) is installed elsewhere.
__path__ = extend_path(__path__, __name__)

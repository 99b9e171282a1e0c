"""What to say where ROS is not installed: the library works without it, nodes do not."""

from __future__ import annotations

REMEDY = (
    "ROS 2 (rclpy and this package's messages), which is not installed: `pip install '.[ros]'` in a checkout, or source"
    " a ROS 2 Jazzy workspace that has this package"
)
_PACKAGES = ("rclpy", "builtin_interfaces", "rcl_interfaces", "rosidl_parser", "rpyutils")


def is_ros_missing(error: ModuleNotFoundError) -> bool:
    """Whether the module that was not found comes with ROS, or is this package's messages."""
    module = error.name or ""
    package = module.split(".")[0]
    return package in _PACKAGES or package.endswith("_msgs") or module == "fracture_collision.msg"

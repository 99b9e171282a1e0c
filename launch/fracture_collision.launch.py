"""Starts the collision service and the simulator.

ros2 launch fracture_collision fracture_collision.launch.py scene:=plates seed:=1

They communicate on this machine only, unless discovery_range:=SUBNET or the variable ROS_AUTOMATIC_DISCOVERY_RANGE
widens the range.
"""

from __future__ import annotations

from launch import LaunchDescription

from fracture_collision.ros.runs.launch_parts import arguments, collision_node, node, text, whole


def generate_launch_description() -> LaunchDescription:
    """Both nodes in one namespace; when either of them ends, both end."""
    return LaunchDescription(
        [
            *arguments(),
            collision_node(),
            node("simulator_node", {"scene": text("scene"), "seed": whole("seed")}),
        ]
    )

"""Starts a live scene: the collision service, the live simulator and the page in the browser.

page_node prints the page's address.

ros2 launch fracture_collision play.launch.py scene:=plates port:=8080

They communicate on this machine only, unless discovery_range:=SUBNET or the variable ROS_AUTOMATIC_DISCOVERY_RANGE
widens the range; the page is served to this machine only, unless host:=0.0.0.0.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument

from fracture_collision.ros.runs.launch_parts import arguments, collision_node, node, text, whole


def generate_launch_description() -> LaunchDescription:
    """All nodes in one namespace; when any of them ends, all end."""
    return LaunchDescription(
        [
            *arguments(),
            DeclareLaunchArgument("host", default_value="127.0.0.1", description="address of the page"),
            DeclareLaunchArgument("port", default_value="0", description="port of the page; 0: any free one"),
            DeclareLaunchArgument("folder", default_value="out/play", description="folder of recordings and uploads"),
            collision_node(),
            node("live_simulator_node", {"scene": text("scene"), "seed": whole("seed"), "folder": text("folder")}),
            node(
                "page_node",
                {"scene": text("scene"), "host": text("host"), "port": whole("port"), "folder": text("folder")},
            ),
        ]
    )

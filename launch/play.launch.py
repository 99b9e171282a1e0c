"""Starts a scene to smash: the collision service, the live simulator and the page in the browser, whose address the
page's node prints.

ros2 launch fracture_collision play.launch.py scene:=plates port:=8080

They speak on this machine only, unless discovery_range:=SUBNET or the variable ROS_AUTOMATIC_DISCOVERY_RANGE says more;
the page is served to this machine only, unless host:=0.0.0.0.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """All nodes in one namespace; the end of any is the end of all."""
    default_parameters = PathJoinSubstitution([FindPackageShare("fracture_collision"), "config", "collision.yaml"])

    def text(name: str) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=str)

    def whole(name: str) -> ParameterValue:
        return ParameterValue(LaunchConfiguration(name), value_type=int)

    def node(executable: str, *parameters: object) -> Node:
        return Node(
            package="fracture_collision",
            executable=executable,
            namespace=LaunchConfiguration("namespace"),
            parameters=list(parameters),
            output="screen",
            on_exit=Shutdown(),
        )

    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value="plates", description="name in config/scenes, or a path"),
            DeclareLaunchArgument("seed", default_value="-1", description="of fracture patterns; -1: the scene's"),
            DeclareLaunchArgument("host", default_value="127.0.0.1", description="address where the page is served"),
            DeclareLaunchArgument("port", default_value="0", description="of the page; 0: any that is free"),
            DeclareLaunchArgument("folder", default_value="out/play", description="where recordings go"),
            DeclareLaunchArgument("namespace", default_value="", description="put before every topic"),
            DeclareLaunchArgument(
                "parameters", default_value=default_parameters, description="of the service, a parameter file"
            ),
            DeclareLaunchArgument(
                "discovery_range",
                default_value=EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
                choices=["LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"],
                description="who may find the nodes",
            ),
            SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery_range")),
            node("collision_node", LaunchConfiguration("parameters")),
            node("live_simulator_node", {"scene": text("scene"), "seed": whole("seed")}),
            node(
                "page_node",
                {"scene": text("scene"), "host": text("host"), "port": whole("port"), "folder": text("folder")},
            ),
        ]
    )

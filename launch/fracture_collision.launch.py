"""Starts the collision service and the simulator:

ros2 launch fracture_collision fracture_collision.launch.py scene:=plates seed:=1

They speak on this machine only, unless discovery_range:=SUBNET or the variable ROS_AUTOMATIC_DISCOVERY_RANGE says more.
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """Both nodes in one namespace; the simulator's end is the end of all."""
    default_parameters = PathJoinSubstitution([FindPackageShare("fracture_collision"), "config", "collision.yaml"])
    namespace = LaunchConfiguration("namespace")
    return LaunchDescription(
        [
            DeclareLaunchArgument("scene", default_value="plates", description="name in config/scenes, or a path"),
            DeclareLaunchArgument("seed", default_value="-1", description="of fracture patterns; -1: the scene's"),
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
            Node(
                package="fracture_collision",
                executable="collision_node",
                namespace=namespace,
                parameters=[LaunchConfiguration("parameters")],
                output="screen",
            ),
            Node(
                package="fracture_collision",
                executable="simulator_node",
                namespace=namespace,
                parameters=[
                    {
                        "scene": ParameterValue(LaunchConfiguration("scene"), value_type=str),
                        "seed": ParameterValue(LaunchConfiguration("seed"), value_type=int),
                    }
                ],
                output="screen",
                on_exit=Shutdown(),
            ),
        ]
    )

"""Shared parts of the launch files: their arguments, and a node as they start it.

Needs ROS's launch, which is not a wheel: only launch/ imports this.
"""

from __future__ import annotations

from typing import Any

from launch.actions import DeclareLaunchArgument, SetEnvironmentVariable, Shutdown
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

PACKAGE = "fracture_collision"


def arguments() -> list[DeclareLaunchArgument | SetEnvironmentVariable]:
    """Arguments of every launch file, and what they set for all nodes."""
    default_parameters = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "collision.yaml"])
    return [
        DeclareLaunchArgument("scene", default_value="plates", description="name in config/scenes, or a path"),
        DeclareLaunchArgument("seed", default_value="-1", description="seed of fracture patterns; -1: the scene's"),
        DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes"),
        DeclareLaunchArgument(
            "parameters", default_value=default_parameters, description="parameter file of the service"
        ),
        DeclareLaunchArgument(
            "discovery_range",
            default_value=EnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", default_value="LOCALHOST"),
            choices=["LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"],
            description="range within which others discover the nodes",
        ),
        SetEnvironmentVariable("ROS_AUTOMATIC_DISCOVERY_RANGE", LaunchConfiguration("discovery_range")),
    ]


def collision_node() -> Node:
    """The collision service with the requested parameter file."""
    return node("collision_node", LaunchConfiguration("parameters"))


def node(executable: str, parameters: Any) -> Node:
    """A node of this package in the requested namespace. When it ends, all others end too: none is of use alone."""
    return Node(
        package=PACKAGE,
        executable=executable,
        namespace=LaunchConfiguration("namespace"),
        parameters=[parameters],
        output="screen",
        on_exit=Shutdown(),
    )


def text(name: str) -> ParameterValue:
    """A launch argument as a parameter: what looks like a number stays text."""
    return ParameterValue(LaunchConfiguration(name), value_type=str)


def whole(name: str) -> ParameterValue:
    """A launch argument as a parameter of type integer."""
    return ParameterValue(LaunchConfiguration(name), value_type=int)

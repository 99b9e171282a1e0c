"""Collision detection for fracturing rigid bodies, as a ROS 2 service and as a Python library."""

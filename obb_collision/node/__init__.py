"""The ROS 2 side: the only package of the project that imports ROS."""

from obb_collision.node.clouds import (
    NamedPair,
    collisions_from_ros,
    collisions_to_ros,
    named_pairs,
    poses_from_ros,
    poses_to_ros,
)

__all__ = [
    "NamedPair",
    "collisions_from_ros",
    "collisions_to_ros",
    "named_pairs",
    "poses_from_ros",
    "poses_to_ros",
]

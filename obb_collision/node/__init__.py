"""The ROS 2 side: the only package of the project that imports ROS.

The public names load when first used, so that a console script can say in a line that ROS is
missing instead of failing on its way in.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
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


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(import_module("obb_collision.node.clouds"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")

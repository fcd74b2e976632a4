# Copyright 2026 The obb_collision developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What the node uses of tf2_ros, for machines without it: the same names, the same answers.

One level of frames only: each transform is stored by its child frame, and looked up in its parent.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.time import Time

from obb_collision.node.messages.conversions import (
    stamp_from_ros,
    transform_from_ros,
    transform_to_ros,
)


class TransformException(Exception):  # noqa: N818 - tf2's name
    """Whatever makes a lookup fail."""


class LookupException(TransformException):
    """A frame is not known."""


class ConnectivityException(TransformException):
    """Both frames are known, but nothing connects them."""


class InvalidArgumentException(TransformException):
    """A name that can't be a frame's."""


class ExtrapolationException(TransformException):
    """A frame is known, but not at this time."""


class Buffer:
    """Keeps transforms, and interpolates between them."""

    def __init__(self, cache_time: Any = None, node: Node | None = None) -> None:
        self._poses: dict[tuple[str, str], dict[int, Any]] = {}

    def set_transform(self, transform: TransformStamped, authority: str) -> None:
        """Take in one transform."""
        names = transform.header.frame_id, transform.child_frame_id
        poses = self._poses.setdefault(names, {})
        poses[stamp_from_ros(transform.header.stamp)] = transform_from_ros(transform.transform)

    def lookup_transform(self, target: str, source: str, time: Time) -> TransformStamped:
        """Return the pose of source in target; time 0 is the latest known."""
        poses = self._poses.get((target, source))
        if poses is None:
            if {target, source} <= {name for names in self._poses for name in names}:
                raise ConnectivityException(f"{source!r} and {target!r} are not connected")
            raise LookupException(f"{source!r} or {target!r} does not exist")
        stamps = sorted(poses)
        at = time.nanoseconds or stamps[-1]
        if not stamps[0] <= at <= stamps[-1]:
            raise ExtrapolationException(f"{at} is outside of {stamps[0]} to {stamps[-1]}")
        numbers = np.array([poses[stamp] for stamp in stamps])
        pose = [np.interp(at, stamps, column) for column in numbers.T]
        return TransformStamped(transform=transform_to_ros(pose))


class TransformListener:
    """Takes in transforms by set_transform of its buffer only."""

    def __init__(self, buffer: Buffer, node: Node, *, spin_thread: bool = False) -> None:
        self.buffer = buffer

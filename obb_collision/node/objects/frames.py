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

"""Where a frame is, seen from the fixed frame: with tf2 any frame, without it the fixed one."""

from __future__ import annotations

from typing import Any, Protocol

from rclpy.node import Node
from rclpy.time import Time

from obb_collision.node.messages.conversions import transform_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.optional import optional_module, optional_type
from obb_collision.typing import Floats

tf2_ros: Any = optional_type("tf2_msgs.msg", "TFMessage") and optional_module("tf2_ros")
"""None where tf2 cannot be used."""

UNKNOWN_FRAME, NO_TRANSFORM, EXTRAPOLATION = "unknown frame", "no transform", "extrapolation"
"""Reasons why a frame can't be placed: no transform names it, nothing connects it with the fixed
frame, or its known transforms do not cover the stamp."""

LINK_NOT_KNOWN = "link not known"
"""Reason: a frame is that of a link, and its robot is not known (yet)."""

LATER = (UNKNOWN_FRAME, NO_TRANSFORM, EXTRAPOLATION)
"""What may be otherwise later on."""


class FrameSource(Protocol):
    """Looks up frames other than the fixed frame."""

    waits: bool
    """Whether a frame unknown now may be known later."""
    description: str
    """For the log: what frames are accepted."""

    def lookup(self, frame: str, stamp: int) -> Floats:
        """Pose (7,) of ``frame`` in the fixed frame at ``stamp`` (ns; 0 is the latest known).

        Raises RefusedError where it isn't known (yet): "unknown frame", "no transform" between the
        two, "extrapolation" where the stamp is later or earlier than what is known.
        """
        ...


class FixedFrameOnly:
    """Without tf2: no frame but the fixed one."""

    waits = False

    def __init__(self, fixed_frame: str) -> None:
        self._fixed_frame = fixed_frame
        self.description = "fixed frame only (no tf2_ros here)"

    def lookup(self, frame: str, stamp: int) -> Floats:
        """Refuse every frame."""
        raise RefusedError(UNKNOWN_FRAME, f"{frame!r} is not {self._fixed_frame!r}; no tf2 here")


def reason_from_tf2(error: Exception, tf2: Any) -> str:
    """Return under which reason a TransformException of the module ``tf2`` is counted."""
    if isinstance(error, tf2.ExtrapolationException):
        return EXTRAPOLATION
    if isinstance(error, (tf2.LookupException, tf2.InvalidArgumentException)):
        return UNKNOWN_FRAME
    return NO_TRANSFORM


class TfFrames:
    """Frames by tf2, listening on the node's own executor."""

    waits = True
    description = "tf2"

    def __init__(self, node: Node, fixed_frame: str) -> None:
        self._fixed_frame = fixed_frame
        self._buffer: Any = tf2_ros.Buffer(node=node)
        self._listener: Any = tf2_ros.TransformListener(self._buffer, node, spin_thread=False)

    def lookup(self, frame: str, stamp: int) -> Floats:
        """Pose of ``frame`` from the tf2 buffer, without waiting."""
        try:
            found = self._buffer.lookup_transform(self._fixed_frame, frame, Time(nanoseconds=stamp))
        except tf2_ros.TransformException as error:
            raise RefusedError(reason_from_tf2(error, tf2_ros), str(error)) from error
        return transform_from_ros(found.transform)


def make_frames(node: Node, fixed_frame: str) -> FrameSource:
    """Frames by tf2 where it is installed, else the fixed frame only."""
    return FixedFrameOnly(fixed_frame) if tf2_ros is None else TfFrames(node, fixed_frame)

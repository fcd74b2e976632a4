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

"""The node's process of an attack, with stand-ins for tf2 and vision_msgs where not installed.

The stand-in for tf2 also stores values that are not finite, which tf2 would refuse: they reach the
node's own checks. Detections come as bytes under the name of another type.
"""

from __future__ import annotations

import sys
from collections import deque
from importlib.util import find_spec
from typing import Any

from geometry_msgs.msg import TransformStamped
from rclpy.node import Node
from rclpy.qos import QoSProfile

from obb_collision.node import node as node_module
from obb_collision.node.inputs import detections
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.conversions import NANOSECONDS, transform_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION, UNKNOWN_FRAME
from obb_collision.typing import Floats
from tools.fuzz.messages import TYPE

TF_TOPICS = ("/tf", "/tf_static")
STORED = 100
"""Transforms stored per frame."""
MOST_FRAMES = 100


class StandInFrames:
    """Frames by messages of TransformStamped on the topics of tf, seen from the fixed frame."""

    waits = True
    description = "a stand-in for tf2"

    def __init__(self, node: Node, fixed_frame: str) -> None:
        self._frames: dict[str, deque[tuple[int, Floats]]] = {}
        for topic in TF_TOPICS:
            node.create_subscription(TransformStamped, topic, self._take, QoSProfile(depth=100))

    def _take(self, message: TransformStamped) -> None:
        name, stamp = message.child_frame_id, message.header.stamp
        if name in self._frames or len(self._frames) < MOST_FRAMES:
            stored = self._frames.setdefault(name, deque(maxlen=STORED))
            at = stamp.sec * NANOSECONDS + stamp.nanosec
            stored.append((at, transform_from_ros(message.transform)))

    def lookup(self, frame: str, stamp: int) -> tuple[Floats, int]:
        """Return the pose (7,) of a frame, the newest one up to a stamp (ns), and its stamp."""
        if frame not in self._frames:
            raise RefusedError(UNKNOWN_FRAME, f"{frame!r}")
        known = sorted(self._frames[frame], key=lambda pair: pair[0])
        if stamp and not known[0][0] <= stamp <= known[-1][0]:
            raise RefusedError(EXTRAPOLATION, f"{frame!r} at {stamp}")
        at, pose = [one for one in known if not stamp or one[0] <= stamp][-1]
        return pose, stamp or at


def main() -> int:
    """Run the node until SIGINT or SIGTERM."""
    if detections.MessageType is None:
        detections.MessageType = TYPE
        detections.INPUTS = {detections.DETECTIONS.topic: Input(TYPE, 10)}
    if find_spec("tf2_ros") is None:
        replaced: Any = node_module
        replaced.make_frames = StandInFrames
    return node_module.main(sys.argv[1:])


if __name__ == "__main__":
    raise SystemExit(main())

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

"""Look-alikes of detections: their bytes are those that the node reads, field by field."""

from __future__ import annotations

from pathlib import Path
from random import Random

import numpy as np
import pytest

pytest.importorskip("rclpy")
from geometry_msgs.msg import Vector3
from std_msgs.msg import Header

from obb_collision.node.inputs.detections import MessageType, detections_from_bytes
from obb_collision.node.messages.conversions import pose_to_ros, stamp_to_ros
from tools.fuzz.messages.look_alikes import (
    TYPE,
    Box,
    Detection,
    Detections,
    Hypothesis,
    Result,
    serialised,
)
from tools.fuzz.messages.messages import Messages


def test_every_field_is_in_its_place() -> None:
    header = Header(stamp=stamp_to_ros(3 * 10**9 + 5), frame_id="camera")
    poses = [[1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0], [4.0, 5.0, 6.0, 1.0, 0.0, 0.0, 0.0]]
    some = [
        Detection(header, [Result(Hypothesis(name, 0.5))] * count, Box(pose_to_ros(pose)), name)
        for pose, name, count in zip(poses, ("a", "track-7"), (0, 3), strict=True)
    ]
    some[1].bbox.size = Vector3(x=7.0, y=8.0, z=9.0)
    found = detections_from_bytes(serialised(Detections(header, some)), 2)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (3, 5)
    assert found.frames == {found.header.frame_id} == {"camera"}
    assert found.ids == ["a", "track-7"]
    np.testing.assert_array_equal(found.poses, poses)
    np.testing.assert_array_equal(found.sizes, [[0.0] * 3, [7.0, 8.0, 9.0]])


@pytest.mark.skipif(MessageType is None, reason="vision_msgs is not installed")
def test_vision_msgs_reads_the_same(tmp_path: Path) -> None:
    from rclpy.serialization import deserialize_message, serialize_message

    messages = Messages(Random(1), tmp_path)
    for _ in range(100):
        data = serialised(messages.detections())
        assert serialize_message(deserialize_message(data, TYPE)) == data

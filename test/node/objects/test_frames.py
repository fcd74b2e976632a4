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

"""Frames other than the fixed one."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("rclpy")
from fake_frames import FakeFrames
from rig import Rig, cube, pose
from visualization_msgs.msg import Marker

from obb_collision.node.objects import frames as frames_of_node

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
NAN = float("nan")


def in_frame(marker: Marker, frame: str) -> Marker:
    marker.header.frame_id = frame
    return marker


def test_poses_in_other_frames_are_placed_at_their_stamp() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["robot"] = [5.0, 0.0, 0.0, 0.0, 0.0, turn, turn]
    with Rig(frames) as rig:
        rig.send(cube(A1, (5, 2, 0)), in_frame(cube(A2, (1.5, 0, 0)), "robot"))
        assert rig.pairs() == {("a/1", "a/2")}
        assert ("robot", rig.stamp) in frames.asked
        frames.known["robot"][0] = 9.0
        rig.send_transform("a/1", pose(5, 2))
        assert rig.pairs() == {("a/1", "a/2")}, "not locked: stays where it was placed"
        rig.send_poses([2], [pose(1.5)], frame="robot")
        assert rig.pairs() == set()


def test_without_tf2_the_node_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames_of_node, "tf2_ros", None)
    with Rig(tf2=True) as rig:
        assert "fixed frame only" in rig.frames.description
        rig.send(in_frame(cube(A1), "nowhere"), cube(A2))
        rig.answer()
        assert rig.refused("objects") == {"unknown frame": 1}, "at once: no frame can come later"

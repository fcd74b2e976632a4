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

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
import tf2_stand_in
from fake_frames import FakeFrames
from geometry_msgs.msg import TransformStamped
from rig import FRAME, Rig, cube, pose
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from obb_collision.node import collisions_from_ros
from obb_collision.node.messages.conversions import stamp_to_ros, transform_to_ros
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


def test_frame_locked_objects_follow_their_frame() -> None:
    frames = FakeFrames()
    frames.known["robot"] = pose(5.0)
    with Rig(frames) as rig:
        rig.send(cube(A1), in_frame(cube(A2, frame_locked=True), "robot"))
        assert rig.pairs() == set()
        frames.known["robot"] = pose(0.5)
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 1, "followed")
        assert ("robot", 0) in frames.asked
        del frames.known["robot"]
        table = rig.node.objects.table
        rig.until(lambda: rig.node.objects.table.doubtful[table.slots[A2]], "doubt")
        assert len(collisions_from_ros(rig.next("collisions"))) == 1, "keeps its last box"


def test_an_object_whose_frame_is_not_known_yet_is_unplaceable_until_it_is() -> None:
    frames = FakeFrames()
    with Rig(frames, transform_timeout=0.0) as rig:
        rig.listen("/diagnostics")
        rig.send(cube(A1), in_frame(cube(A2), "late"))
        rig.until(lambda: rig.refused("objects") == {"unknown frame": 1}, "refusal")
        assert rig.status(": objects")["names unplaceable"] == "a/2"
        frames.known["late"] = pose(0.5)
        rig.until(lambda: len(collisions_from_ros(rig.next("collisions"))) == 1, "placed")
        assert rig.refused("objects") == {"unknown frame": 1}, "counted once"
        assert rig.status(": objects")["unplaceable"] == "0"


@pytest.fixture(params=["tf2", "stand-in"])
def tf2_ros(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Any:
    """tf2_ros as the node sees it: the real one where it is installed, and its stand-in."""
    if request.param == "tf2":
        return pytest.importorskip("tf2_ros", reason="tf2_ros is not installed (not on PyPI)")
    monkeypatch.setattr(frames_of_node, "tf2_ros", tf2_stand_in)
    return tf2_stand_in


def set_transform(rig: Rig, x: float, stamp: int) -> None:
    """Give the node a transform of the frame "robot"."""
    transform = TransformStamped(child_frame_id="robot", transform=transform_to_ros(pose(x)))
    transform.header = Header(stamp=stamp_to_ros(stamp), frame_id=FRAME)
    give(rig, transform)


def give(rig: Rig, transform: TransformStamped) -> None:
    """Give the node a transform, as tf2's listener does."""
    rig.frames._buffer.set_transform(transform, "test")


def test_with_tf2_poses_are_placed_at_their_stamp(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        assert rig.frames.description == "tf2"
        set_transform(rig, 2.0, rig.stamp)
        set_transform(rig, 4.0, rig.stamp + 2_000_000)  # the marker is of the middle
        rig.send(in_frame(cube(A2, (0.5, 0, 0)), "robot"), cube(A1, (3, 0, 0)))
        assert rig.pairs() == {("a/1", "a/2")}
        assert rig.pose_of(A2)[0] == 3.5


def test_with_tf2_frames_that_it_does_not_know_are_refused(tf2_ros: Any) -> None:
    with Rig(tf2=True, transform_timeout=0.0) as rig:
        rig.send(in_frame(cube(A1), "nowhere"), cube(A2))
        rig.until(lambda: rig.refused("objects"), "refusal")
        assert rig.refused("objects") == {"unknown frame": 1}
        assert rig.pairs() == set()


def test_with_tf2_a_transform_that_comes_late_delays_an_object_only(tf2_ros: Any) -> None:
    with Rig(tf2=True, transform_timeout=30.0) as rig:
        rig.send(cube(A1), cube(A2, (9, 0, 0)))
        rig.answer()
        table = rig.node.objects.table
        slot, stamps = table.slots[A2], []
        set_transform(rig, 0.0, rig.stamp)
        for x in range(4):
            rig.send_transform("a/2", pose(x), "robot")
            stamps.append(rig.stamp)
        rig.until(lambda: table.stamp[slot] == stamps[-1], "taken in")
        for number, stamp in enumerate(stamps):
            set_transform(rig, 100.0, stamp)
            rig.until(lambda n=number: rig.pose_of(A2)[0] == 100.0 + n, "placed")  # type: ignore[misc]
        assert rig.refused("object_transform") == {}


def test_with_tf2_a_stamp_out_of_reach_and_frames_apart_have_reasons_of_their_own(
    tf2_ros: Any,
) -> None:
    with Rig(tf2=True, transform_timeout=0.0) as rig:
        rig.send(cube(A1))
        rig.answer()
        set_transform(rig, 0.0, rig.stamp - 10)
        rig.send_transform("a/1", pose(1.0), "robot")
        rig.until(lambda: rig.refused("object_transform"), "refusal")
        assert rig.refused("object_transform") == {"extrapolation": 1}
        apart = TransformStamped(child_frame_id="b", transform=transform_to_ros(pose(0.0)))
        apart.header = Header(stamp=stamp_to_ros(rig.stamp + 1_000_000), frame_id="a")
        give(rig, apart)
        rig.send_poses([1], [pose(1.0)], frame="b")
        rig.until(lambda: rig.refused("object_poses"), "refusal")
        assert rig.refused("object_poses") == {"no transform": 1}


def test_without_tf2_the_node_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames_of_node, "tf2_ros", None)
    with Rig(tf2=True) as rig:
        assert "fixed frame only" in rig.frames.description
        rig.send(in_frame(cube(A1), "nowhere"), cube(A2))
        rig.answer()
        assert rig.refused("objects") == {"unknown frame": 1}, "at once: no frame can come later"

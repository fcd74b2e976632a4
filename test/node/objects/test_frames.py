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

"""Poses in other frames: by frames of a test, by tf2 where it is installed, and by its stand-in."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
import tf2_stand_in
from geometry_msgs.msg import TransformStamped
from rig import FRAME, FakeFrames, Rig, color, cube, pose
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.answer import FREE, UNKNOWN
from obb_collision.node.messages.box_markers import COLORS, DOUBTFUL
from obb_collision.node.messages.box_markers import FREE as GREEN
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


def test_without_tf2_the_node_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(frames_of_node, "tf2_ros", None)
    with Rig(tf2=True) as rig:
        assert "fixed frame only" in rig.frames.description
        rig.send(in_frame(cube(A1), "nowhere"), cube(A2))
        rig.answer()
        assert rig.refused("objects") == {"unknown frame": 1}, "at once: no frame can come later"


A1, A2 = ("a", 1), ("a", 2)


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
    rig.frames.buffer.set_transform(transform, "test")


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


def test_with_tf2_a_state_without_a_stamp_is_placed_by_the_latest_transform(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        for number, x in enumerate((1.0, 2.0, 3.0)):
            set_transform(rig, x, rig.stamp + number)
        rig.send(in_frame(cube(A2, (0.5, 0, 0)), "robot"), stamped=False)
        rig.until(lambda: A2 in rig.node.objects.table.slots, "an object")
        rig.cycles(1)
        assert rig.pose_of(A2)[0] == 3.5
        set_transform(rig, 7.0, rig.stamp + 10)
        rig.cycles(2)
        assert rig.pose_of(A2)[0] == 3.5, "not locked: stays where it was placed"


def test_with_tf2_frame_locked_objects_follow_in_every_cycle(tf2_ros: Any) -> None:
    with Rig(tf2=True) as rig:
        set_transform(rig, 0.0, rig.stamp)
        rig.send(in_frame(cube(A2, frame_locked=True), "robot"))
        rig.until(lambda: A2 in rig.node.objects.table.slots, "an object")
        run, seen = rig.node.cycle.run, list[float]()
        frame = {"x": 0.0}

        def run_and_move(now: int) -> None:
            frame["x"] += 1.0
            rig.stamp += 1
            set_transform(rig, frame["x"], rig.stamp)
            run(now)
            seen.append(float(rig.pose_of(A2)[0]))

        rig.node.cycle.run = run_and_move  # type: ignore[method-assign]
        rig.until(lambda: len(seen) >= 10, "cycles")
        assert seen == [float(number + 1) for number in range(len(seen))]


def test_with_tf2_no_look_up_waits_and_each_is_made_once_per_cycle(
    tf2_ros: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Rig(tf2=True, transform_timeout=30.0) as rig:
        look_up, asked = rig.frames.buffer.lookup_transform, list[tuple[str, int]]()

        def record(target: str, source: str, time: Any, *timeout: Any) -> Any:
            assert timeout == (), "by default none"
            asked.append((source, rig.node.cycle.monitor.total))
            return look_up(target, source, time)

        monkeypatch.setattr(rig.frames.buffer, "lookup_transform", record)
        far = [in_frame(cube(("far", number)), f"frame_{number % 3}") for number in range(30)]
        rig.send(cube(A1), cube(A2, (9, 0, 0)), *far)
        rig.until(lambda: len({cycle for _, cycle in asked}) > 5, "look-ups in vain")
        rig.send_transform("a/2", pose(0.5))
        assert rig.pairs() == {("a/1", "a/2")}, "others are answered while those wait"
        counts = Counter(asked)
        assert {source for source, _ in counts} == {"frame_0", "frame_1", "frame_2"}
        assert max(counts.values()) == 1, "one for each frame and cycle, not for each object"


def test_with_tf2_what_cannot_be_placed_is_reported_coloured_counted_and_never_free(
    tf2_ros: Any,
) -> None:
    with Rig(tf2=True, transform_timeout=0.1) as rig:
        rig.listen("collision_status", "/diagnostics", "obb_collision/markers")
        set_transform(rig, 5.0, rig.stamp + 1_000_000)
        rig.send(cube(A1), in_frame(cube(A2), "robot"))
        assert rig.pairs() == set()
        rig.until(lambda: rig.next("collision_status").status[0].level == FREE, "free")

        def colors() -> list[Any]:
            return [color(marker) for marker in rig.next("obb_collision/markers").markers]

        assert colors() == [COLORS[GREEN]] * 2
        rig.send_transform("a/2", pose(1.0), "robot")  # whose transform never comes
        rig.send(in_frame(cube(("new", 1)), "nowhere"))

        def unknown() -> bool:
            (status,) = rig.next("collision_status").status
            named = "a/2" in status.message and "new/1" in status.message
            return bool(status.level == UNKNOWN and named)

        rig.until(unknown, "a status that names both")
        assert rig.last["in_collision"].data, "never free"
        rig.until(lambda: colors() == [COLORS[GREEN], COLORS[DOUBTFUL]], "grey at the last place")
        found = rig.status(": objects")
        assert (found["unplaceable"], found["names unplaceable"]) == ("1", "new/1")
        assert (found["refused"], found["names refused"]) == ("1", "a/2")
        assert rig.status("input object_transform")["rejected: extrapolation"] == "1"
        assert rig.status("input objects")["rejected: unknown frame"] == "1"

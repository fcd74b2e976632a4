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

"""The obstacle points that the node takes in: layouts, frames, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from effect_topics import answer, listening
from rig import FakeFrames, Rig, cube, pose
from sensor_msgs.msg import PointCloud2

from obb_collision.node import named_points_inside
from obb_collision.node.inputs import clouds as obstacles
from obb_collision.node.messages.clouds import points_from_ros


def inside(rig: Rig) -> list[tuple[str, int]]:
    """Names and counts in the answer to the last cloud."""
    message = answer(rig, "points_inside")
    return [(found.name, found.points) for found in named_points_inside(message, ["a"])]


@each("kind", ["<f4", "<f8", ">f4", ">f8"])
def test_clouds_of_any_float_and_endianness_are_taken(rig: Rig, kind: str) -> None:
    listening(rig, "points_inside")
    rig.send(cube(("a", 1)))
    rig.answer()
    rig.send_points([[0.0, 0, 0], [0.5, 0, 0], [0.75, 0, 0]], kind=kind)
    assert inside(rig) == [("a/1", 2)]


def test_the_latest_cloud_counts_and_an_empty_one_has_no_points(rig: Rig) -> None:
    listening(rig, "points_inside")
    rig.send(cube(("a", 1)))
    rig.answer()
    rig.send_points([[0.0, 0, 0]])
    assert inside(rig) == [("a/1", 1)]
    rig.send_transform("a/1", pose(9.0))
    rig.answer()
    rig.until(lambda: rig.next("points_inside").width == 0, "moved away from the points")
    rig.send_points([[9.0, 0, 0], [9.1, 0, 0]])
    assert inside(rig) == [("a/1", 2)]
    rig.send_points(np.empty((0, 3)))
    assert inside(rig) == []


def test_a_margin_counts_points_near_a_box() -> None:
    with Rig(given={"effects.points_margin": 0.25}) as rig:
        listening(rig, "points_inside")
        rig.send(cube(("a", 1)))
        rig.answer()
        rig.send_points([[0.75, 0, 0], [0.8, 0, 0]])
        assert inside(rig) == [("a/1", 1)]
        rig.set(**{"effects.points_margin": 0.5})
        rig.until(
            lambda: [p.points for p in named_points_inside(rig.next("points_inside"), ["a"])] == [2]
        )


def test_points_of_other_frames_are_placed_in_doubles() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["lidar"] = [1e6, 2.0, 3.0, 0.0, 0.0, turn, turn]
    with Rig(frames) as rig:
        listening(rig, "points_inside")
        rig.send(cube(("a", 1), (1e6, 3.0, 3.0), (2e-3, 2e-3, 2e-3)))
        rig.answer()
        rig.send_points([[1.0, 0.0, 0.0], [1.002, 0.0, 0.0]], "lidar")
        assert inside(rig) == [("a/1", 1)]
        assert ("lidar", rig.stamp) in frames.asked


def test_a_cloud_waits_for_its_frame_and_no_longer_than_the_timeout() -> None:
    frames = FakeFrames()
    with Rig(frames, transform_timeout=60.0) as rig:
        listening(rig, "points_inside")
        rig.send(cube(("a", 1)))
        rig.answer()
        rig.send_points([[0.0, 0, 0]], "late")
        rig.until(lambda: any(frame == "late" for frame, _ in frames.asked), "look-up")
        rig.cycles(2)
        assert rig.refused("points") == {}
        frames.known["late"] = pose(0.0)
        assert inside(rig) == [("a/1", 1)]
        rig.set(transform_timeout=0.0)
        rig.send_points([[0.0, 0, 0]], "never")
        rig.until(lambda: rig.refused("points") == {"unknown frame": 1}, "refusal")
        assert rig.next("points_inside").width == 1, "the last good cloud stays"


def latest(rig: Rig) -> int:
    """Stamp of the cloud that waits to be looked at."""
    waiting = rig.obstacles.waiting.clouds
    return waiting[-1].stamp if waiting else 0


def test_refused_clouds_and_points_that_are_no_numbers_are_counted(rig: Rig) -> None:
    listening(rig, "points_inside")
    rig.listen("/diagnostics")
    rig.send(cube(("a", 1)))
    rig.answer()
    rig.pubs["points"].publish(PointCloud2())
    rig.until(lambda: rig.refused("points") == {"field layout": 1}, "refusal")
    rig.send_points([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]])
    assert inside(rig) == [("a/1", 1)]
    status = rig.status("input points")
    assert status["rejected: field layout"] == "1"
    assert status["not finite in the last cloud"] == "2"
    rig.send_points([[0.0, 0, 0]], "nowhere")
    rig.until(lambda: rig.refused("points").get("unknown frame") == 1, "unknown frame")


def test_a_cloud_that_nobody_asks_about_is_kept_but_not_looked_at(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    taken: list[Any] = []

    def noted(message: PointCloud2, most: int) -> Any:
        taken.append(points_from_ros(message, most))
        return taken[-1]

    monkeypatch.setattr(obstacles, "points_from_ros", noted)
    with Rig() as rig:
        rig.send(cube(("a", 1)))
        rig.answer()
        for _ in range(3):
            rig.send_points([[0.0, 0, 0]])
        rig.until(lambda: latest(rig) == rig.stamp, "the last cloud")
        rig.cycles(2)
        assert taken == []
        listening(rig, "points_inside")
        assert inside(rig) == [("a/1", 1)]
        assert len(taken) == 1, "the latest one only"


def test_off_gives_the_subscription_up_and_auto_takes_it_again() -> None:
    with Rig(given={"effects.points": "off"}) as rig:
        publisher = rig.pubs["points"]
        # that of the test before may still be leaving
        rig.until(lambda: publisher.get_subscription_count() == 0, "no subscription")
        rig.set(**{"effects.points": "auto"})
        rig.until(publisher.get_subscription_count, "subscription")
        rig.set(**{"effects.points": "off"})
        rig.until(lambda: publisher.get_subscription_count() == 0, "no subscription")
        rig.set(**{"effects.points": "on"})
        rig.until(publisher.get_subscription_count, "subscription")

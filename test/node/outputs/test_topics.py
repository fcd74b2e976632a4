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

"""The node by its topics only: what goes in and what comes out; clouds of obstacle points."""

from __future__ import annotations

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from each import each
from rig import A1, A2, B1, POSES, FakeFrames, Patch, Rig, color, cube, pose, spy, sync
from sensor_msgs.msg import PointCloud2

from obb_collision import Verdict
from obb_collision.node import collisions_from_ros, named_points_inside, namespace_number
from obb_collision.node.diagnostics.answer import COLLIDING
from obb_collision.node.inputs import clouds as obstacles
from obb_collision.node.messages.box_markers import COLORS, FREE


def test_markers_make_objects_and_transforms_move_them(rig: Rig) -> None:
    assert rig.until(lambda: rig.last.get("in_collision"), "in_collision").data is True
    rig.send_boxes([], np.empty((0, 7)))
    rig.until(lambda: not rig.last["in_collision"].data, "a word that there is nothing")
    rig.send(cube(A1), cube(A2, (3.0, 0.0, 0.0)), cube(B1, (6.0, 0.0, 0.0)))
    assert rig.pairs() == set()
    rig.send_transform("a/2", pose(0.75))
    assert rig.pairs() == {("a/1", "a/2")}
    (row,) = collisions_from_ros(rig.last["collisions"])
    assert row["depth"] == pytest.approx(0.25)
    assert (row["normal_x"], row["normal_y"], row["normal_z"]) == pytest.approx((1.0, 0.0, 0.0))
    assert 0.25 <= row["x"] <= 0.5
    rig.until(lambda: (last := rig.last.get("in_collision")) and last.data, "in_collision")
    rig.send_transform("a/2", pose(6.5))
    assert rig.pairs() == {("a/2", "b/1")}
    rig.send_transform("a/2", pose(3.0))
    assert rig.pairs() == set()
    rig.until(lambda: not rig.last["in_collision"].data, "in_collision false")


def test_rows_are_sorted_with_the_smaller_key_first(rig: Rig) -> None:
    # sent in an order in which scene indices and keys disagree
    rig.send(cube(("z", 7), (0.2, 0, 0)), cube(("z", -7), (0.1, 0, 0)))
    rig.send(cube(("b", 3)), cube(("b", 2)))
    message = rig.answer()
    rows = collisions_from_ros(message)
    keys = [tuple(int(row[n]) for n in ("ns_a", "id_a", "ns_b", "id_b")) for row in rows]
    assert keys == sorted(keys)
    assert len(keys) == 6
    assert all(key[:2] < key[2:] for key in keys)
    table = rig.namespaces("z", "b")
    assert table == {namespace_number(name): name for name in ("z", "b")}
    (row,) = rows[(rows["id_a"] == -7) & (rows["id_b"] == 7)]
    assert row["normal_x"] > 0.99


@each("single", [False, True])
def test_clouds_move_many_objects_by_number(rig: Rig, single: bool) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0)), cube(B1, (6, 0, 0))).answer()
    namespaces = [namespace_number("b"), namespace_number("a")]
    rig.send_poses([1, 2], [pose(0.5), pose(1.25)], namespaces, single=single)
    assert rig.pairs() == {("a/1", "b/1"), ("a/2", "b/1")}


def test_clouds_without_ns_serve_a_single_namespace_and_are_refused_otherwise(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    rig.send_poses([2], [pose(0.5)])
    assert rig.pairs() == {("a/1", "a/2")}
    rig.send(cube(B1, (9, 0, 0))).answer()
    rig.send_poses([2], [pose(5.0)])
    rig.refuses("object_poses", {"field layout": 1})
    assert sync(rig) == {("a/1", "a/2")}


def test_lifetimes_end_objects_and_a_new_marker_renews_them() -> None:
    with Rig(rate=200.0) as rig:
        rig.send(cube(A1), cube(A2, lifetime=Duration(nanosec=1_000)))
        assert rig.pairs() == {("a/1", "a/2")}, "RViz takes lifetimes up to 0.1 ms as none"
        rig.send(cube(A2, lifetime=Duration(nanosec=200_000_000))).answer()
        rig.until(lambda: rig.next("collisions").width == 0, "expiry")
        assert list(rig.node.objects.table.slots) == [A1]


def test_the_older_of_two_states_is_dropped_whatever_its_way(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (3, 0, 0))).answer()
    newest = rig.stamp
    rig.stamp -= 900_000_000
    for topic in POSES:
        rig.send_by(topic, {A2: pose(0.0)})
    for topic in POSES:
        rig.refuses(topic, {"older stamp": 1})
    rig.stamp = newest
    assert sync(rig) == set()


def test_text_for_people_is_capped_and_states_the_total(rig: Rig) -> None:
    rig.set(max_text_pairs=2)
    rig.send(*(cube(("a", number)) for number in range(4))).answer()
    message = rig.next("collisions_text")
    assert message.status[0].message == "6 pairs in collision, the first 2 named"
    assert [status.name for status in message.status[1:]] == ["a/0 - a/1", "a/0 - a/2"]
    values = {pair.key: pair.value for pair in message.status[1].values}
    assert float(values["depth"]) == pytest.approx(1.0)
    assert len(values["normal"].split()) == 3


def test_touching_pairs_collide_and_are_marked_as_touching(rig: Rig) -> None:
    rig.send(cube(A1), cube(A2, (1.0, 0.0, 0.0)))  # exactly face to face
    rows = collisions_from_ros(rig.answer())
    assert rows["verdict"].tolist() == [Verdict.TOUCHING]
    assert rows["depth"].tolist() == [0.0]
    assert rig.next("collisions_text").status[1].message == "touching"
    rig.send_transform("a/2", pose(0.5))
    assert collisions_from_ros(rig.answer())["verdict"].tolist() == [Verdict.OVERLAP]


def test_more_pairs_than_a_message_holds_are_said_and_no_object_looks_free() -> None:
    with Rig(max_pairs=5) as rig:
        rig.send(*(cube(("a", number)) for number in range(8)), cube(("a", 8), (50.0, 0.0, 0.0)))
        assert rig.answer().width == 5
        text = rig.next("collisions_text").status[0]
        assert text.message == "at least 28 pairs in collision"
        assert rig.says(COLLIDING, "at least")["message"] == "at least 28 pairs collide"
        said = "at least 28 pairs collide (5 published)"
        status = rig.until(lambda: (s := rig.status(": objects"))["level"] == "01" and s, "warning")
        assert said in status["message"]
        assert (status["colliding"], status["pairs at least"]) == ("at least 6", "28")
        drawn = [color(marker) for marker in rig.next("obb_collision/markers").markers]
        assert len(drawn) == 9
        assert COLORS[FREE] not in drawn
        rig.set(max_pairs=28)
        rig.send(cube(("a", 8), (51.0, 0.0, 0.0)))
        assert rig.answer().width == 28
        assert rig.next("collisions_text").status[0].message == "28 pairs in collision"


def inside(rig: Rig) -> list[tuple[str, int]]:
    """Names and counts in the answer to the last cloud."""
    message = rig.answer("points_inside")
    return [(found.name, found.points) for found in named_points_inside(message, ["a"])]


@each("kind", ["<f4", "<f8", ">f4", ">f8"])
def test_clouds_of_any_float_and_endianness_are_taken(rig: Rig, kind: str) -> None:
    rig.next("points_inside")
    rig.send(cube(("a", 1))).answer()
    rig.send_points([[0.0, 0, 0], [0.5, 0, 0], [0.75, 0, 0]], kind=kind)
    assert inside(rig) == [("a/1", 2)]


def test_the_latest_cloud_counts_and_an_empty_one_has_no_points(rig: Rig) -> None:
    rig.next("points_inside")
    rig.send(cube(("a", 1))).answer()
    rig.send_points([[0.0, 0, 0]])
    assert inside(rig) == [("a/1", 1)]
    rig.send_transform("a/1", pose(9.0)).answer()
    rig.until(lambda: rig.next("points_inside").width == 0, "moved away from the points")
    rig.send_points([[9.0, 0, 0], [9.1, 0, 0]])
    assert inside(rig) == [("a/1", 2)]
    rig.set(**{"effects.points_margin": 0.25})
    rig.send_points([[9.75, 0, 0], [9.8, 0, 0]])
    assert inside(rig) == [("a/1", 1)], "near the box"
    rig.set(**{"effects.points_margin": 0.5})
    rig.until(lambda: inside(rig) == [("a/1", 2)], "with another margin")
    rig.send_points(np.empty((0, 3)))
    assert inside(rig) == []


def test_points_of_other_frames_are_placed_in_doubles() -> None:
    frames = FakeFrames()
    turn = np.sqrt(0.5)
    frames.known["lidar"] = [1e6, 2.0, 3.0, 0.0, 0.0, turn, turn]
    with Rig(frames) as rig:
        rig.next("points_inside")
        rig.send(cube(("a", 1), (1e6, 3.0, 3.0), (2e-3, 2e-3, 2e-3))).answer()
        rig.send_points([[1.0, 0.0, 0.0], [1.002, 0.0, 0.0]], "lidar")
        assert inside(rig) == [("a/1", 1)]
        assert ("lidar", rig.stamp) in frames.asked


def test_a_cloud_waits_for_its_frame_and_no_longer_than_the_timeout() -> None:
    frames = FakeFrames()
    with Rig(frames, transform_timeout=60.0) as rig:
        rig.next("points_inside")
        rig.send(cube(("a", 1))).answer()
        rig.send_points([[0.0, 0, 0]], "late")
        rig.until(lambda: any(frame == "late" for frame, _ in frames.asked), "look-up")
        rig.cycles(2)
        assert rig.refused("points") == {}
        frames.known["late"] = pose(0.0)
        assert inside(rig) == [("a/1", 1)]
        rig.set(transform_timeout=0.0)
        rig.send_points([[0.0, 0, 0]], "never")
        rig.refuses("points", {"unknown frame": 1})
        assert rig.next("points_inside").width == 1, "the last good cloud stays"


def test_refused_clouds_and_points_that_are_no_numbers_are_counted(rig: Rig) -> None:
    rig.next("points_inside")
    rig.send(cube(("a", 1))).answer()
    rig.pubs["points"].publish(PointCloud2())
    rig.refuses("points", {"field layout": 1})
    rig.send_points([[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 0]])
    assert inside(rig) == [("a/1", 1)]
    status = rig.status("input points")
    assert status["rejected: field layout"] == "1"
    assert status["not finite in the last cloud"] == "2"
    rig.send_points([[0.0, 0, 0]], "nowhere")
    rig.until(lambda: rig.refused("points").get("unknown frame") == 1, "unknown frame")


def test_a_cloud_that_nobody_asks_about_is_not_looked_at(rig: Rig, monkeypatch: Patch) -> None:
    taken = spy(monkeypatch, obstacles, "points_from_ros")
    rig.send(cube(("a", 1))).answer()
    for _ in range(3):
        rig.send_points([[0.0, 0, 0]])
    waiting = rig.node.obstacles.waiting
    rig.until(lambda: rig.stamp in [cloud.stamp for cloud in waiting.clouds], "the last cloud")
    rig.cycles(2)
    taken.assert_not_called()
    rig.next("points_inside")
    assert inside(rig) == [("a/1", 1)]
    assert taken.call_count == 1, "the latest one only"


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

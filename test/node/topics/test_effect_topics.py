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

"""The topics of effects: rows, readers, and their layouts beside the documentation."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.lib.recfunctions as rfn
import pytest

pytest.importorskip("rclpy")
from each import each
from effect_topics import answer, listening
from rig import FIRST_STAMP, Rig, cube, pose
from sensor_msgs.msg import PointField
from visualization_msgs.msg import Marker

from obb_collision.node import (
    clearances_from_ros,
    contacts_from_ros,
    named_clearances,
    named_contacts,
    named_passed_collisions,
    named_points_inside,
    named_predictions,
    namespace_number,
    points_inside_from_ros,
    predictions_from_ros,
)
from obb_collision.node.messages.clouds import DATATYPE_OF, cloud_to_ros
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.table import ObjectTable
from obb_collision.node.topics.cloud import Cloud
from obb_collision.node.topics.topics import PREDICTIONS, TOPICS
from obb_collision.queries.sweep.sweep import Sweeps
from obb_collision.scene.effects.sweep import SweptPairs

CLOUDS = {topic.name: topic for topic in TOPICS.values() if isinstance(topic, Cloud)}


@each("topic", ["contacts", "clearances", "predicted_collisions"])
def test_messages_come_every_cycle_also_when_there_is_nothing(rig: Rig, topic: str) -> None:
    listening(rig, topic)
    first, second = rig.next(topic), rig.next(topic)
    assert (first.width, second.width) == (0, 0)
    assert first.header.frame_id == "map"
    assert stamp_from_ros(second.header.stamp) > stamp_from_ros(first.header.stamp)


def test_contacts_are_points_in_both_boxes_with_the_normal_from_a_to_b(rig: Rig) -> None:
    listening(rig, "contacts")
    # sent so that scene indices and keys disagree on who is first
    rig.send(cube(("a", 2), (0.75, 0.25, 0.0)), cube(("a", 1)))
    message = answer(rig, "contacts")
    rows = contacts_from_ros(message)
    assert rows["index"].tolist() == [0, 1, 2, 3]
    assert rows["count"].tolist() == [4] * 4
    found = named_contacts(message, rig.namespaces("a"))
    assert {(c.a, c.b, c.normal) for c in found} == {("a/1", "a/2", (1.0, 0.0, 0.0))}
    assert sorted({(round(y, 9), round(z, 9)) for _, y, z in (c.point for c in found)}) == [
        (-0.25, -0.5),
        (-0.25, 0.5),
        (0.5, -0.5),
        (0.5, 0.5),
    ]
    for contact in found:
        assert 0.25 <= contact.point[0] <= 0.5
        assert contact.depth == pytest.approx(0.25)
    assert np.allclose(rows["x"], rows["point_x"])


def test_eight_points_a_pair_if_asked_for() -> None:
    with Rig(given={"effects.contacts_max_points": 8}) as rig:
        listening(rig, "contacts")
        turned = cube(("a", 2), (0.0, 0.0, 0.875))
        turned.pose.orientation.z, turned.pose.orientation.w = np.sin(np.pi / 8), np.cos(np.pi / 8)
        rig.send(cube(("a", 1)), turned)
        assert contacts_from_ros(answer(rig, "contacts"))["count"].tolist() == [8] * 8


def test_clearances_have_the_closest_points_of_each_and_leave_out_what_is_far() -> None:
    with Rig(given={"effects.clearance_max_distance": 0.75}) as rig:
        listening(rig, "clearances")
        rig.send(cube(("a", 2), (1.5, 0, 0)), cube(("a", 1)), cube(("b", 1), (-1.8, 0, 0)))
        (found,) = named_clearances(answer(rig, "clearances"), rig.namespaces("a", "b"))
        assert (found.a, found.b, found.distance) == ("a/1", "a/2", 0.5)
        assert (found.point_a[0], found.point_b[0]) == (0.5, 1.0)
        assert found.point_a[1:] == found.point_b[1:]
        (row,) = clearances_from_ros(rig.last["clearances"])
        assert (row["normal_x"], row["x"]) == (1.0, 0.75)
        rig.set(**{"effects.clearance_max_distance": 0.9})
        rig.until(lambda: rig.next("clearances").width == 2, "another limit")


def test_overlapping_boxes_have_a_negative_clearance(rig: Rig) -> None:
    listening(rig, "clearances")
    rig.send(cube(("a", 1)), cube(("a", 2), (0.75, 0, 0)))
    (found,) = named_clearances(answer(rig, "clearances"), rig.namespaces("a"))
    assert found.distance == -0.25


def test_twists_predict_collisions_with_their_time(rig: Rig) -> None:
    listening(rig, "predicted_collisions")
    rig.send(cube(("wall", 1), (2.0, 0, 0), (0.5, 4, 4)), cube(("fast", 1)))
    rig.answer()
    rig.send_states(["fast/1"], [pose(0.0)], twists=[[2.5, 0, 0, 0, 0, 0]])
    (found,) = named_predictions(
        answer(rig, "predicted_collisions"), rig.namespaces("wall", "fast")
    )
    assert (found.a, found.b) == ("wall/1", "fast/1")
    assert found.time == pytest.approx(0.5)
    assert found.point[0] == pytest.approx(1.75)
    assert found.normal == pytest.approx((-1.0, 0.0, 0.0))
    (row,) = predictions_from_ros(rig.last["predicted_collisions"])
    assert row["passed"] == 0
    assert rig.set(**{"effects.sweep_horizon": 0.4})[0].successful
    rig.until(lambda: rig.next("predicted_collisions").width == 0, "beyond the horizon")


def test_what_passes_through_a_wall_between_two_states_is_told_once(rig: Rig) -> None:
    listening(rig, "predicted_collisions")
    rig.send(cube(("wall", 1), (2.0, 0, 0), (0.25, 4, 4)), cube(("fast", 1), size=(0.5, 0.5, 0.5)))
    rig.answer()
    before = rig.stamp
    rig.stamp += 99_000_000
    rig.send_transform("fast/1", pose(4.0))
    message = answer(rig, "predicted_collisions")
    assert rig.pairs() == set(), "neither before nor after"
    seconds = 1e-9 * (rig.stamp - before)
    table = rig.namespaces("wall", "fast")
    assert named_predictions(message, table) == [], "a rule for what is to come must not see it"
    ((a, b, time, point, normal),) = named_passed_collisions(message, table)
    assert (a, b) == ("wall/1", "fast/1")
    share = (1.875 - 0.25) / 4.0  # of the way, when the faces meet
    assert time == pytest.approx((share - 1.0) * seconds)
    assert point[0] == pytest.approx(1.875)
    assert normal == pytest.approx((-1.0, 0.0, 0.0))
    assert predictions_from_ros(message)["passed"].tolist() == [1]
    rig.until(lambda: rig.next("predicted_collisions").width == 0, "over")


def test_predictions_are_of_shapes_where_these_decide_the_pairs() -> None:
    """Two balls whose boxes meet, but not they; and one that meets later than its box."""
    with Rig(given={"accuracy": "hull", "effects.sweep_horizon": 10.0}) as rig:
        listening(rig, "predicted_collisions")
        posts = cube(("post", 1), (3.0, 0.9, 0.9)), cube(("post", 2), (6.0, 0.6, 0.0))
        balls = [*posts, cube(("ball", 1))]
        for ball in balls:
            ball.type = Marker.SPHERE
        rig.send(*balls)
        rig.answer()
        rig.send_states(["ball/1"], [pose(0.0)], twists=[[1.0, 0, 0, 0, 0, 0]])
        table = rig.namespaces("post", "ball")

        def found() -> list[tuple[str, float]]:
            rows = named_predictions(rig.next("predicted_collisions"), table)
            return sorted((row.a, round(row.time, 6)) for row in rows)

        rig.until(lambda: found() == [("post/2", 5.2)], "balls")
        assert rig.set(**{"effects.sweep_accuracy": "obb"})[0].successful
        rig.until(lambda: found() == [("post/1", 2.0), ("post/2", 5.0)], "boxes")


def test_what_is_not_known_is_told_with_the_time_until_which_it_is_free(rig: Rig) -> None:
    """A millimetre from 1e8 m: doubles have no digits left for the tolerance."""
    listening(rig, "predicted_collisions")
    small = (0.001, 0.001, 0.001)
    rig.send(cube(("post", 1), size=small), cube(("grain", 1), (1e8, 0, 0), small))
    rig.answer()
    rig.send_states(["grain/1"], [pose(1e8)], twists=[[-1.5e8, 0, 0, 0.1, 0.2, 0.3]])
    message = answer(rig, "predicted_collisions")
    table = rig.namespaces("post", "grain")
    (found,) = named_predictions(message, table)
    assert found.undecided
    assert {found.a, found.b} == {"post/1", "grain/1"}
    assert found.time == pytest.approx(1.0 / 1.5, abs=1e-9)
    assert np.isnan([*found.point, *found.normal]).all()
    (row,) = predictions_from_ros(message)
    assert (row["undecided"], row["passed"]) == (1, 0)
    assert named_passed_collisions(message, table) == []


def test_passed_coming_and_undecided_each_have_their_marks() -> None:
    table = ObjectTable()
    for number in range(5):
        table.claim(number, ("a", number))
    hits, undecided = np.array([True, False]), np.array([False, True])
    points, nan = np.array([[1.0, 2.0, 3.0], [np.nan] * 3]), np.nan

    def sweeps(first: int, times: list[float], free: list[float]) -> Sweeps:
        pairs = np.array([[0, first], [0, first + 2]])
        return Sweeps(pairs, hits, undecided, np.array(times), np.array(free), points, points)

    result = SweptPairs(
        passed=sweeps(1, [0.75, nan], [0.75, 0.5]), predicted=sweeps(2, [0.25, nan], [0.25, 0.125])
    )
    state: Any = SimpleNamespace(table=table, step=0.1)
    rows = PREDICTIONS.make_rows(result, state, PREDICTIONS.dtype)
    assert rows["id_b"].tolist() == [1, 2, 3, 4]
    assert rows["passed"].tolist() == [1, 0, 1, 0]
    assert rows["undecided"].tolist() == [0, 0, 1, 1]
    assert rows["time"].tolist() == pytest.approx([-0.025, 0.25, -0.05, 0.125])
    assert np.isnan(rows["point_x"]).tolist() == [False, False, True, True]
    message = cloud_to_ros(rows)
    assert [r.undecided for r in named_predictions(message, ["a"])] == [False, True]
    assert [r.undecided for r in named_passed_collisions(message, ["a"])] == [False, True]
    old = cloud_to_ros(rfn.drop_fields(rows, "undecided"))
    assert len(named_predictions(old, ["a"])) == 2, "recorded with an earlier version"


@each("topic", CLOUDS)
def test_readers_refuse_other_messages_and_older_tables(topic: str) -> None:
    read, rows = CLOUDS[topic].named, np.zeros(1, CLOUDS[topic].dtype)
    rows["ns" if topic == "points_inside" else "ns_b"] = namespace_number("arm")
    message = cloud_to_ros(rows)
    named = read(message, ["arm", ""])
    assert "arm/0" in named[0]
    assert named == read(message, {0: "", namespace_number("arm"): "arm"})
    with pytest.raises(RefusedError, match="unknown namespace"):
        read(message, [""])
    with pytest.raises(RefusedError, match=f"not a {topic} message"):
        read(cloud_to_ros(np.zeros(1, [("x", "<f4")])), ["arm"])


@each("cloud", CLOUDS.values())
def test_rows_are_aligned_and_drawn_by_rviz(cloud: Cloud[Any]) -> None:
    layout: Any = cloud.dtype
    assert layout.itemsize % 8 == 0
    for name in layout.names:
        kind, offset = layout.fields[name][:2]
        assert offset % kind.itemsize == 0
        assert kind.newbyteorder("=") in DATATYPE_OF
    assert [layout.fields[name][1] for name in "xyz"] == [0, 4, 8]
    message = cloud_to_ros(np.zeros(2, layout))
    assert {f.datatype for f in message.fields if f.name in "xyz"} == {PointField.FLOAT32}
    assert message.point_step == layout.itemsize


def test_points_inside_are_counted_by_object(rig: Rig) -> None:
    listening(rig, "points_inside")
    rig.send(cube(("a", 1)), cube(("a", 2), (2.0, 0, 0)), cube(("b", 1), (9.0, 0, 0)))
    rig.answer()
    inside = [[9.0, 9, 9], [2.4, 0, 0], [0.25, 0, 0], [np.nan, 0, 0], [0.125, 0, 0], [0.4, 0, 0]]
    rig.send_points(inside)
    message = answer(rig, "points_inside")
    assert named_points_inside(message, rig.namespaces("a", "b")) == [
        ("a/1", 3, 2, 4, 0.125),
        ("a/2", 1, 1, 1, pytest.approx(0.4)),
    ]
    rows = points_inside_from_ros(message)
    assert rows["x"].tolist() == [0.125, pytest.approx(2.4)]
    assert FIRST_STAMP < stamp_from_ros(message.header.stamp) == rig.stamp, "that of the cloud"

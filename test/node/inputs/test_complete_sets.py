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

"""Complete sets of boxes and of detections on topics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import pytest
from each import each
from geometry_msgs.msg import Vector3
from rclpy.serialization import serialize_message
from rig import FRAME, FakeFrames, Patch, Rig, cube, pose, sync
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker

from obb_collision.node import boxes_to_ros, namespace_number
from obb_collision.node.inputs import detections, detections_from_bytes, numbers_of
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.conversions import pose_to_ros, stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.conditions import BAD_POSE
from obb_collision.node.objects.table import ObjectTable
from tools.fuzz.messages import Box, Detection, Detections, Hypothesis, Result, serialised

TOPIC = "object_boxes"
NUMBER = namespace_number("seen")


def keys(rig: Rig) -> set[tuple[str, int]]:
    """Keys of all objects but that of ``sync``."""
    return {key for key in rig.node.objects.table.slots if key[0] != "sync"}


def in_row(*places: float) -> Any:
    return [pose(place) for place in places]


def test_markers_do_not_touch_boxes(rig: Rig) -> None:
    rig.send_boxes([1, 2], in_row(0, 0.5), namespaces=[NUMBER] * 2).answer()
    rig.send(Marker(action=Marker.DELETEALL))
    rig.send(cube(("#" + str(NUMBER), 1), (9, 0, 0)))
    assert sync(rig) == {(f"#{NUMBER}/1", f"#{NUMBER}/2")}, "named by its number"
    rig.send(Marker(ns="seen", action=Marker.DELETEALL), cube(("seen", 1), (9, 0, 0)))
    rig.send(Marker(ns="seen", id=2, action=Marker.DELETE))
    assert sync(rig) == {(f"#{NUMBER}/1", f"#{NUMBER}/2")}
    rig.send(cube(("seen", 3), (20, 0, 0)))
    sync(rig)
    assert rig.node.objects.scene.check().names() == [("seen/1", "seen/2")], "a marker said it"
    assert rig.refused("objects") == {"object of another input": 3}
    assert rig.is_doubtful(("seen", 1))
    rig.send_boxes([1, 2], in_row(0, 0.5), namespaces=[NUMBER] * 2).answer()
    assert not rig.is_doubtful(("seen", 1))


def test_boxes_whose_name_is_received_are_what_is_required(rig: Rig) -> None:
    rig.set(required_objects=["seen/1"])
    rig.send_boxes([1, 2], in_row(0, 5), namespaces=[NUMBER] * 2).answer()
    assert [reason.code for reason in rig.node.evidence.answer().reasons] == ["required_missing"]
    rig.node.objects.table.namespaces.admit("seen")
    assert rig.node.evidence.answer().reasons == ()


@each(
    "size, place, reason",
    [
        ((0, 1, 1), pose(0.5), "bad size"),
        ((1, 1, np.nan), pose(0.5), "bad size"),
        ((1, 1, 1e301), pose(0.5), "bad size"),
        ((1, 1, 1), pose(np.nan), "bad pose"),
        ((1, 1, 1), [0.0] * 7, "zero quaternion"),
    ],
)
def test_a_bad_row_is_refused_alone(rig: Rig, size: Any, place: Any, reason: str) -> None:
    rig.send_boxes([1, 2, 3], in_row(0, 0.5, 9))
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    for ids in ([1, 2], [1, 4]):
        rig.send_boxes(ids, [pose(0), place], [[1, 1, 1], size]).answer()
    assert rig.refused(TOPIC) == {reason: 2}
    assert keys(rig) == {("boxes", 1)}, "2 is not in the second set, 4 can't be"
    assert rig.node.objects.unplaceable == {("boxes", 4): reason}
    rig.send_boxes([1, 2], in_row(0, 0.5))
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    assert not rig.node.objects.unplaceable
    rig.send_boxes([1, 2], [pose(0), place], [[1, 1, 1], size])
    assert rig.pairs() == {("boxes/1", "boxes/2")}, "it stays where it was last"
    assert rig.is_doubtful(("boxes", 2))


def test_of_rows_for_a_box_the_last_one_counts_and_keys_are_int32(rig: Rig) -> None:
    rig.send_boxes([1, 2, 1, 1], in_row(9, 0, 7, 0.5))
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    assert rig.refused(TOPIC) == {"repeated": 2}
    message = boxes_to_ros([-1, 2], in_row(0, 0.5), np.ones((2, 3)), [6, 5], rig.header())
    rows = np.frombuffer(bytes(message.data), np.dtype([("v", "<f8", 10), ("k", "<i4", 2)])).copy()
    message.fields[-1].datatype = 6  # id as uint32: none of them is an id
    message.data = rows.tobytes()
    rig.pubs[TOPIC].publish(message)
    rig.answer()
    assert keys(rig) == {("#5", 2)}
    assert rig.refused(TOPIC) == {"repeated": 2, "bad key": 1}


def test_a_set_that_cannot_be_read_changes_nothing_but_marks_the_boxes(rig: Rig) -> None:
    rig.send_boxes([1, 2], in_row(0, 0.5))
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    good = boxes_to_ros([1], in_row(9), np.ones((1, 3)), header=rig.header())
    late = Header(frame_id=FRAME)
    late.stamp.sec = -1
    headers = {
        "unknown frame": Header(frame_id="elsewhere"),
        "bad name": Header(frame_id="x" * 300),
    }
    headers["bad stamp"] = late
    expected: dict[str, int] = {}
    for reason in (*headers, "field layout"):
        good.header = headers.get(reason, late)
        rig.pubs[TOPIC].publish(good if reason in headers else PointCloud2())
        expected[reason] = 1
        rig.refuses(TOPIC, expected)
    assert sync(rig) == {("boxes/1", "boxes/2")}
    assert all(rig.is_doubtful(("boxes", number)) for number in (1, 2))


def test_a_set_with_an_older_stamp_is_late_unless_its_sender_began_anew(rig: Rig) -> None:
    rig.send_boxes([1, 2], in_row(0, 0.5))
    last = rig.stamp
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    rig.stamp -= 10_000_000
    rig.send_boxes([1], in_row(0))
    rig.stamp = last
    assert sync(rig) == {("boxes/1", "boxes/2")}
    assert rig.refused(TOPIC) == {"older stamp": 1}
    rig.set(order_timeout=0.0)
    rig.stamp -= 10_000_000
    rig.send_boxes([1], in_row(0))
    rig.until(lambda: keys(rig) == {("boxes", 1)}, "a new start")


def test_of_sets_that_wait_together_the_last_one_counts(rig: Rig) -> None:
    for number in range(3):
        message = boxes_to_ros([number], in_row(number), np.ones((1, 3)), header=rig.header())
        rig.node.inputs.callbacks()[TOPIC](serialize_message(message))
    rig.answer()
    assert keys(rig) == {("boxes", 2)}
    assert rig.monitor(TOPIC).superseded == 2


def test_a_set_whose_transform_is_no_pose_is_refused() -> None:
    frames = FakeFrames()
    frames.known["camera"] = [np.nan] * 7
    with Rig(frames) as rig:
        rig.send_boxes([1], in_row(0), frame="camera")
        rig.refuses(TOPIC, {"bad transform": 1})
        assert keys(rig) == set()


def test_new_boxes_beyond_the_limit_are_refused(rig: Rig) -> None:
    rig.set(max_objects=3)
    rig.send(cube(("a", 1)))
    rig.send_boxes([1, 2, 3, 4], in_row(5, 10, 15, 20)).answer()
    assert keys(rig) == {("a", 1), ("boxes", 1), ("boxes", 2)}
    assert rig.refused(TOPIC) == {"too many objects": 2}
    rig.send_boxes([4, 3], in_row(20, 15))  # those that go make room
    rig.answer()
    assert keys(rig) == {("a", 1), ("boxes", 3), ("boxes", 4)}
    assert not rig.node.objects.unplaceable


def test_names_that_stand_for_a_number_are_not_given_twice(rig: Rig) -> None:
    rig.send(cube(("#5", 1)))
    rig.send_boxes([1, 1], in_row(0, 0.5), namespaces=[5, 6])
    assert rig.pairs() == {("#5/1", "#6/1")}
    assert rig.refused(TOPIC) == {"namespace number taken": 1}
    rig.send(cube(("#6", 2)))
    sync(rig)
    assert rig.refused("objects") == {"namespace number taken": 1}


def test_very_many_namespaces_do_not_hold_up_the_cycles(rig: Rig) -> None:
    count = 60_000  # the table has 20,000
    rig.set(max_objects=count)
    poses = np.zeros((count, 7))
    poses[:, 0], poses[:, 6] = 2.0 * np.arange(count), 1.0
    rig.send_boxes(np.arange(count), poses, 1.0, np.arange(count)).answer()
    assert rig.refused(TOPIC) == {"too many namespaces": count - 20_000}
    assert len(rig.node.objects.table) == 20_000


def test_boxes_that_fail_leave_nothing_of_those_before(rig: Rig, monkeypatch: Patch) -> None:
    rig.send_boxes([1, 2, 3], in_row(0, 0.9, 5))
    assert rig.pairs() == {("boxes/1", "boxes/2")}
    claim_many = ObjectTable.claim_many

    def fail(table: ObjectTable, slots: Any, namespaces: Any, ids: Any) -> None:
        if 12 in ids:  # after the scene has it
            raise ArithmeticError("of this box")
        claim_many(table, slots, namespaces, ids)

    monkeypatch.setattr(ObjectTable, "claim_many", fail)
    rig.send_boxes([11, 12, 13], in_row(0, 0.9, 1.8))
    assert rig.pairs() == set()
    assert keys(rig) == {("boxes", 11), ("boxes", 13)}
    found = [name for name in rig.node.objects.scene.names if "boxes/" in name]
    assert found == ["boxes/11", "boxes/13"]
    monkeypatch.undo()
    rig.send_boxes([12, 13], in_row(0.9, 1.8))
    assert rig.pairs() == {("boxes/12", "boxes/13")}
    assert keys(rig) == {("boxes", 12), ("boxes", 13)}


SEEN = "detections"
EDGES = (1.0, 1.0, 1.0)


class Seen(NamedTuple):
    """A detection; results: classes, each with its score."""

    pose: Any
    size: Sequence[float] = EDGES
    ident: str = ""
    results: Sequence[tuple[str, float]] = ()
    frame: str = FRAME


def bytes_of(some: Sequence[Seen], stamp: int = 1, frame: str = FRAME) -> bytes:
    seen = []
    for one in some:
        header = Header(stamp=stamp_to_ros(stamp), frame_id=one.frame)
        results = [Result(Hypothesis(name, score)) for name, score in one.results]
        x, y, z = map(float, one.size)
        box = Box(pose_to_ros(one.pose), Vector3(x=x, y=y, z=z))
        seen.append(Detection(header, results, box, one.ident))
    return serialised(Detections(Header(stamp=stamp_to_ros(stamp), frame_id=frame), seen))


@pytest.fixture
def seeing(monkeypatch: Patch) -> Iterator[Rig]:
    """Yield a node with the topic, its type being another one: messages go as bytes."""
    monkeypatch.setattr(detections, "INPUTS", {SEEN: Input(PointCloud2, 10)})
    with Rig() as made:
        made.pubs[SEEN] = made.client.create_publisher(PointCloud2, SEEN, 10)
        made.wait_inputs()
        yield made


def see(rig: Rig, *some: Seen, frame: str = FRAME) -> None:
    rig.header()
    rig.pubs[SEEN].publish(bytes_of(some, rig.stamp, frame))


def test_each_message_is_the_complete_set(seeing: Rig) -> None:
    cup = [("cup", 0.9), ("bottle", 0.1)]
    see(seeing, Seen(pose(0), ident="4", results=cup), Seen(pose(0.9), ident="7"))
    assert seeing.pairs() == {("detections/4", "detections/7")}
    see(seeing, Seen(pose(0.9), ident="7"), Seen(pose(5), (2, 2, 2), ident="9"), Seen(pose(6.4)))
    assert seeing.pairs() == {("detections/0", "detections/9")}
    assert keys(seeing) == {("detections", number) for number in (0, 7, 9)}
    see(seeing)
    seeing.until(lambda: not keys(seeing), "an empty set")
    assert seeing.refused(SEEN) == {}


def test_sets_of_boxes_and_markers_are_others(seeing: Rig) -> None:
    seeing.send(cube(("wall", 1)))
    seeing.send_boxes([1], [pose(0.9)])
    see(seeing, Seen(pose(1.8), ident="1"))
    assert seeing.pairs() == {("boxes/1", "wall/1"), ("boxes/1", "detections/1")}
    see(seeing)
    seeing.until(lambda: keys(seeing) == {("wall", 1), ("boxes", 1)}, "markers and boxes")
    seeing.send_boxes([], np.empty((0, 7)))
    seeing.until(lambda: keys(seeing) == {("wall", 1)}, "the marker alone")
    see(seeing, Seen(pose(3.0), ident="1"))
    seeing.answer()
    seeing.send(cube(("detections", 1)))
    seeing.refuses("objects", {"object of another input": 1})


@each("frame", ["", FRAME])
def test_the_frame_of_all_is_that_of_the_message(seeing: Rig, frame: str) -> None:
    see(seeing, Seen(pose(0.0), frame=""), Seen(pose(0.9), frame=FRAME), frame=frame)
    assert seeing.pairs() == {("detections/0", "detections/1")}
    see(seeing, Seen(pose(0.0), frame="camera"), frame=FRAME)
    seeing.refuses(SEEN, {"several frames": 1})
    assert seeing.node.objects.table.has(BAD_POSE).any()  # what there is may have moved


def test_what_is_cut_short_is_refused_whole() -> None:
    some = [Seen(pose(1.0), ident="a", results=[("cup", 0.5)]), Seen(pose(2.0), ident="12")]
    data = bytes_of(some, 5, "map")
    found = detections_from_bytes(data, 10)
    assert (found.header.frame_id, found.ids, found.frames) == ("map", ["a", "12"], {FRAME})
    np.testing.assert_array_equal(found.poses, [pose(1.0), pose(2.0)])
    np.testing.assert_array_equal(found.sizes, np.ones((2, 3)))
    for end in range(4, len(data)):
        with pytest.raises(RefusedError, match="malformed message"):
            detections_from_bytes(data[:end], 10)
    with pytest.raises(RefusedError, match="too many points"):
        detections_from_bytes(data, 1)


def test_none_is_lost_by_its_id() -> None:
    assert numbers_of(["5", "", "5", "0", "", "99999999999"])[[0, 3]].tolist() == [5, 0]
    texts = ["track-a", "", "7", "7", "track-a", "9" * 5000, "-3", *map(str, range(40))]
    numbers = numbers_of(texts)
    assert len(set(numbers.tolist())) == len(texts)
    assert np.abs(numbers).max() <= 2**31
    assert numbers_of(["x", "track-a"])[1] == numbers[0]


def test_bytes_are_those_of_vision_msgs() -> None:
    pytest.importorskip("vision_msgs")
    from rclpy.serialization import deserialize_message
    from vision_msgs.msg import Detection3DArray

    some = [Seen(pose(1.0), (1, 2, 3), "a", [("cup", 0.5), ("b", 1.0)]), Seen(pose(2.0))]
    message = deserialize_message(bytes_of(some, 5), Detection3DArray)
    assert [one.id for one in message.detections] == ["a", ""]
    assert message.detections[0].results[1].hypothesis.class_id == "b"
    found = detections_from_bytes(serialize_message(message), 10)
    np.testing.assert_array_equal(found.sizes, [(1, 2, 3), EDGES])
    with Rig() as rig:
        publisher = rig.client.create_publisher(Detection3DArray, SEEN, 10)
        rig.until(publisher.get_subscription_count, "the subscription")
        message.header = rig.header()
        for one in message.detections:
            one.header = message.header
        publisher.publish(message)
        assert rig.pairs() == {("detections/0", f"detections/{numbers_of(['a'])[0]}")}

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

"""Detections of vision_msgs as objects: with bytes that look alike, and where it is installed."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from struct import pack
from typing import Any, NamedTuple

import numpy as np
import pytest

pytest.importorskip("rclpy")
from each import each
from rig import FRAME, Rig, cube, pose
from sensor_msgs.msg import PointCloud2

from obb_collision.node.inputs import detections, detections_from_bytes, numbers_of
from obb_collision.node.inputs.subscriptions import Input
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.conditions import BAD_POSE

TOPIC = "detections"
EDGES = (1.0, 1.0, 1.0)


class Seen(NamedTuple):
    """A detection; results: classes, each with its score."""

    pose: Any
    size: Sequence[float] = EDGES
    ident: str = ""
    results: Sequence[tuple[str, float]] = ()
    frame: str = FRAME


class Writer:
    """Writes plain little-endian CDR."""

    def __init__(self) -> None:
        self.data = b""

    def put(self, layout: str, *values: Any, align: int = 4) -> None:
        self.data += b"\0" * (-len(self.data) % align) + pack("<" + layout, *values)

    def text(self, text: str) -> None:
        self.put("I", len(text.encode()) + 1)
        self.data += text.encode() + b"\0"

    def header(self, stamp: int, frame: str) -> None:
        self.put("iI", stamp // 10**9, stamp % 10**9)
        self.text(frame)

    def doubles(self, values: Any) -> None:
        self.put(f"{len(values)}d", *values, align=8)


def bytes_of(some: Sequence[Seen], stamp: int = 1, frame: str = FRAME) -> bytes:
    """Return a Detection3DArray as it is serialised."""
    writer = Writer()
    writer.header(stamp, frame)
    writer.put("I", len(some))
    for one in some:
        writer.header(stamp, one.frame)
        writer.put("I", len(one.results))
        for name, score in one.results:
            writer.text(name)
            writer.doubles([score, *pose(7.0), *np.arange(36.0)])
        writer.doubles([*one.pose, *one.size])
        writer.text(one.ident)
    return b"\0\1\0\0" + writer.data


class DetectionRig(Rig):
    """A node with the topic, its type being another one: messages go as bytes."""

    def __init__(self) -> None:
        super().__init__()
        self.seen = self.client.create_publisher(PointCloud2, TOPIC, 10)
        self.pubs[TOPIC] = self.seen
        self.wait_inputs()

    def see(self, *some: Seen, frame: str = FRAME) -> None:
        """Send a complete set."""
        self.header()
        self.seen.publish(bytes_of(some, self.stamp, frame))

    def keys(self) -> set[tuple[str, int]]:
        """Return the keys of the objects."""
        return {key for key in self.node.objects.table.slots if key[0] != "sync"}


@pytest.fixture
def rig(monkeypatch: pytest.MonkeyPatch) -> Iterator[DetectionRig]:
    monkeypatch.setattr(detections, "INPUTS", {TOPIC: Input(PointCloud2, 10)})
    with DetectionRig() as made:
        yield made


def test_each_message_is_the_complete_set(rig: DetectionRig) -> None:
    cup = [("cup", 0.9), ("bottle", 0.1)]
    rig.see(Seen(pose(0), ident="4", results=cup), Seen(pose(0.9), ident="7"))
    assert rig.pairs() == {("detections/4", "detections/7")}
    rig.see(Seen(pose(0.9), ident="7"), Seen(pose(5), (2, 2, 2), ident="9"), Seen(pose(6.4)))
    assert rig.pairs() == {("detections/0", "detections/9")}
    assert rig.keys() == {("detections", number) for number in (0, 7, 9)}
    rig.see()
    rig.until(lambda: not rig.keys(), "an empty set")
    assert rig.refused(TOPIC) == {}


def test_sets_of_boxes_and_markers_are_others(rig: DetectionRig) -> None:
    rig.send(cube(("wall", 1)))
    rig.send_boxes([1], [pose(0.9)])
    rig.see(Seen(pose(1.8), ident="1"))
    assert rig.pairs() == {("boxes/1", "wall/1"), ("boxes/1", "detections/1")}
    rig.see()
    rig.until(lambda: rig.keys() == {("wall", 1), ("boxes", 1)}, "markers and boxes")
    rig.send_boxes([], np.empty((0, 7)))
    rig.until(lambda: rig.keys() == {("wall", 1)}, "the marker alone")
    rig.see(Seen(pose(3.0), ident="1"))
    rig.answer()
    rig.send(cube(("detections", 1)))
    rig.until(lambda: rig.refused("objects"), "a refusal")
    assert rig.refused("objects") == {"object of another input": 1}


@each("frame", ["", FRAME])
def test_the_frame_of_all_is_that_of_the_message(rig: DetectionRig, frame: str) -> None:
    rig.see(Seen(pose(0.0), frame=""), Seen(pose(0.9), frame=FRAME), frame=frame)
    assert rig.pairs() == {("detections/0", "detections/1")}
    rig.see(Seen(pose(0.0), frame="camera"), frame=FRAME)
    rig.until(lambda: rig.refused(TOPIC), "a refusal")
    assert rig.refused(TOPIC) == {"several frames": 1}
    assert rig.node.objects.table.has(BAD_POSE).any()  # what there is may have moved


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
    from rclpy.serialization import deserialize_message, serialize_message
    from vision_msgs.msg import Detection3DArray

    some = [Seen(pose(1.0), (1, 2, 3), "a", [("cup", 0.5), ("b", 1.0)]), Seen(pose(2.0))]
    message = deserialize_message(bytes_of(some, 5), Detection3DArray)
    assert [one.id for one in message.detections] == ["a", ""]
    assert message.detections[0].results[1].hypothesis.class_id == "b"
    found = detections_from_bytes(serialize_message(message), 10)
    np.testing.assert_array_equal(found.sizes, [(1, 2, 3), EDGES])
    with Rig() as rig:
        publisher = rig.client.create_publisher(Detection3DArray, TOPIC, 10)
        rig.until(publisher.get_subscription_count, "the subscription")
        message.header = rig.header()
        for one in message.detections:
            one.header = message.header
        publisher.publish(message)
        assert rig.pairs() == {("detections/0", f"detections/{numbers_of(['a'])[0]}")}

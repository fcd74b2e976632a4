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

"""Serialised messages are read without rclpy, as rclpy reads them, or refused whole."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from typing import Any

import numpy as np
import pytest
from each import each
from geometry_msgs.msg import Point, Transform, TransformStamped, Twist
from hypothesis import given, settings
from hypothesis import strategies as st
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import MultiDOFJointState, PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages import cdr
from obb_collision.node.messages.errors import RefusedError

LETTERS = st.characters(exclude_characters="\0", codec="utf-8")
TEXTS = st.sampled_from(["", "a", "crate"]) | st.text(LETTERS, max_size=9)
NUMBERS: dict[str, st.SearchStrategy[Any]] = {
    "double": st.floats(),
    "float": st.floats(width=32, allow_nan=False),
    "boolean": st.booleans(),
    "int32": st.integers(-(2**31), 2**31 - 1),
    "uint32": st.integers(0, 2**32 - 1),
    "uint8": st.integers(0, 255),
    "string": TEXTS,
}


def messages(kind: Any) -> st.SearchStrategy[Any]:
    """Return messages of a type with any values."""
    fields = {}
    for name, text in kind.get_fields_and_field_types().items():
        inner = text.removeprefix("sequence<").removesuffix(">")
        if inner in NUMBERS:
            one = NUMBERS[inner]
        else:
            package, _, message = inner.partition("/")
            one = messages(getattr(import_module(f"{package}.msg"), message))
        several = st.binary(max_size=20) if inner == "uint8" else st.lists(one, max_size=4)
        fields[name] = one if inner == text else several
    return st.builds(kind, **fields)


def seven(p: Any, q: Any) -> list[float]:
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def head(header: Any) -> tuple[int, int, str]:
    return header.stamp.sec, header.stamp.nanosec, header.frame_id.partition("\0")[0]


def same_pose(read: cdr.NamedPose, message: TransformStamped) -> None:
    assert head(read.header) == head(message.header)
    assert read.name.partition("\0")[0] == message.child_frame_id
    transform = message.transform
    np.testing.assert_array_equal(read.pose, [seven(transform.translation, transform.rotation)])


def same_states(read: cdr.NamedStates, message: MultiDOFJointState) -> None:
    assert head(read.header) == head(message.header)
    assert [name.partition("\0")[0] for name in read.names] == list(message.joint_names)
    given = [seven(transform.translation, transform.rotation) for transform in message.transforms]
    np.testing.assert_array_equal(read.poses, np.reshape(given, (-1, 7)))
    both = [vector for twist in message.twist for vector in (twist.linear, twist.angular)]
    given = [[vector.x, vector.y, vector.z] for vector in both]
    np.testing.assert_array_equal(read.twists, np.reshape(given, (-1, 6)))


def same_cloud(read: cdr.CloudMessage, message: PointCloud2) -> None:
    assert head(read.header) == head(message.header)
    for name in ("height", "width", "is_bigendian", "point_step", "row_step"):
        assert getattr(read, name) == getattr(message, name)
    assert bytes(read.data) == bytes(message.data)
    assert [
        (field.name.partition("\0")[0], field.offset, field.datatype, field.count)
        for field in read.fields
    ] == [(field.name, field.offset, field.datatype, field.count) for field in message.fields]


def test_a_cloud_of_very_many_fields_is_refused_unread() -> None:
    message = PointCloud2(fields=[PointField()] * (cdr.MAX_FIELDS + 1))
    with pytest.raises(RefusedError, match="1001 fields, 1000 is the limit"):
        cdr.cloud_from_bytes(serialize_message(message))


def test_texts_that_are_no_utf8_are_read() -> None:
    data = serialize_message(TransformStamped(child_frame_id="wxyz"))
    name = cdr.pose_from_bytes(data.replace(b"wxyz", b"w\xff\xfez")).name
    assert name == "w\ufffd\ufffdz"


def test_what_is_read_can_be_written_and_is_aligned() -> None:
    message = MultiDOFJointState(transforms=[Transform()] * 2, twist=[Twist()])
    read = cdr.states_from_bytes(serialize_message(message))
    for values in (read.poses, read.twists):
        assert values.flags.writeable
        assert values.flags.aligned


def test_the_points_of_a_cloud_are_not_copied() -> None:
    data = serialize_message(PointCloud2(data=bytes(8)))
    assert cdr.cloud_from_bytes(data).data.obj is data


def same_markers(read: cdr.Items, message: MarkerArray) -> None:
    assert len(read) == len(message.markers)
    for row, marker in enumerate(message.markers):
        head, body, stamp = (read.numbers[name][row] for name in ("head", "body", "stamp"))
        assert head.tolist() == (marker.id, marker.type, marker.action)
        assert stamp.tolist() == (marker.header.stamp.sec, marker.header.stamp.nanosec)
        assert body["lifetime"].tolist() == (marker.lifetime.sec, marker.lifetime.nanosec)
        assert body["locked"] == marker.frame_locked
        given = seven(marker.pose.position, marker.pose.orientation)
        np.testing.assert_array_equal(body["pose"], given)
        s, c = marker.scale, marker.color
        np.testing.assert_array_equal(body["scale"], [s.x, s.y, s.z])
        np.testing.assert_array_equal(body["color"], np.array([c.r, c.g, c.b, c.a], np.float32))
        for field, text in (
            ("frame", marker.header.frame_id),
            ("ns", marker.ns),
            ("mesh", marker.mesh_resource),
            ("file", marker.mesh_file.filename),
        ):
            assert read.text(field, row).partition(b"\0")[0].decode(errors="replace") == text
        for field in ("ns", "frame") if row else ():
            is_as_before = read.text(field, row) == read.text(field, row - 1)
            assert read.of(field)[row, 2] == is_as_before
        points = [(point.x, point.y, point.z) for point in marker.points]
        np.testing.assert_array_equal(read.points("points", row), np.array(points).reshape(-1, 3))
        assert read.text("content", row) == bytes(marker.mesh_file.data)


def read_markers(data: bytes) -> cdr.Items:
    """Return markers, all of which are within the message."""
    read = cdr.markers_from_bytes(data)
    for field, (_, size, _) in zip(read.layout.columns, read.layout.spans.tolist(), strict=True):
        at, count, _ = read.of(field).T
        assert ((at >= 0) & (count >= 0) & (at + count * size <= len(data))).all()
    return read


def test_other_encodings_go_by_way_of_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    message = MarkerArray(markers=[Marker(ns="a", id=7)])
    data = serialize_message(message)
    with pytest.raises(RefusedError, match=cdr.MALFORMED):
        cdr.markers_from_bytes(b"\x12\x34" + data[2:])
    monkeypatch.setattr(cdr, "deserialize_message", lambda *_: message)
    assert cdr.markers_from_bytes(b"\0\7" + data[2:]).numbers["head"]["id"][0] == 7


KINDS: dict[str, tuple[Any, Callable[[bytes], Any], Callable[[Any, Any], None]]] = {
    "pose": (messages(TransformStamped), cdr.pose_from_bytes, same_pose),
    "states": (messages(MultiDOFJointState), cdr.states_from_bytes, same_states),
    "cloud": (messages(PointCloud2), cdr.cloud_from_bytes, same_cloud),
    "markers": (messages(MarkerArray), read_markers, same_markers),
}
kinds = each("kind", KINDS)


@kinds
@settings(max_examples=60)
@given(st.data())
def test_messages_are_read_as_rclpy_reads_them_or_refused_if_damaged(kind: str, draw: Any) -> None:
    strategy, read, same = KINDS[kind]
    message = draw.draw(strategy)
    data = bytearray(serialize_message(message))
    same(read(bytes(data)), deserialize_message(bytes(data), type(message)))
    for _ in range(draw.draw(st.integers(1, 4))):
        data[draw.draw(st.integers(4, len(data) - 1))] = draw.draw(NUMBERS["uint8"])
    damaged = bytes(data[: draw.draw(st.one_of(st.just(len(data)), st.integers(0, len(data))))])
    with suppress(RefusedError):
        found = read(damaged)
        with suppress(RMWError):
            same(found, deserialize_message(damaged, type(message)))


MAP = Header(frame_id="map")
MARKER = Marker(ns="abc", text="t", points=[Point()], colors=[ColorRGBA()])
MARKER.mesh_file.data = b"123"
EXAMPLES: dict[str, tuple[Any, int]] = {
    "pose": (TransformStamped(header=MAP, child_frame_id="a/1"), 2),
    "states": (MultiDOFJointState(joint_names=["a"], transforms=[Transform()], twist=[Twist()]), 6),
    "cloud": (PointCloud2(header=MAP, fields=[PointField(name="x")], data=bytes(5)), 4),
    "markers": (MarkerArray(markers=[MARKER, MARKER]), 2 * 13),
}
"""A message of each kind, and how many lengths stand in it."""


@kinds
def test_every_message_that_is_cut_short_or_goes_on_is_refused(kind: str) -> None:
    read, data = KINDS[kind][1], serialize_message(EXAMPLES[kind][0])
    end = len(data) - 3 if kind == "cloud" else len(data)  # padded to four bytes behind a boolean
    for size in range(end):
        with pytest.raises(RefusedError, match=cdr.MALFORMED):
            read(data[:size])
    read(data + bytes(3))
    with pytest.raises(RefusedError, match="behind the last"):
        read(data + bytes(100))


@kinds
@each("length", [2**31 - 1, 2**31, 2**32 - 1, 2**32 - 8, 2**24])
def test_enormous_lengths_are_refused_wherever_they_stand(kind: str, length: int) -> None:
    message, lengths = EXAMPLES[kind]
    read, data = KINDS[kind][1], serialize_message(message)
    refused = 0
    for at in range(4, len(data) - 3, 4):
        with suppress(RefusedError):
            read(data[:at] + length.to_bytes(4, "little") + data[at + 4 :])
            continue
        refused += 1
    assert refused >= lengths

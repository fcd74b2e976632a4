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
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time
from each import each
from geometry_msgs.msg import (
    Point,
    Pose,
    Quaternion,
    Transform,
    TransformStamped,
    Twist,
    Vector3,
    Wrench,
)
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage, MultiDOFJointState, PointCloud2, PointField
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray, MeshFile, UVCoordinate

from obb_collision.node.messages import cdr
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_scan import (
    ACTION,
    CONTENT,
    FILE,
    FRAME,
    ID,
    LIFETIME_NANOSEC,
    LIFETIME_SEC,
    LOCKED,
    MESH,
    NS,
    POINTS,
    SAME_FRAME,
    SAME_NS,
    STAMP_NANOSEC,
    STAMP_SEC,
    TYPE,
    Scanned,
    scan_markers,
)

int32 = st.integers(-(2**31), 2**31 - 1)
uint32 = st.integers(0, 2**32 - 1)
uint8 = st.integers(0, 255)
doubles = st.floats()
texts = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
vectors = st.builds(Vector3, x=doubles, y=doubles, z=doubles)
transforms = st.builds(
    Transform,
    translation=vectors,
    rotation=st.builds(Quaternion, x=doubles, y=doubles, z=doubles, w=doubles),
)
headers = st.builds(Header, stamp=st.builds(Time, sec=int32, nanosec=uint32), frame_id=texts)
poses = st.builds(TransformStamped, header=headers, child_frame_id=texts, transform=transforms)
states = st.builds(
    MultiDOFJointState,
    header=headers,
    joint_names=st.lists(texts, max_size=4),
    transforms=st.lists(transforms, max_size=4),
    twist=st.lists(st.builds(Twist, linear=vectors, angular=vectors), max_size=4),
    wrench=st.lists(st.builds(Wrench, force=vectors, torque=vectors), max_size=2),
)
clouds = st.builds(
    PointCloud2,
    header=headers,
    height=uint32,
    width=uint32,
    fields=st.lists(
        st.builds(PointField, name=texts, offset=uint32, datatype=uint8, count=uint32), max_size=4
    ),
    is_bigendian=st.booleans(),
    point_step=uint32,
    row_step=uint32,
    data=st.binary(max_size=20),
    is_dense=st.booleans(),
)


def seven(transform: Transform) -> list[float]:
    p, q = transform.translation, transform.rotation
    return [p.x, p.y, p.z, q.x, q.y, q.z, q.w]


def six(first: Vector3, second: Vector3) -> list[float]:
    return [first.x, first.y, first.z, second.x, second.y, second.z]


def head(header: Any) -> tuple[int, int, str]:
    return header.stamp.sec, header.stamp.nanosec, header.frame_id.partition("\0")[0]


def same_pose(read: cdr.NamedPose, message: TransformStamped) -> None:
    assert head(read.header) == head(message.header)
    assert read.name.partition("\0")[0] == message.child_frame_id
    np.testing.assert_array_equal(read.pose, [seven(message.transform)])


def same_states(read: cdr.NamedStates, message: MultiDOFJointState) -> None:
    assert head(read.header) == head(message.header)
    assert [name.partition("\0")[0] for name in read.names] == list(message.joint_names)
    given = np.array([seven(transform) for transform in message.transforms]).reshape(-1, 7)
    np.testing.assert_array_equal(read.poses, given)
    given = np.array([six(one.linear, one.angular) for one in message.twist]).reshape(-1, 6)
    np.testing.assert_array_equal(read.twists, given)


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
    cloud = cdr.cloud_from_bytes(serialize_message(PointCloud2(data=bytes(8))))
    assert not memoryview(cloud.data).readonly


singles = st.floats(width=32, allow_nan=False)
octets = st.binary(max_size=9)
colors = st.builds(ColorRGBA, r=singles, g=singles, b=singles, a=singles)
few_headers = st.builds(
    Header, stamp=st.builds(Time, sec=int32, nanosec=uint32), frame_id=st.sampled_from(["", "map"])
)
markers = st.builds(
    Marker,
    header=few_headers,
    ns=st.one_of(texts, st.sampled_from(["", "a", "crate"])),
    id=int32,
    type=int32,
    action=int32,
    pose=st.builds(
        Pose,
        position=st.builds(Point, x=doubles, y=doubles, z=doubles),
        orientation=st.builds(Quaternion, x=doubles, y=doubles, z=doubles, w=doubles),
    ),
    scale=st.builds(Vector3, x=doubles, y=doubles, z=doubles),
    color=colors,
    lifetime=st.builds(Duration, sec=int32, nanosec=uint32),
    frame_locked=st.booleans(),
    points=st.lists(st.builds(Point, x=doubles, y=doubles, z=doubles), max_size=3),
    colors=st.lists(colors, max_size=3),
    texture_resource=texts,
    texture=st.builds(CompressedImage, header=few_headers, format=texts, data=octets),
    uv_coordinates=st.lists(st.builds(UVCoordinate, u=singles, v=singles), max_size=3),
    text=texts,
    mesh_resource=texts,
    mesh_file=st.builds(MeshFile, filename=texts, data=octets),
    mesh_use_embedded_materials=st.booleans(),
)
arrays = st.builds(MarkerArray, markers=st.lists(markers, max_size=5))


def same_markers(scanned: Scanned, message: MarkerArray) -> None:
    assert len(scanned) == len(message.markers)
    for row, marker in enumerate(message.markers):
        whole, p, q, s = (
            scanned.integers[row],
            marker.pose.position,
            marker.pose.orientation,
            marker.scale,
        )
        stamp, lifetime = marker.header.stamp, marker.lifetime
        assert whole[[ID, TYPE, ACTION, LOCKED]].tolist() == [
            *(marker.id, marker.type, marker.action, marker.frame_locked)
        ]
        assert whole[[STAMP_SEC, STAMP_NANOSEC]].tolist() == [stamp.sec, stamp.nanosec]
        assert whole[[LIFETIME_SEC, LIFETIME_NANOSEC]].tolist() == [lifetime.sec, lifetime.nanosec]
        numbers = [p.x, p.y, p.z, q.x, q.y, q.z, q.w, s.x, s.y, s.z]
        np.testing.assert_array_equal(scanned.floats[row], numbers)
        for column, text in (
            (FRAME, marker.header.frame_id),
            (NS, marker.ns),
            (MESH, marker.mesh_resource),
            (FILE, marker.mesh_file.filename),
        ):
            assert scanned.text(row, column).partition(b"\0")[0].decode(errors="replace") == text
        points = [(point.x, point.y, point.z) for point in marker.points]
        np.testing.assert_array_equal(scanned.points(row), np.array(points).reshape(-1, 3))
        assert bytes(scanned.content(row)) == bytes(marker.mesh_file.data)


def read_markers(data: bytes) -> Scanned:
    """Return a scan, all of which is within the message."""
    scanned = scan_markers(data)
    for column, size in ((FRAME, 1), (NS, 1), (POINTS, 24), (MESH, 1), (FILE, 1), (CONTENT, 1)):
        at, count = scanned.integers[:, column], scanned.integers[:, column + 1]
        assert ((at >= 0) & (count >= 0) & (at + count * size <= len(data))).all()
    return scanned


@given(arrays)
def test_a_marker_has_the_namespace_and_frame_of_the_one_before_or_others(
    message: MarkerArray,
) -> None:
    data = serialize_message(message)
    whole, read = scan_markers(data).integers, message.markers
    for row in range(1, len(read)):
        assert bool(whole[row, SAME_NS]) == (read[row].ns == read[row - 1].ns)
        frames = read[row].header.frame_id, read[row - 1].header.frame_id
        assert bool(whole[row, SAME_FRAME]) == (frames[0] == frames[1])


def test_other_encodings_go_by_way_of_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    message = MarkerArray(markers=[Marker(ns="a", id=7)])
    data = serialize_message(message)
    with pytest.raises(RefusedError, match=cdr.MALFORMED):
        scan_markers(b"\x12\x34" + data[2:])
    monkeypatch.setattr(cdr, "deserialize_message", lambda *_: message)
    assert scan_markers(b"\0\7" + data[2:]).integers[0, ID] == 7


KINDS: dict[str, tuple[Any, Callable[[bytes], Any], Callable[[Any, Any], None]]] = {
    "pose": (poses, cdr.pose_from_bytes, same_pose),
    "states": (states, cdr.states_from_bytes, same_states),
    "cloud": (clouds, cdr.cloud_from_bytes, same_cloud),
    "markers": (arrays, read_markers, same_markers),
}
kinds = each("kind", KINDS)


@kinds
@given(st.data())
def test_messages_are_read_field_by_field_as_rclpy_reads_them(kind: str, draw: Any) -> None:
    strategy, read, same = KINDS[kind]
    message = draw.draw(strategy)
    data = serialize_message(message)
    same(read(data), deserialize_message(data, type(message)))


@kinds
@settings(max_examples=120)
@given(st.data())
def test_damaged_messages_are_refused_or_read_as_rclpy_reads_them(kind: str, draw: Any) -> None:
    strategy, read, same = KINDS[kind]
    message = draw.draw(strategy)
    data = bytearray(serialize_message(message))
    for _ in range(draw.draw(st.integers(1, 4))):
        data[draw.draw(st.integers(4, len(data) - 1))] = draw.draw(uint8)
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
    "states": (
        MultiDOFJointState(
            header=MAP, joint_names=["a/1"], transforms=[Transform()], twist=[Twist()]
        ),
        6,
    ),
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

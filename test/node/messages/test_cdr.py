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

"""Poses, states and clouds out of serialised bytes: as rclpy reads them, or refused."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from each import each
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Twist, Vector3, Wrench
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import MultiDOFJointState, PointCloud2, PointField
from std_msgs.msg import Header

from obb_collision.node.messages import cdr
from obb_collision.node.messages.errors import RefusedError

int32 = st.integers(-(2**31), 2**31 - 1)
uint32 = st.integers(0, 2**32 - 1)
uint8 = st.integers(0, 255)
doubles = st.floats(allow_nan=False)
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


KINDS: dict[str, tuple[Any, Callable[[bytes], Any], Callable[[Any, Any], None]]] = {
    "pose": (poses, cdr.pose_from_bytes, same_pose),
    "states": (states, cdr.states_from_bytes, same_states),
    "cloud": (clouds, cdr.cloud_from_bytes, same_cloud),
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


@kinds
def test_every_message_that_is_cut_short_or_goes_on_is_refused(kind: str) -> None:
    header = Header(frame_id="map")
    message = {
        "pose": TransformStamped(header=header, child_frame_id="a/1"),
        "states": MultiDOFJointState(
            header=header, joint_names=["a/1"], transforms=[Transform()], twist=[Twist()]
        ),
        "cloud": PointCloud2(header=header, fields=[PointField(name="x")], data=bytes(5)),
    }[kind]
    read, data = KINDS[kind][1], serialize_message(message)
    end = len(data) - 3 if kind == "cloud" else len(data)  # padded to four bytes behind a boolean
    for size in range(end):
        with pytest.raises(RefusedError, match=cdr.MALFORMED):
            read(data[:size])
    read(data + bytes(4))
    with pytest.raises(RefusedError, match="behind the last"):
        read(data + bytes(100))


@kinds
@each("length", [2**31 - 1, 2**31, 2**32 - 1, 2**32 - 8, 2**24])
def test_enormous_lengths_are_refused_wherever_they_stand(kind: str, length: int) -> None:
    text = "a"
    message = {
        "pose": TransformStamped(header=Header(frame_id=text), child_frame_id=text),
        "states": MultiDOFJointState(joint_names=[text], transforms=[Transform()], twist=[Twist()]),
        "cloud": PointCloud2(fields=[PointField(name=text)], data=bytes(5)),
    }[kind]
    lengths = {"pose": 2, "states": 6, "cloud": 4}[kind]
    read, data = KINDS[kind][1], serialize_message(message)
    refused = 0
    for at in range(4, len(data) - 3, 4):
        try:
            read(data[:at] + length.to_bytes(4, "little") + data[at + 4 :])
        except RefusedError:
            refused += 1
    assert refused >= lengths


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

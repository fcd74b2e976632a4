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

"""Markers out of serialised bytes: as rclpy reads them, and nothing from a damaged message."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Duration, Time
from each import each
from geometry_msgs.msg import Point, Pose, Quaternion, Vector3
from rclpy._rclpy_pybind11 import RMWError
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray, MeshFile, UVCoordinate

from obb_collision.node.messages import cdr
from obb_collision.node.messages.cdr import MALFORMED
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
    scan_markers,
)

int32 = st.integers(-(2**31), 2**31 - 1)
uint32 = st.integers(0, 2**32 - 1)
doubles = st.floats(allow_nan=True, allow_infinity=True)
singles = st.floats(width=32, allow_nan=False)
texts = st.text(st.characters(exclude_characters="\0", codec="utf-8"), max_size=9)
octets = st.binary(max_size=9)
triples = st.tuples(doubles, doubles, doubles)
colors = st.builds(ColorRGBA, r=singles, g=singles, b=singles, a=singles)
headers = st.builds(
    Header, stamp=st.builds(Time, sec=int32, nanosec=uint32), frame_id=st.sampled_from(["", "map"])
)
markers = st.builds(
    Marker,
    header=headers,
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
    texture=st.builds(CompressedImage, header=headers, format=texts, data=octets),
    uv_coordinates=st.lists(st.builds(UVCoordinate, u=singles, v=singles), max_size=3),
    text=texts,
    mesh_resource=texts,
    mesh_file=st.builds(MeshFile, filename=texts, data=octets),
    mesh_use_embedded_materials=st.booleans(),
)
arrays = st.builds(MarkerArray, markers=st.lists(markers, max_size=5))


def same_as(data: bytes, message: MarkerArray) -> None:
    """Assert that a scan gives what rclpy made of the same bytes."""
    scanned = scan_markers(data)
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


@given(arrays)
def test_markers_are_read_field_by_field_as_rclpy_reads_them(message: MarkerArray) -> None:
    data = serialize_message(message)
    same_as(data, deserialize_message(data, MarkerArray))
    whole, read = scan_markers(data).integers, message.markers
    for row in range(1, len(read)):
        assert bool(whole[row, SAME_NS]) == (read[row].ns == read[row - 1].ns)
        frames = read[row].header.frame_id, read[row - 1].header.frame_id
        assert bool(whole[row, SAME_FRAME]) == (frames[0] == frames[1])


@settings(max_examples=120)
@given(arrays, st.data())
def test_damaged_messages_are_refused_or_read_within_their_bytes(
    message: MarkerArray, draw: Any
) -> None:
    data = bytearray(serialize_message(message))
    for _ in range(draw.draw(st.integers(1, 4))):
        at = draw.draw(st.integers(2, len(data) - 1))
        data[at] = draw.draw(st.integers(0, 255))
    cut = draw.draw(st.one_of(st.just(len(data)), st.integers(0, len(data))))
    damaged = bytes(data[:cut])
    with suppress(RefusedError):
        scanned = scan_markers(damaged)
        for column, size in ((FRAME, 1), (NS, 1), (POINTS, 24), (MESH, 1), (FILE, 1), (CONTENT, 1)):
            at, count = scanned.integers[:, column], scanned.integers[:, column + 1]
            assert ((at >= 0) & (count >= 0) & (at + count * size <= len(damaged))).all()
        with suppress(RMWError):
            same_as(damaged, deserialize_message(damaged, MarkerArray))


LENGTHS = [2**31 - 1, 2**31, 2**32 - 1, 2**32 - 8, 2**24]


@each("length", LENGTHS)
def test_enormous_lengths_are_refused_wherever_they_stand(length: int) -> None:
    marker = Marker(ns="abc", text="t", points=[Point()], colors=[ColorRGBA()])
    marker.mesh_file.data = b"123"
    data = serialize_message(MarkerArray(markers=[marker, marker]))
    refused = 0
    for at in range(4, len(data) - 3, 4):
        damaged = data[:at] + length.to_bytes(4, "little") + data[at + 4 :]
        try:
            scanned = scan_markers(damaged)
        except RefusedError:
            refused += 1
        else:
            assert len(scanned) == 2, "it was no length"
    assert refused >= 2 * 13


def test_every_message_that_is_cut_short_is_refused() -> None:
    data = serialize_message(MarkerArray(markers=[Marker(ns="a", points=[Point()])] * 2))
    for end in range(len(data)):
        with pytest.raises(RefusedError, match=MALFORMED):
            scan_markers(data[:end])
    assert len(scan_markers(data + bytes(3))) == 2, "payloads are padded"
    with pytest.raises(RefusedError, match="behind the last"):
        scan_markers(data + bytes(100))


def test_other_encodings_go_by_way_of_rclpy(monkeypatch: pytest.MonkeyPatch) -> None:
    message = MarkerArray(markers=[Marker(ns="a", id=7)])
    data = serialize_message(message)
    with pytest.raises(RefusedError, match=MALFORMED):
        scan_markers(b"\x12\x34" + data[2:])
    monkeypatch.setattr(cdr, "deserialize_message", lambda *_: message)
    assert scan_markers(b"\0\7" + data[2:]).integers[0, ID] == 7

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

"""Clouds whose headers contradict themselves: refused, and never read beyond what was sent."""

from __future__ import annotations

import tracemalloc
from array import array
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from each import each
from rclpy.serialization import deserialize_message
from rig import pose
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from obb_collision.node import poses_from_ros, poses_to_ros
from obb_collision.node.messages.clouds import (
    DATATYPES,
    POSE_FIELDS,
    cloud_to_bytes,
    cloud_to_ros,
    field_bytes,
    points_from_ros,
)
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.errors import RefusedError

NAMES = (*POSE_FIELDS, "id", "ns", "intensity", "")
EDGES = (0, 1, 4, 8, 31, 60, 2**16, 2**31 - 60, 2**31 - 4, 2**31, 2**32 - 4, 2**32 - 1)
small = st.integers(0, 80)
whole = st.sampled_from(EDGES) | small | st.integers(0, 2**32 - 1)
fields = st.builds(
    PointField,
    name=st.sampled_from(NAMES),
    offset=whole,
    datatype=st.sampled_from((*DATATYPES, 0, 9, 255)),
    count=st.sampled_from((0, 1, 1, 1, 2, 2**32 - 1)),
)
READERS: dict[str, Callable[[PointCloud2], Any]] = {
    "points": points_from_ros,
    "poses": lambda message: poses_from_ros(message)[2],
}


def cloud(data: bytes, **header: Any) -> PointCloud2:
    message = PointCloud2(**header)
    message.data = array("B", data)
    return message


def xyz(*offsets: int, datatype: int = PointField.FLOAT32) -> list[PointField]:
    return [
        PointField(name=name, offset=offset, datatype=datatype, count=1)
        for name, offset in zip("xyz", offsets, strict=True)
    ]


def good_poses(count: int = 2) -> PointCloud2:
    return poses_to_ros(range(count), np.tile(pose(0.0), (count, 1)), [0] * count)


def read(reader: Callable[[PointCloud2], Any], message: PointCloud2) -> int | None:
    """Return the number of rows read, None where refused; nothing but RefusedError is raised."""
    limit = 100 * len(message.data) + 1_000_000
    refused = None
    tracemalloc.start()
    try:
        rows = reader(message)
        np.isfinite(rows).sum()  # reads every byte of it
    except RefusedError as error:
        refused = error.reason
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < limit, "more copied than the message holds"
    assert refused in (None, "field layout")
    return None if refused else len(rows)


@each("reader", READERS)
@given(
    found=st.lists(fields, max_size=12),
    extra=st.lists(small, min_size=3, max_size=3),
    header=st.fixed_dictionaries(
        dict.fromkeys(("width", "height", "point_step", "row_step"), whole)
    ),
    big=st.booleans(),
    data=st.binary(max_size=400),
)
def test_whatever_the_header_says_a_cloud_is_read_within_its_data_or_refused(
    reader: str,
    found: list[PointField],
    extra: list[int],
    header: dict[str, int],
    big: bool,
    data: bytes,
) -> None:
    message = cloud(data, fields=[*xyz(*extra), *found], is_bigendian=big, **header)
    count = read(READERS[reader], message)
    if count:
        assert count == header["width"] * header["height"]
        assert count * header["point_step"] <= len(data)


@each("reader", READERS)
@given(
    name=st.sampled_from((*POSE_FIELDS, "id", "ns")),
    offset=whole,
    changes=st.dictionaries(
        st.sampled_from(("width", "height", "point_step", "row_step")), whole, max_size=2
    ),
)
def test_one_wrong_number_in_a_good_cloud_is_refused_or_harmless(
    reader: str, name: str, offset: int, changes: dict[str, int]
) -> None:
    message = good_poses()
    for key, value in changes.items():
        setattr(message, key, value)
    (wrong,) = [field for field in message.fields if field.name == name]
    wrong.offset = offset
    count = read(READERS[reader], message)
    if count:
        assert count * message.point_step <= len(message.data)
    used = reader == "poses" or name in "xyz"
    if used and offset > message.point_step:
        assert count is None


@given(width=whole, height=whole, step=st.sampled_from((0, 12, 16)), row_step=whole)
def test_points_are_those_at_their_places(
    width: int, height: int, step: int, row_step: int
) -> None:
    data = np.arange(64, dtype="<f4").tobytes()
    rows = row_step or width * step
    fits = step > 0 and rows >= width * step and (height - 1) * rows + width * step <= len(data)
    message = cloud(
        data, fields=xyz(0, 4, 8), width=width, height=height, point_step=step, row_step=row_step
    )
    assume(width * height > 0)
    if not fits:
        assert read(points_from_ros, message) is None
        return
    expected = [
        [(line * rows + place * step) // 4 + k for k in range(3)]
        for line in range(height)
        for place in range(width)
    ]
    if rows % 4 == 0:
        assert points_from_ros(message).tolist() == expected


HOSTILE: dict[str, PointCloud2] = {
    "an offset near 2^31": cloud(
        bytes(24), fields=xyz(0, 4, 2**31 - 4), width=2, height=1, point_step=12
    ),
    "an offset at which the size wraps": cloud(
        bytes(24), fields=xyz(2**31 - 2, 4, 8), width=2, height=1, point_step=12
    ),
    "2^32-1 by 2^32-1 points of no size": cloud(
        b"", fields=xyz(0, 4, 8), width=2**32 - 1, height=2**32 - 1, point_step=0
    ),
    "no size and no known field": cloud(
        bytes(60_000), width=2**32 - 1, height=60_000, point_step=0, row_step=1
    ),
    "rows that overlap": cloud(
        bytes(60_011), fields=xyz(0, 4, 8), width=1, height=60_000, point_step=12, row_step=1
    ),
    "a point larger than the data": cloud(
        bytes(12), fields=xyz(0, 4, 8), width=1, height=1, point_step=2**32 - 1
    ),
    "no point, of the largest size": cloud(
        b"", fields=xyz(0, 4, 8), width=0, height=1, point_step=2**32 - 1
    ),
    "a field twice": cloud(
        bytes(24),
        fields=[*xyz(0, 4, 8), PointField(name="x", offset=12, datatype=7, count=1)],
        width=1,
        height=1,
        point_step=24,
    ),
}


@each("what", HOSTILE)
@each("reader", READERS)
def test_hostile_headers_are_refused(reader: str, what: str) -> None:
    assert read(READERS[reader], HOSTILE[what]) is None


def test_fields_that_nobody_asks_for_may_be_anything() -> None:
    message = good_poses()
    odd = PointField(name="intensity", offset=2**32 - 1, datatype=PointField.FLOAT64, count=1)
    message.fields = [odd, *message.fields, odd]
    assert read(READERS["poses"], message) == 2


@each("change", [{"datatype": 99}, {"count": 2}])
@each("name", ["ns", "id", "x"])
def test_a_field_that_is_no_number_is_named(name: str, change: dict[str, int]) -> None:
    message = good_poses()  # without its namespaces it would be about other objects
    (field,) = [field for field in message.fields if field.name == name]
    for key, value in change.items():
        setattr(field, key, value)
    with pytest.raises(RefusedError) as refusal:
        poses_from_ros(message)
    assert f"field {name!r} has datatype {field.datatype}" in refusal.value.detail


@each("frame", ["", "map", "a/longer_frame", "\N{GREEK SMALL LETTER MU}"])
@each("count", [0, 1, 5])
def test_clouds_that_are_written_as_bytes_are_the_messages(frame: str, count: int) -> None:
    layout = [("x", "f4"), ("depth", "f8"), ("ns_a", "i4"), ("verdict", "u1"), ("late", "i2")]
    rows = np.zeros(count, np.dtype(layout, align=True))
    rows["x"], rows["depth"], rows["late"] = 0.5, np.arange(count) / 3.0, -7
    for _ in range(2 if count else 1):
        stamp = 7_000_000_005
        message = cloud_to_ros(rows, Header(stamp=stamp_to_ros(stamp), frame_id=frame))
        data = cloud_to_bytes(rows, stamp, frame, field_bytes(rows.dtype))
        assert deserialize_message(data, PointCloud2) == message
        rows["x"][:1] = np.nan  # is_dense

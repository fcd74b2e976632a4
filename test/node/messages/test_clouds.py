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

"""Messages <-> arrays: bit for bit by round trip, or refused and never read beyond their data."""

from __future__ import annotations

import tracemalloc
from array import array
from collections.abc import Callable
from operator import add
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from each import each
from hypothesis import assume, example, given
from hypothesis import strategies as st
from rclpy.serialization import deserialize_message, serialize_message
from rig import pose
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header

from obb_collision import Verdict
from obb_collision.node import collisions_to_ros, named_pairs, namespace_number, poses_from_ros
from obb_collision.node.messages import clouds
from obb_collision.node.messages import conversions as cv
from obb_collision.node.messages.cdr import states_from_bytes
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.topics.topics import COLLISIONS

NAMES = (*clouds.POSE_FIELDS, *clouds.SIZE_FIELDS, "id", "ns", "intensity", "")
EDGES = (0, 1, 4, 8, 31, 60, 2**16, 2**31 - 60, 2**31 - 4, 2**31, 2**32 - 4, 2**32 - 1)
small = st.integers(0, 80)
whole = st.sampled_from(EDGES) | small | st.integers(0, 2**32 - 1)
fields = st.builds(
    PointField,
    name=st.sampled_from(NAMES),
    offset=whole,
    datatype=st.sampled_from((*clouds.DATATYPES, 0, 9, 255)),
    count=st.sampled_from((0, 1, 1, 1, 2, 2**32 - 1)),
)
READERS: dict[str, Callable[[PointCloud2], Any]] = {
    "points": clouds.points_from_ros,
    "poses": lambda message: poses_from_ros(message)[2],
    "boxes": lambda message: clouds.boxes_from_ros(message)[3],
}


def cloud(data: bytes, fields: Any, width: int, height: int, step: int, **more: Any) -> PointCloud2:
    more |= {"width": width, "height": height, "point_step": step}
    return PointCloud2(data=data, fields=fields, **more)


def xyz(*offsets: int, datatype: int = PointField.FLOAT32) -> list[PointField]:
    return [
        PointField(name=name, offset=offset, datatype=datatype, count=1)
        for name, offset in zip("xyz", offsets, strict=True)
    ]


def good_poses(count: int = 2) -> PointCloud2:
    poses = np.tile(pose(0.0), (count, 1))
    return clouds.boxes_to_ros(range(count), poses, np.ones((count, 3)), [0] * count)


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


sizes = st.sampled_from(("width", "height", "point_step", "row_step"))
places = st.builds(xyz, small, small, small)
more_fields = st.lists(fields, max_size=12)
numbers = {"row_step": whole, "is_bigendian": st.booleans()}
some = st.binary(max_size=400), st.builds(add, places, more_fields), whole, whole, whole


@each("reader", READERS)
@given(st.builds(cloud, *some, **numbers))
def test_a_cloud_is_read_within_its_data_or_refused(reader: str, message: PointCloud2) -> None:
    count = read(READERS[reader], message)
    if count:
        assert count == message.width * message.height
        assert count * message.point_step <= len(message.data)


@each("reader", READERS)
@given(
    name=st.sampled_from((*clouds.POSE_FIELDS, *clouds.SIZE_FIELDS, "id", "ns")),
    offset=whole,
    changes=st.dictionaries(sizes, whole, max_size=2),
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
    used = name not in clouds.SIZE_FIELDS if reader == "poses" else name in "xyz"
    if (used or reader == "boxes") and offset > message.point_step:
        assert count is None


@example(4, 4, 16, 256)  # row_step is that of the whole cloud, as RViz reads it, too
@given(width=whole, height=whole, step=st.sampled_from((0, 12, 16)), row_step=whole)
def test_points_are_read_at_their_places(width: int, height: int, step: int, row_step: int) -> None:
    data = np.arange(64, dtype="<f4").tobytes()
    rows = row_step or width * step
    if height > 1 and rows == width * height * step == len(data):
        rows = width * step
    fits = step > 0 and rows >= width * step and (height - 1) * rows + width * step <= len(data)
    message = cloud(data, xyz(0, 4, 8), width, height, step, row_step=row_step)
    assume(width * height > 0)
    if not fits:
        assert read(clouds.points_from_ros, message) is None
        return
    if rows % 4 == 0:
        starts = (np.arange(height)[:, None] * rows + np.arange(width) * step) // 4
        expected = starts.reshape(-1, 1) + np.arange(3)
        assert clouds.points_from_ros(message).tolist() == expected.tolist()


MOST = 2**32 - 1
HOSTILE = {
    "2^32-1 by 2^32-1 points of no size": cloud(b"", xyz(0, 4, 8), MOST, MOST, 0),
    "no size and no known field": cloud(bytes(60_000), [], MOST, 60_000, 0, row_step=1),
    "rows that overlap": cloud(bytes(60_011), xyz(0, 4, 8), 1, 60_000, 12, row_step=1),
    "a field twice": cloud(bytes(24), [*xyz(0, 4, 8), xyz(12, 16, 20)[0]], 1, 1, 24),
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


@each("frame", ["", "map", "a/longer_frame", "\N{GREEK SMALL LETTER MU}"])
@each("count", [0, 1, 5])
def test_clouds_are_written_as_rclpy_reads_them(frame: str, count: int) -> None:
    layout = [("x", "f4"), ("depth", "f8"), ("ns_a", "i4"), ("verdict", "u1"), ("late", "i2")]
    rows = np.zeros(count, np.dtype(layout, align=True))
    rows["x"], rows["depth"], rows["late"] = np.nan, np.arange(count) / 3.0, -7
    data = clouds.cloud_to_bytes(rows, 7_000_000_005, frame, clouds.field_bytes(rows.dtype))
    message = deserialize_message(data, PointCloud2)
    header = Header(stamp=stamp_to_ros(7_000_000_005), frame_id=frame)
    assert message == clouds.cloud_to_ros(rows, header)
    assert message.header == header
    assert (message.height, message.width, message.is_dense) == (1, count, not count)
    assert [(f.name, f.offset, f.datatype, f.count) for f in message.fields] == [
        (name, rows.dtype.fields[name][1], kind, 1)  # type: ignore[index]
        for name, kind in zip(rows.dtype.names or (), (7, 8, 5, 2, 3), strict=True)
    ]
    assert bytes(message.data) == rows.tobytes()


finite = st.floats(allow_nan=False, allow_infinity=False)
poses = st.lists(finite, min_size=7, max_size=7)
pose_rows = st.lists(poses, max_size=6)
float_kinds = st.sampled_from(("f4", "f8"))
integer_kinds = st.sampled_from(("i1", "u1", "i2", "u2", "i4", "u4"))
formats = dict.fromkeys(clouds.POSE_FIELDS, float_kinds)
formats |= {"ns": integer_kinds, "id": integer_kinds, "intensity": st.just("f4")}


@given(pose_rows, st.integers(0, 2**31 * 10**9 - 1), st.floats(0.0, 1e6))
def test_messages_come_back_exactly(rows: list[list[float]], nanoseconds: int, span: float) -> None:
    for values in rows:
        p, q = (pose := cv.pose_to_ros(values)).position, pose.orientation
        assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == values
        assert cv.transform_from_ros(cv.transform_to_ros(values)).tolist() == values
    names = [f"a/{number}" for number in range(len(rows))]
    message = cv.states_to_ros(names, np.array(rows).reshape(-1, 7))
    read = states_from_bytes(serialize_message(message))
    assert (read.names, read.poses.tolist()) == (names, rows)
    assert cv.stamp_from_ros(cv.stamp_to_ros(nanoseconds)) == nanoseconds
    found = cv.duration_to_ros(span)
    assert found.sec * 10**9 + found.nanosec == round(span * 1e9)


@given(st.lists(st.text(st.characters(exclude_characters="\0", codec="utf-8")), max_size=15))
def test_the_namespace_table_comes_back(names: list[str]) -> None:
    table = {namespace_number(name): name for name in names}
    message = cv.namespaces_to_ros(table)
    wire = deserialize_message(serialize_message(message), DiagnosticStatus)
    assert cv.namespace_table(wire) == table
    assert cv.namespace_table(names) == table == cv.namespace_table(table)


@given(
    pose_rows,
    st.fixed_dictionaries(formats).flatmap(lambda found: st.permutations([*found.items()])),
    st.lists(st.integers(0, 9), min_size=11, max_size=11),
    st.sampled_from("<>"),
)
def test_clouds_are_read_by_name_whatever_their_layout(
    rows: list[list[float]], layout: list[tuple[str, str]], padding: list[int], order: str
) -> None:
    begins, end = list[int](), 0
    for (_, kind), gap in zip(layout, padding, strict=False):
        begins.append(end + gap)
        end = begins[-1] + int(kind[1])
    names, codes = [name for name, _ in layout], [order + kind for _, kind in layout]
    end += padding[-1]
    found: Any = {"names": names, "formats": codes, "offsets": begins, "itemsize": end}
    cloud = np.zeros(len(rows), np.dtype(found))
    with np.errstate(over="ignore"):
        for column, name in enumerate(clouds.POSE_FIELDS):
            cloud[name] = [row[column] for row in rows]
    cloud["id"], cloud["ns"] = np.arange(len(rows)) + 100, np.arange(len(rows))
    wire = deserialize_message(serialize_message(clouds.cloud_to_ros(cloud)), PointCloud2)
    assert wire.is_bigendian == (order == ">")
    namespaces, ids, got = poses_from_ros(wire)
    assert namespaces is not None
    assert namespaces.tolist() == cloud["ns"].tolist()
    assert ids.tolist() == cloud["id"].tolist()
    expected = np.array([cloud[name].astype(float) for name in clouds.POSE_FIELDS]).T.reshape(-1, 7)
    np.testing.assert_array_equal(got, expected)


NO_NUMBERS = [{"datatype": 99}, {"count": 2}]
WRONG: list[tuple[str, dict[str, Any], str]] = [
    ("id", {"name": "other"}, "no field 'id'"),
    ("qw", {"name": "other"}, "no field 'qw'"),
    ("id", {"datatype": PointField.FLOAT32}, "'id' is not an integer"),
    ("y", {"datatype": PointField.INT32}, "'y' is not a float"),
    ("z", {"offset": 100}, "field layout"),
    ("", {"data": bytes(119)}, "bytes of data"),
    ("", {"point_step": 0}, "field layout"),
    *((name, wrong, f"field {name!r} has datatype") for name in ("ns", "id", "x")
      for wrong in NO_NUMBERS),  # without its namespaces it would be about other objects
]  # fmt: skip
"""By a field, or nothing for the message: what is set to what, and what is said then."""


@each("name, values, reason", WRONG)
def test_wrong_layouts_are_refused_and_why(name: str, values: dict[str, Any], reason: str) -> None:
    message: Any = good_poses()
    fields = {field.name: field for field in message.fields}
    for key, value in values.items():
        setattr(fields.get(name, message), key, value)
    with pytest.raises(RefusedError, match=reason):
        poses_from_ros(message)
    if name not in ("id", "qw", "ns"):
        with pytest.raises(RefusedError, match=reason):
            clouds.points_from_ros(message)


def test_pairs_get_their_names_in_one_line() -> None:
    rows = np.zeros(1, COLLISIONS.dtype)
    rows["ns_a"] = namespace_number("arm")
    rows[["id_a", "id_b", "depth", "verdict"]] = (-3, 8, 0.25, Verdict.OVERLAP)
    message = collisions_to_ros(rows)
    table = cv.namespaces_to_ros(["arm", ""])
    assert named_pairs(message, table) == [("arm/-3", "/8", 0.25, False)]
    numbered = {namespace_number("arm"): "arm", 0: ""}
    assert named_pairs(message, ["arm", ""]) == named_pairs(message, numbered)
    with pytest.raises(RefusedError, match="unknown namespace"):
        named_pairs(message, ["arm"])
    with pytest.raises(RefusedError, match="not a collisions message"):
        named_pairs(clouds.poses_to_ros([1], np.zeros((1, 7))), table)


def plain(value: Any) -> Any:
    """Return a message as readers of recordings give it: an object of their own, by its fields."""
    if isinstance(value, array):
        return value.tobytes()
    if isinstance(value, list):
        return [plain(one) for one in value]
    names: Any = getattr(value, "get_fields_and_field_types", dict)()
    return SimpleNamespace(**{one: plain(getattr(value, one)) for one in names}) if names else value


def read_by_rosbags(message: Any) -> Any:
    types = pytest.importorskip("rosbags.typesys")
    name = f"{type(message).__module__.partition('.')[0]}/msg/{type(message).__name__}"
    store = types.get_typestore(types.Stores.ROS2_JAZZY)
    return store.deserialize_cdr(serialize_message(message), name)


@each("read", [plain, read_by_rosbags])
def test_recorded_messages_get_their_names_whatever_has_read_them(read: Any) -> None:
    rows = np.zeros(1, COLLISIONS.dtype)
    rows["ns_a"], rows["ns_b"] = map(namespace_number, ("arm", ""))
    rows["id_a"], rows["id_b"], rows["depth"] = 3, 5, 0.25
    cloud = clouds.cloud_to_ros(rows, Header())
    named = named_pairs(read(cloud), read(cv.namespaces_to_ros(["arm", ""])))
    assert [row[:3] for row in named] == [("arm/3", "/5", 0.25)]


def test_faults_of_poses_are_told_apart() -> None:
    rows = np.array([[1.0] * 7] * 6)
    rows[1, 0], rows[2, 5], rows[3, 1], rows[4, 3:] = np.nan, np.inf, 1.1e300, 0.0
    rows[5, 3:] = 0.5
    kinds = [cv.FAR, cv.UNUSABLE, cv.UNUSABLE, cv.UNUSABLE, cv.ZERO, cv.GOOD]
    assert cv.pose_kinds(rows).tolist() == kinds
    assert cv.unusable_poses(rows).tolist() == [False, True, True, True, True, False]
    assert len(cv.unusable_poses(np.empty((0, 7)))) == 0


@each("sec, nanosec", [(-1, 0), (2**31 - 1, 2**32 - 1), (0, 10**9)])
def test_stamps_that_no_clock_gives_are_refused(sec: int, nanosec: int) -> None:
    with pytest.raises(RefusedError, match="bad stamp"):
        cv.stamp_from_ros(Time(sec=sec, nanosec=nanosec))

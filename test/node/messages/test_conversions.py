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

"""Messages <-> arrays by round trip: every double comes back bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

pytest.importorskip("rclpy")
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from each import each
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2, PointField

from obb_collision import Verdict
from obb_collision.node import (
    collisions_from_ros,
    collisions_to_ros,
    named_pairs,
    namespace_number,
)
from obb_collision.node.messages import conversions as cv
from obb_collision.node.messages.cdr import states_from_bytes
from obb_collision.node.messages.clouds import (
    POSE_FIELDS,
    cloud_to_ros,
    poses_from_ros,
    poses_to_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.topics.topics import COLLISIONS

numbers = st.floats(allow_nan=False, allow_infinity=False)
poses = st.lists(numbers, min_size=7, max_size=7)
pose_rows = st.lists(poses, max_size=6)
INTEGERS = ("i1", "u1", "i2", "u2", "i4", "u4")


@given(poses)
def test_poses_and_transforms_come_back_bit_for_bit(values: list[float]) -> None:
    p, q = (pose := cv.pose_to_ros(values)).position, pose.orientation
    assert [p.x, p.y, p.z, q.x, q.y, q.z, q.w] == values
    assert cv.transform_from_ros(cv.transform_to_ros(values)).tolist() == values


@given(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1))
def test_stamps_come_back(seconds: int, rest: int) -> None:
    nanoseconds = seconds * 10**9 + rest
    assert cv.stamp_from_ros(cv.stamp_to_ros(nanoseconds)) == nanoseconds


@given(st.floats(0.0, 1e6))
def test_durations_come_back_to_the_nanosecond(seconds: float) -> None:
    found = cv.duration_to_ros(seconds)
    assert found.sec * 10**9 + found.nanosec == round(seconds * 1e9)


@given(pose_rows)
def test_states_come_back_over_the_wire(rows: list[list[float]]) -> None:
    names = [f"a/{number}" for number in range(len(rows))]
    message = cv.states_to_ros(names, np.array(rows).reshape(-1, 7))
    read = states_from_bytes(serialize_message(message))
    assert read.names == names
    assert read.poses.tolist() == rows


@given(st.lists(st.text(st.characters(exclude_characters="\0", codec="utf-8")), max_size=15))
def test_the_namespace_table_comes_back(names: list[str]) -> None:
    table = {namespace_number(name): name for name in names}
    message = cv.namespaces_to_ros(table)
    wire = deserialize_message(serialize_message(message), DiagnosticStatus)
    assert cv.namespaces_from_ros(wire) == table == cv.namespace_table(wire)
    assert cv.namespace_table(names) == table == cv.namespace_table(table)


@given(
    rows=pose_rows,
    order=st.permutations([*POSE_FIELDS, "ns", "id", "intensity"]),
    padding=st.lists(st.integers(0, 9), min_size=11, max_size=11),
    big=st.booleans(),
    kinds=st.tuples(st.sampled_from(INTEGERS), st.sampled_from(INTEGERS)),
    floats=st.lists(st.sampled_from(("f4", "f8")), min_size=7, max_size=7),
)
def test_clouds_are_read_by_name_whatever_their_layout(
    rows: list[list[float]],
    order: list[str],
    padding: list[int],
    big: bool,
    kinds: tuple[str, str],
    floats: list[str],
) -> None:
    formats = dict(zip(POSE_FIELDS, floats, strict=True))
    formats |= {"ns": kinds[0], "id": kinds[1], "intensity": "f4"}
    offsets, end = [], 0
    for name, gap in zip(order, padding, strict=False):
        offsets.append(end + gap)
        end = offsets[-1] + int(formats[name][1])
    codes = [(">" if big else "<") + formats[name] for name in order]
    dtype = np.dtype(
        {"names": order, "formats": codes, "offsets": offsets, "itemsize": end + padding[-1]}
    )
    cloud = np.zeros(len(rows), dtype)
    with np.errstate(over="ignore"):
        for column, name in enumerate(POSE_FIELDS):
            cloud[name] = [row[column] for row in rows]
    cloud["id"], cloud["ns"] = np.arange(len(rows)) + 100, np.arange(len(rows))
    wire = deserialize_message(serialize_message(cloud_to_ros(cloud)), PointCloud2)
    assert wire.is_bigendian == big
    namespaces, ids, got = poses_from_ros(wire)
    assert namespaces is not None
    assert namespaces.tolist() == cloud["ns"].tolist()
    assert ids.tolist() == cloud["id"].tolist()
    expected = np.array([cloud[name].astype(float) for name in POSE_FIELDS]).T.reshape(-1, 7)
    np.testing.assert_array_equal(got, expected)


def test_organised_clouds_with_padded_rows_are_read() -> None:
    message = poses_to_ros([1, 2, 3, 4], np.arange(28.0).reshape(4, 7))
    data, step = bytes(message.data), message.point_step
    message.height, message.width, message.row_step = 2, 2, 2 * step + 5
    message.data = data[: 2 * step] + bytes(5) + data[2 * step :]
    assert poses_from_ros(message)[1].tolist() == [1, 2, 3, 4]


def field(message: PointCloud2, name: str) -> PointField:
    return next(found for found in message.fields if found.name == name)


def test_wrong_layouts_are_refused_with_what_is_wrong() -> None:
    def broken() -> PointCloud2:
        return poses_to_ros([1, 2], np.zeros((2, 7)))

    for name in ("id", "qw", "x"):
        message = broken()
        field(message, name).name = "other"
        with pytest.raises(RefusedError, match=f"no field '{name}'"):
            poses_from_ros(message)
    message = broken()
    field(message, "id").datatype = PointField.FLOAT32
    with pytest.raises(RefusedError, match="'id' is not an integer"):
        poses_from_ros(message)
    message = broken()
    field(message, "y").datatype = PointField.INT32
    with pytest.raises(RefusedError, match="'y' is not a float"):
        poses_from_ros(message)
    message = broken()
    message.data = message.data[:-1]
    with pytest.raises(RefusedError, match="bytes of data"):
        poses_from_ros(message)
    message = broken()
    field(message, "z").offset = message.point_step - 1
    with pytest.raises(RefusedError, match="field layout"):
        poses_from_ros(message)
    message = broken()
    message.point_step = 0
    with pytest.raises(RefusedError, match="field layout"):
        poses_from_ros(message)


def collision_rows(count: int) -> np.ndarray:
    rows = np.zeros(count, COLLISIONS.dtype)
    rng = np.random.default_rng(count)
    for name in COLLISIONS.dtype.names or ():
        whole = name[:2] in ("ns", "id") or name in ("verdict", "accuracy")
        rows[name] = rng.integers(0, 2, count) if whole else rng.normal(size=count)
    return rows


@each("count", [0, 1, 7])
def test_collisions_come_back_over_the_wire(count: int) -> None:
    rows = collision_rows(count)
    wire = deserialize_message(serialize_message(collisions_to_ros(rows)), PointCloud2)
    got = collisions_from_ros(wire)
    for name in COLLISIONS.dtype.names or ():
        np.testing.assert_array_equal(got[name], rows[name])


def test_collisions_have_the_layout_that_rviz_draws_and_the_interface_names() -> None:
    message = collisions_to_ros(collision_rows(1))
    kinds = {found.name: found.datatype for found in message.fields}
    assert list(kinds) == [
        *("x", "y", "z", "normal_x", "normal_y", "normal_z", "depth"),
        *("ns_a", "id_a", "ns_b", "id_b", "verdict", "accuracy"),
    ]
    assert {kinds[name] for name in "xyz"} == {PointField.FLOAT32}
    assert kinds["depth"] == PointField.FLOAT64


def test_pairs_get_their_names_in_one_line() -> None:
    rows = np.zeros(1, COLLISIONS.dtype)
    rows["ns_a"] = namespace_number("arm")
    rows[["id_a", "id_b", "depth", "verdict"]] = (-3, 8, 0.25, Verdict.OVERLAP)
    message = collisions_to_ros(rows)
    table = cv.namespaces_to_ros(["arm", ""])
    assert named_pairs(message, table) == [("arm/-3", "/8", 0.25, False)]
    assert named_pairs(message, ["arm", ""]) == named_pairs(
        message, {namespace_number("arm"): "arm", 0: ""}
    )
    with pytest.raises(RefusedError, match="unknown namespace"):
        named_pairs(message, ["arm"])
    with pytest.raises(RefusedError, match="not a collisions message"):
        named_pairs(poses_to_ros([1], np.zeros((1, 7))), table)


def test_faults_of_poses_are_told_apart() -> None:
    rows = np.array([[1.0] * 7] * 6)
    rows[1, 0], rows[2, 5], rows[3, 1], rows[4, 3:] = np.nan, np.inf, 1.1e300, 0.0
    numbers, quaternions = cv.pose_faults(rows)
    assert numbers.tolist() == [False, True, True, True, False, False]
    assert quaternions.tolist() == [False, False, False, False, True, False]
    assert all(len(fault) == 0 for fault in cv.pose_faults(np.empty((0, 7))))


@each("sec, nanosec", [(-1, 0), (2**31 - 1, 2**32 - 1), (0, 10**9)])
def test_stamps_that_no_clock_gives_are_refused(sec: int, nanosec: int) -> None:
    with pytest.raises(RefusedError, match="bad stamp"):
        cv.stamp_from_ros(Time(sec=sec, nanosec=nanosec))

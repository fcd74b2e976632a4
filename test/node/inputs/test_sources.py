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

"""Sensors as objects: clouds, scans and ranges on topics."""

from __future__ import annotations

import gc
import tracemalloc
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import pytest
from each import each
from rclpy.serialization import serialize_message
from rig import A1, A2, B1, FRAME, FakeFrames, Rig, cube, pose, spy
from robot_rig import RobotRig
from sensor_msgs.msg import LaserScan, PointCloud2, PointField, Range
from sensor_rig import FRONT, KINDS, Sensing, SensorRig, cloud_of, parameters_of
from std_srvs.srv import Trigger
from visualization_msgs.msg import Marker

from obb_collision import node as ros
from obb_collision.node.diagnostics.answer import COLLIDING, FREE, UNKNOWN
from obb_collision.node.inputs import sources
from obb_collision.node.inputs.clouds import QueuedCloud
from obb_collision.node.inputs.cuts import Limits, select, thin_out
from obb_collision.node.inputs.leave_out import between
from obb_collision.node.messages.conversions import stamp_to_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION
from obb_collision.shapes import Cloud

NOTHING = {"invalid": 0, "out of range": 0, "out of height": 0}


class ArmRig(Sensing, RobotRig):
    """A node with the robot ``arm`` and the sensor ``front``."""

    def __init__(
        self, frames: Any = None, more: Mapping[str, Any] | None = None, **sensor: Any
    ) -> None:
        given = parameters_of({"front": sensor}) | {"joint_timeout": 100.0} | dict(more or {})
        super().__init__(given=given, frames=frames, transform_timeout=1.0)
        self.start_sensors({"front": sensor})

    def see_at(self, stamp: int, *points: Sequence[float]) -> None:
        """Publish a cloud of a stamp (ns)."""
        message = cloud_of(points, self.header())
        message.header.stamp = stamp_to_ros(stamp)
        self.sensors["front"].publish(message)


@pytest.fixture
def front() -> Iterator[SensorRig]:
    """Yield a rig with one cloud, and a cube of one metre."""
    with SensorRig({"front": {}}) as made:
        made.send(cube(A1)).answer()
        yield made


def test_a_cloud_collides_by_name_and_is_replaced(front: SensorRig) -> None:
    front.known("unplaced", FRONT)
    front.see([[5, 0, 0], [0.505, 0, 0]])
    assert front.met() == {"a/1"}
    front.see([[5, 0, 0], [0.52, 0, 0]])
    assert front.met() == set(), "the radius is 1 cm"
    front.known()
    front.see([])
    assert front.met() == set(), "nothing seen is an answer, too"
    front.known()
    front.see([[np.nan] * 3] * 2)
    front.known("refused", FRONT)
    assert front.refused("front") == {"no valid measurement": 1}, "a lens that is covered"


def raw(rig: Rig, organised: bool, order: str, kind: str) -> PointCloud2:
    """Return a cloud of 6 points with gaps in its rows, one of them NaN, one in the cube."""
    points = np.array([[5, 0, 0], [6, 0, 0], [np.nan] * 3, [7, 0, np.inf], [0, 0, 0], [8, 0, 0]])
    width, height = (3, 2) if organised else (6, 1)
    layout: Any = {"names": [*"zxy"], "formats": [order + kind] * 3, "offsets": [1, 12, 21]}
    layout["itemsize"] = 32
    dtype = np.dtype(layout)
    rows = np.zeros((height, width), dtype)
    for column, axis in enumerate("xyz"):
        rows[axis] = points[:, column].reshape(height, width)
    step = 32 * width + 5
    data = b"".join(row.tobytes() + bytes(5) for row in rows)
    number = {"f4": PointField.FLOAT32, "f8": PointField.FLOAT64}[kind]
    fields = [
        PointField(name=axis, offset=at, datatype=number, count=1)
        for axis, at in zip("zxy", (1, 12, 21), strict=True)
    ]
    fields.append(PointField(name="rgb", offset=29, datatype=PointField.UINT8, count=3))
    message = PointCloud2(header=rig.header(), height=height, width=width, fields=fields)
    message.is_bigendian, message.point_step, message.row_step = order == ">", 32, step
    message.data = data
    return message


@each("organised", [True, False])
@each("order", ["<", ">"])
@each("kind", ["f4", "f8"])
def test_clouds_of_every_layout(front: SensorRig, organised: bool, order: str, kind: str) -> None:
    front.send(cube(A1)).answer()
    front.sensors["front"].publish(raw(front, organised, order, kind))
    assert front.met() == {"a/1"}
    assert front.cut() == {**NOTHING, "points": 6, "invalid": 2, "used": 4}


def test_a_scan_knows_nothing_of_what_is_not_a_range() -> None:
    with SensorRig({"front": {"type": "scan"}}) as rig:
        rig.send(cube(A1, (0, 1, 0)), cube(A2, (-0.05, 0, 0), (0.02, 0.5, 1))).answer()
        rig.scan([9.0, 1.0, 0.05, np.nan])
        assert rig.met() == {"a/1"}
        assert rig.cut() == {**NOTHING, "points": 4, "invalid": 2, "used": 2}
        rig.scan([np.inf, np.inf, 11.0, 0.1, -np.inf], range_min=0.0)
        assert rig.met() == set()
        assert rig.cut() == {**NOTHING, "points": 2, "invalid": 1, "used": 1}
        rig.known()
        for covered in ([], [0.05, np.nan, -np.inf]):
            rig.scan(covered)
            rig.known("refused", FRONT)
            rig.scan([9.0])
            rig.known()
        assert rig.refused("front") == {"no valid measurement": 2}
        for wrong in ({"angle_increment": np.nan}, {"time_increment": 1e9}, {"range_max": np.nan}):
            rig.scan([1.0, 1.0], **wrong)  # type: ignore[arg-type]
            rig.says(UNKNOWN, "input_unreadable", who="front (bad scan)")


def test_a_range_is_the_cap_of_its_cone() -> None:
    with SensorRig({"front": {"type": "range", "radius": 0.0}}) as rig:
        rig.send(
            cube(A1, (2.05, 0, 0), (0.1, 0.1, 0.1)), cube(A2, (2, 1, 0), (0.02, 0.02, 0.02))
        ).answer()

        def measure(distance: float, angle: float) -> set[str]:
            limits = {"min_range": 0.2, "max_range": 4.0, "field_of_view": angle}
            message = Range(header=rig.header(), range=distance, **limits)
            rig.sensors["front"].publish(message)
            return rig.met()

        assert measure(2.01, 0.2) == {"a/1"}
        assert measure(1.9, 0.2) == set()
        assert "a/2" in measure(5**0.5, 1.1), "0.46 rad off the axis, of 0.55"
        assert measure(np.inf, 0.2) == measure(4.5, 0.2) == set()
        rig.known()
        for unknown in (np.nan, 0.1, -np.inf):
            measure(1.9, 0.2)
            rig.known()
            message = Range(header=rig.header(), range=unknown, min_range=0.2, max_range=4.0)
            rig.sensors["front"].publish(message)
            rig.known("refused", FRONT)
        assert rig.refused("front") == {"no valid measurement": 3}


def test_several_sources_at_once() -> None:
    with SensorRig({"front": {}, "rear": {"topic": "lidar/rear", "type": "scan"}}) as rig:
        rig.send(cube(A1), cube(A2, (5, 0, 0))).answer()
        rig.see([[0, 0, 0]])
        rig.says(COLLIDING, "unplaced", who="sources/rear/0")
        message = LaserScan(header=rig.header(), ranges=[5.0, 0.2], range_max=9.0)
        rig.sensors["rear"].publish(message)
        assert {frozenset(pair) for pair in rig.pairs()} == {
            frozenset(pair)
            for pair in (("a/1", FRONT), ("a/1", "sources/rear/0"), ("a/2", "sources/rear/0"))
        }, "clouds do not collide with clouds"


def test_a_source_must_deliver() -> None:
    with SensorRig({"front": {"timeout": 0.3}}) as rig:
        rig.send(cube(A1)).answer()
        rig.known("input_silent", "front")
        rig.see([[5, 0, 0]])
        rig.known()
        rig.known("stale", FRONT)
        rig.set(**{"front.timeout": 0.0})
        rig.known()
        rig.set(**{"front.timeout": 0.3, "front.stale_policy": "keep"})
        rig.says(FREE, "1 stale (accepted)")
        rig.see([[0, 0, 0]])
        assert rig.met() == {"a/1"}
        rig.says(COLLIDING)


def test_what_cannot_be_read_is_not_free(front: SensorRig) -> None:
    front.see([[0, 0, 0]])
    assert front.met() == {"a/1"}
    front.sensors["front"].publish(PointCloud2(header=front.header(), width=1, height=1))
    front.until(lambda: front.refused("front") == {"field layout": 1})
    front.says(COLLIDING, "refused")
    front.see([[5, 0, 0]])
    front.known()
    front.node.subscribed.open["front"].callback(b"\0\1\0\0abc", {})
    front.says(UNKNOWN, "input_unreadable")
    front.see([[5, 0, 0]])
    front.known()


def test_a_frame_that_is_late(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = FakeFrames()
    with SensorRig({"front": {}}, frames=frames, transform_timeout=0.1) as rig:
        rig.send(cube(A1)).answer()
        frames.known["camera"] = pose(5.0)
        rig.see([[-5, 0, 0]], frame="camera")
        assert rig.met() == {"a/1"}
        frames.spans["camera"] = (1, rig.stamp)
        rig.see([[-8, 0, 0]], frame="camera")
        rig.says(COLLIDING, "late_frame")
        frames.spans["camera"] = (1, rig.stamp + 10**12)
        rig.see([[-8, 0, 0]], frame="camera")
        assert rig.met() == set()
        rig.known()


def test_only_the_newest_cloud_is_built(monkeypatch: pytest.MonkeyPatch) -> None:
    with SensorRig({"front": {}}, rate=1.0) as rig:
        rig.send(cube(A1)).answer()
        built = spy(monkeypatch, sources, "Cloud")
        for x in (0, 0, 0, 0, 5):
            rig.see([[x, 0, 0]])
        assert rig.met() == set()
        monitor = rig.monitor("front")
        assert built.call_count == monitor.messages - monitor.superseded
        assert monitor.superseded >= 3


def test_a_thousand_clouds_leave_nothing_behind(front: SensorRig) -> None:
    rng = np.random.default_rng(0)
    front.see([[5, 0, 0]])
    front.met()
    (source,) = front.node.sources.all
    objects = front.node.objects
    slot, serial = objects.table.slots[source.key], objects.table.serial.copy()

    def replace(count: int) -> int:
        for _ in range(count):
            points = np.add(rng.uniform(-1, 1, (2000, 3)), (5, 0, 0))
            source._take(
                points, 0.01, QueuedCloud(None, FRAME, 0, 0, front.now()), np.array(pose(0))
            )
            objects.update(front.now())
            objects.scene.check()
        gc.collect()
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        first, last = replace(800), replace(1000)  # at first numpy's caches of small arrays grow
    finally:
        tracemalloc.stop()
    assert last - first < 100_000, "one cloud has 48,000 bytes"
    assert objects.table.slots[source.key] == slot
    assert (objects.table.serial == serial).all()


def test_no_other_input_changes_the_object(front: SensorRig) -> None:
    front.see([[0, 0, 0]])
    assert front.met() == {"a/1"}
    front.send_transform(FRONT, pose(9))
    front.send(Marker(ns="sources/front", action=Marker.DELETEALL))
    front.send(cube(("sources/front", 0), (9, 0, 0)), cube(A2, (0.5, 0, 0)))
    assert front.met() == {"a/1", "a/2"}
    assert front.refused("object_transform") == {"object of another input": 1}
    front.send(Marker(action=Marker.DELETEALL))
    front.until(lambda: len(front.node.objects.table) == 1)
    front.call(Trigger, "obb_collision/clear", Trigger.Request())
    front.known("unplaced", FRONT)
    front.send(cube(A1)).answer()
    front.see([[0, 0, 0]])
    assert front.met() == {"a/1"}


def test_rules_padding_and_groups_hold(front: SensorRig) -> None:
    front.see([[0.53, 0, 0]])
    assert front.met() == set()
    front.set(padding_overrides=["sources/*: 0.03"])
    front.see([[0.53, 0, 0]])
    assert front.met() == {"a/1"}
    front.set(allowed_pairs=["sources/front/0 a/*"])
    front.see([[0.53, 0, 0]])
    assert front.met() == set()


def test_cuts_are_counted() -> None:
    limits = {"min_range": 1.0, "max_range": 6.0, "min_height": -0.5, "max_height": 2.0}
    sensor = {**limits, "voxel": 0.5, "radius": 0.0, "height_frame": "floor"}
    frames = FakeFrames()
    frames.known["floor"], frames.known["tilted"] = pose(0, 0, -1), [0, 0, 0, 0, 0.6, 0, 0.8]
    with SensorRig({"front": sensor}, frames=frames) as rig:
        rig.send(cube(A1, (3, 0, 0))).answer()
        dense = [[3.26, 0.25, 0.25], [3.1, 0.1, 0.1], [3.4, 0.4, 0.4]]
        rig.see([[0.5, 0, 0], [7, 0, 0], [2, 0, 1.1], [2, 0, -1.6], [np.nan, 0, 0], *dense])
        assert rig.met() == {"a/1"}
        assert rig.cut() == {
            "points": 8,
            "invalid": 1,
            "out of range": 2,
            "out of height": 2,
            "thinned out": 2,
            "used": 1,
        }
        shape = rig.node.objects.scene.objects.shape_of(FRONT)
        assert isinstance(shape, Cloud)
        assert shape.points.tolist() == np.array(dense[:1], "f4").tolist()
        reach = np.linalg.norm(np.subtract(*np.array(dense[:2], "f4").astype(float)))
        assert reach <= shape.radius < reach + 1e-6
        values = rig.status("input front")
        assert values["last cloud: out of range"] == "2"
        assert values["last cloud: used"] == "1"
        rig.set(**{"front.voxel": 0.0, "front.max_height": 1.0e6, "front.height_frame": "tilted"})
        rig.see([[3, 0, 0], [-3, 0, 0]])
        rig.met()
        assert rig.cut()["out of height"] == 1


def test_what_is_left_out_is_no_obstacle() -> None:
    sensor = {"leave_out": ["a/*"], "leave_out_padding": 0.1}
    with SensorRig({"front": sensor}) as rig:
        rig.send(cube(A1), cube(B1, (1.05, 0, 0))).answer()
        rig.see([[0.58, 0, 0], [0, 0, 0]])
        assert rig.met() == set()
        assert rig.cut() == {**NOTHING, "points": 2, "left out": 2, "used": 0}
        rig.see([[0.62, 0, 0]])
        assert rig.met() == {"b/1"}
        rig.set(**{"front.leave_out": [""]})
        rig.see([[0.58, 0, 0], [0, 0, 0]])
        assert rig.met() == {"a/1", "b/1"}


def test_where_an_object_was_at_the_stamp_counts() -> None:
    with SensorRig({"front": {"leave_out": ["a/*"]}}) as rig:
        rig.send(cube(B1, (3, 0, 0), (9, 9, 9)))
        stamps = []
        for x in (0, 1, 2, 9):
            rig.send(cube(A1, (x, 0, 0)))
            rig.answer()
            stamps.append(rig.stamp)
            rig.cycles(2)
        message = cloud_of([[1.5, 0, 0], [3, 0, 0]], rig.header())
        message.header.stamp = stamp_to_ros((stamps[1] + stamps[2]) // 2)
        rig.sensors["front"].publish(message)
        rig.until(lambda: rig.cut().get("left out") == 1)
        shape = rig.node.objects.scene.objects.shape_of(FRONT)
        assert isinstance(shape, Cloud)
        assert shape.points.tolist() == [[3, 0, 0]]


def test_what_is_behind_what_is_left_out_is_its_shadow() -> None:
    sensor = {"leave_out": ["a/*"], "shadows": True, "leave_out_padding": 0.1}
    frames = FakeFrames()
    frames.known["camera"] = pose(-3)
    for level, hidden in (("obb", 4), ("hull", 3)):  # the box of the ball hides one more
        with SensorRig({"front": sensor}, frames=frames, accuracy=level) as rig:
            ball = cube(A2, (0, 3, 0), type=Marker.SPHERE)
            rig.send(cube(A1), ball, cube(B1, (-3, 0, 0), (9, 9, 9))).answer()
            behind, beside = [[5.0, 0, 0], [7, 0, 1]], [[-4, 0, 0], [2, 1.3, 0], [5, 0, 3]]
            # seen from the camera the ball of 0.5 m, padded by 0.1 m, is at 45 degrees
            of_ball, by_ball = [3.7, 6.8, 0], [3.0 + 1.1, 6.0 - 1.1, 0]
            points = np.add(np.array([*behind, of_ball, *beside, by_ball]), (3, 0, 0))
            rig.see(points, frame="camera")
            rig.answer()
            assert rig.cut()["left out"] == 0
            assert rig.cut()["in a shadow"] == hidden
            rig.send(cube(A1, (-3.55, 0, 0))).answer()
            rig.see([[9, 0, 0], [-1.5, 0, 0]], frame="camera")
            rig.answer()
            assert rig.cut()["in a shadow"] == 1, "padding about it hides nothing"
            rig.send(cube(A1, (-3, 0, 0))).answer()
            rig.see([[9, 0, 0], [-1.5, 0, 0]], frame="camera")
            rig.answer()
            assert rig.cut()["in a shadow"] == 0, "within the cube the camera would see nothing"


def hand(turn: float, height: float = 0.5) -> list[float]:
    """Return where the hand of the arm is."""
    return [np.cos(turn), np.sin(turn), height]


@each("words", [["arm"], ["arm/*"]])
def test_a_robot_is_left_out_where_it_was_at_the_stamp(words: list[str]) -> None:
    with ArmRig(leave_out=words) as rig:
        rig.see([[5, 0, 0]])
        rig.says(UNKNOWN, "robot_unknown")
        rig.until(lambda: rig.refused("front") == {"robot not known": 1})
        rig.start_robot(turn=0.0)
        rig.put((3, 0, 0.5), (1, 1, 1))
        stamps = []
        for turn in (0.2, 0.4, 0.6, 1.6):
            rig.move(turn=turn)
            stamps.append(rig.stamp)
            rig.cycles(2)
        middle = (stamps[1] + stamps[2]) // 2
        rig.see_at(middle, hand(0.5), hand(0.0), hand(1.6), [3, 0, 0.5])
        rig.until(lambda: rig.cut().get("left out") == 1)
        rig.says(COLLIDING)
        assert rig.cut()["used"] == 3


@each("words, frames", [(["arm"], None), (["*hand/*"], FakeFrames())])
def test_points_wait_for_the_state_of_the_robot(words: list[str], frames: Any) -> None:
    with ArmRig(frames, leave_out=words) as rig:
        rig.start_robot(turn=0.0)
        rig.see_at(rig.stamp, hand(0.0))
        rig.known()
        rig.see(points=[hand(0.1)])
        rig.cycles(3)
        assert rig.cut()["left out"] == 1, "of the cloud before"
        rig.move(turn=0.1)
        rig.until(lambda: rig.monitor("front").superseded == 0 and rig.known())
        rig.see(points=[hand(0.1)])
        rig.says(UNKNOWN, "late_frame", who=FRONT)
        assert rig.refused("front") == {"extrapolation": 1}
        rig.move(turn=0.1)
        rig.see_at(rig.stamp, hand(0.1))
        rig.known()


def test_points_wait_for_a_base_that_moves_by_its_topic() -> None:
    more = {"robot_bases": ["arm: object_transform"], "object_timeout": 100.0}
    with ArmRig(more=more, leave_out=["arm"]) as rig:
        rig.read()
        for x in (0.0, 0.5):
            rig.send_transform("arm", pose(x))
            rig.move(turn=0.0)
        rig.see(points=[[1.6, 0, 0.5], [1.5, 0, 0.5]])
        rig.send_joints(turn=0.0, lift=0.0)
        rig.cycles(3)
        assert "left out" not in rig.cut(), "the base at the stamp is not known"
        rig.send_transform("arm", pose(0.6))
        rig.until(lambda: rig.cut().get("left out") == 2)


def test_what_a_robot_carries_is_left_out_with_it() -> None:
    with ArmRig(FakeFrames(), leave_out=["arm"]) as rig:
        rig.start_robot(turn=0.0)
        rig.send(cube(A1, (1.3, 0, 0), (0.3, 0.1, 0.1), "arm/hand", frame_locked=True))
        rig.cycles(3)
        rig.move(turn=0.0)
        rig.see_at(rig.stamp, [1.4, 0, 0.5], [1.4, 0.2, 0.5])
        rig.until(lambda: rig.cut().get("left out") == 1)


def test_a_scan_of_a_moving_sensor_is_deskewed() -> None:
    frames = FakeFrames()
    with SensorRig({"front": {"type": "scan"}}, frames=frames) as rig:
        rig.send(cube(A1, (5, 0, 0))).answer()
        start = rig.time()

        def lookup(frame: str, stamp: int) -> Any:
            if stamp > start + 3 * 10**9:
                raise RefusedError(EXTRAPOLATION, "later")
            turn = 0.25 * np.pi * (stamp - begun[0]) * 1e-9 if stamp else 0.0
            place = [(stamp - begun[0]) * 1e-9, 0, 0, 0, 0, np.sin(turn / 2), np.cos(turn / 2)]
            return np.array(place), stamp

        begun = [0]
        frames.lookup = lookup  # type: ignore[method-assign]
        header = rig.header("base")
        begun[0] = rig.stamp
        message = LaserScan(header=header, ranges=[2.0, 2.0, 2.0], range_max=9.0)
        message.time_increment = 1.0
        rig.sensors["front"].publish(message)
        rig.answer()
        shape = rig.node.objects.scene.objects.shape_of(FRONT)
        assert isinstance(shape, Cloud)
        angles = np.arange(3) * 0.25 * np.pi
        expected = np.column_stack([2 * np.cos(angles) + [0, 1, 2], 2 * np.sin(angles), 0 * angles])
        assert shape.points == pytest.approx(expected, abs=1e-6)
        message = LaserScan(header=rig.header("base"), ranges=[2.0, 2.0], range_max=9.0)
        message.time_increment = 20.0
        rig.sensors["front"].publish(message)
        rig.says(UNKNOWN, "late_frame", who=FRONT)


def test_a_watched_source_is_in_no_pair() -> None:
    with SensorRig({"front": {"use": "watch"}}) as rig:
        rig.listen("points_inside", "namespaces")
        rig.send(cube(A1)).answer()
        rig.known()
        rig.see([[0, 0, 0], [0.1, 0, 0], [5, 0, 0]])
        rig.until(lambda: "points_inside" in rig.last and rig.last["points_inside"].width)
        (row,) = ros.points_inside_from_ros(rig.last["points_inside"])
        assert row["count"] == 2
        rig.known()
        assert len(rig.node.objects.table) == 1
        rig.sensors["front"].publish(PointCloud2(header=rig.header(), width=1, height=1))
        rig.until(lambda: rig.refused("front"))
        rig.known()


def test_points_inside_has_a_row_per_cloud_and_object() -> None:
    with SensorRig({"front": {"radius": 0.25}, "side": {"use": "watch"}}) as rig:
        rig.listen("points_inside", "namespaces")
        rig.send(cube(A1), cube(A2, (1.5, 0, 0)), cube(("a", 3), (9, 9, 9))).answer()
        rng, want = np.random.default_rng(4), []
        clouds = {name: rng.uniform(-2, 2, (300, 3)) for name in ("front", "side", "points")}
        for n, x in ((1, 0.0), (2, 1.5)):
            for name, radius in (("points", 0.0), ("side", 0.0), ("front", 0.25)):
                beyond = np.maximum(np.abs(clouds[name] - [x, 0, 0]) - 0.5, 0.0)
                count = int((np.linalg.norm(beyond, axis=1) <= radius).sum())
                want.append((f"a/{n}", f"sources/{name}/0", count))
        rig.see(clouds["front"])
        rig.see(clouds["side"], "side")
        rig.send_points(clouds["points"])

        def counts() -> list[tuple[str, str, int]]:
            table = rig.namespaces("a", *(f"sources/{name}" for name in clouds))
            rows = ros.named_points_inside(rig.next("points_inside"), table)
            return [(row.name, row.cloud, row.points) for row in rows]

        rig.until(lambda: sorted(counts()) == sorted(want))
        rig.set(**{"effects.points": "off"})
        assert rig.node.objects.scene.watched == {}
        rig.until(lambda: rig.pubs["points"].get_subscription_count() == 0)


def damaged(data: bytes, count: int) -> Iterator[bytes]:
    """Yield a message cut short, and with some of its bytes replaced."""
    rng = np.random.default_rng(1)
    for _ in range(count):
        yield data[: rng.integers(4, len(data))]
        changed = bytearray(data)
        for at in rng.integers(4, len(data), rng.integers(1, 6)):
            changed[at] = rng.integers(256)
        yield bytes(changed)


@each("kind", KINDS)
def test_damaged_messages_are_refused_or_used(kind: str) -> None:
    with SensorRig({"front": {"type": kind, "voxel": 0.1, "leave_out": ["a/*"]}}) as rig:
        rig.send(cube(A1)).answer()
        rows = np.random.default_rng(0).uniform(-5, 5, (20, 3))
        message = {
            "cloud": cloud_of(rows, rig.header()),
            "scan": LaserScan(header=rig.header(), ranges=[1.0] * 20, range_max=9.0),
            "range": Range(header=rig.header(), range=1.0, max_range=9.0),
        }[kind]
        take = rig.node.subscribed.open["front"].callback
        for data in damaged(serialize_message(message), 150):
            take(data, {})
            rig.node.sources.apply()
        assert not rig.node.guard.counts
        assert not rig.node.objects.broken
        rig.cycles(2)
        rig.node.sources.all[0].cleared()
        message.header = rig.header()
        rig.sensors["front"].publish(message)
        rig.until(lambda: not rig.monitor("front").unreadable)


def test_two_senders_of_a_source_are_not_one_sensor(front: SensorRig) -> None:
    other = front.client.create_publisher(PointCloud2, "front", 10)
    front.until(lambda: front.node.subscribed.open["front"].get_publisher_count() == 2)
    for x in range(4):
        publisher = (front.sensors["front"], other)[x % 2]
        publisher.publish(cloud_of([[5 + x, 0, 0]], front.header()))
        front.answer()
    front.says(UNKNOWN, "two_publishers")
    front.client.destroy_publisher(other)
    front.see([[5, 0, 0]])
    front.known()


def test_an_older_message_is_not_used(front: SensorRig) -> None:
    late = cloud_of([[0, 0, 0]], front.header())
    front.see([[5, 0, 0]])
    assert front.met() == set()
    front.sensors["front"].publish(late)
    front.until(lambda: front.refused("front") == {"older stamp": 1})
    front.cycles(2)
    assert front.met() == set()


def test_a_pose_lies_between_those_before_and_after() -> None:
    turned = np.array([0, 0, 0, 0, 0, -np.sin(0.1), -np.cos(0.1)])
    states = [(10, np.array(pose(1))), (20, np.array(pose(3))), (30, turned)]
    assert between(states, 5).tolist() == between(states, 10).tolist() == pose(1)
    assert between(states, 15).tolist() == pose(2)
    assert between(states, 99) is turned
    halfway = between(states, 25)
    assert halfway == pytest.approx([1.5, 0, 0, 0, 0, np.sin(0.05), np.cos(0.05)])


@each("kind", [np.float32, np.float64])
def test_one_point_of_each_cell_is_kept(kind: type) -> None:
    points: Any = np.random.default_rng(2).uniform(-3, 3, (20_000, 3)).astype(kind)
    for edge in (0.01, 0.3, 1.0, 100.0):
        exact, _ = select(points, Limits())
        kept, moved = thin_out(exact, edge)
        cells = np.floor(exact / edge)
        _, of = np.unique(cells, axis=0, return_inverse=True)
        of = of.reshape(-1)
        squares = ((exact - (cells + 0.5) * edge) ** 2).sum(axis=1)
        best = np.lexsort((np.arange(len(of)), squares, of))
        first = best[np.unique(of[best], return_index=True)[1]]
        assert sorted(first.tolist()) == kept.tolist()
        longest = np.linalg.norm(exact - exact[first][of], axis=1).max()
        assert longest <= moved <= longest * (1 + 1e-9)
        assert moved <= edge * 3**0.5 * (1 + 1e-9)
    far = np.array([[1e18, 0.0, 0.0], [1e18, 0.5, 0.0], [1e18, 0.6, 0.0]])
    assert thin_out(far, 0.3)[0].tolist() == [0, 1, 2], "cells beyond 2^63"
    assert thin_out(np.full((2, 3), 1e300), 0.3)[0].tolist() == [0], "squares beyond doubles"
    with pytest.raises(RefusedError, match="voxel too small"):
        thin_out(np.array([[0.0] * 3, [1e12] * 3]), 1e-9)


@each(
    "given, reason",
    [
        ({"sources": ["front", "front"]}, "'front' occurs twice"),
        ({"sources": ["rate"]}, "name of another input or parameter"),
        ({"sources": ["effects"]}, "name of another input or parameter"),
        ({"sources": ["points"], "points.topic": "front"}, "name of another input or parameter"),
        ({"sources": ["a b"]}, "letters"),
        ({"sources": ["front"], "front.type": "lidar"}, "front.type must be one of cloud"),
        ({"sources": ["front"], "front.topic": "objects"}, "another input has the topic 'objects'"),
        ({"sources": ["one", "two"], "two.topic": "one"}, "another input has the topic 'one'"),
        ({"sources": ["front"], "front.leave_out": ["arm"]}, "front.leave_out: 'arm' is not a"),
        ({"sources": ["front"], "front.max_range": 1.0, "front.min_range": 2.0}, "front.max_range"),
    ],
)
def test_parameters_of_sources_that_make_no_sense(given: dict[str, Any], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        Rig(given=given)

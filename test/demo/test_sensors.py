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

"""The demo's sensors: rays by brute force, messages, and what a node does with them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from each import each
from rclpy.parameter import Parameter
from rig import own_context
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import LaserScan, PointCloud2

import obb_collision as oc
from obb_collision.demo.command import scene_file
from obb_collision.demo.motion import Motions
from obb_collision.demo.run import Demo
from obb_collision.demo.scene import DemoScene
from obb_collision.demo.sensors import World
from obb_collision.node.messages.clouds import points_from_ros
from obb_collision.node.messages.conversions import stamp_from_ros
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats

PATIENCE = 10.0
APART = 20 + os.getpid() % 40
PAGE = Path(__file__).parents[2] / "docs" / "tutorials" / "camera.md"
STEP, CLOSE = 0.004, 1e-5
"""Metres between two points of a ray, and from a point before a surface to one behind it."""


def motions() -> Motions:
    return scene_file("camera")[0]


def inside(shape: Any) -> Callable[[Floats], Any]:
    """Return whether points (n, 3) in the frame of a shape are in it, by its definition."""
    if isinstance(shape, oc.shapes.Box):
        return lambda p: (np.abs(p) <= 0.5 * np.array(shape.size)).all(axis=1)
    if isinstance(shape, oc.shapes.Sphere):
        return lambda p: np.linalg.norm(p, axis=1) <= shape.radius
    if isinstance(shape, oc.shapes.Ellipsoid):
        return lambda p: np.linalg.norm(p / shape.radii, axis=1) <= 1.0
    if isinstance(shape, oc.shapes.Mesh):  # those of the fingers are convex
        planes = ConvexHull(shape.vertices).equations
        return lambda p: (p @ planes[:, :3].T + planes[:, 3] <= 0.0).all(axis=1)
    half = 0.5 * shape.length

    def of_axis(p: Floats) -> Any:
        beyond = np.maximum(np.abs(p[:, 2]) - half, 0.0)
        if isinstance(shape, oc.shapes.Capsule):
            return np.hypot(np.hypot(p[:, 0], p[:, 1]), beyond) <= shape.radius
        return (np.hypot(p[:, 0], p[:, 1]) <= shape.radius) & (beyond == 0.0)

    return of_axis


def bodies(moving: Motions, time: float) -> Iterator[tuple[bool, Callable[[Floats], Any]]]:
    """Yield whether a body is a stranger, and what tells whether points (n, 3) are in it."""
    yield False, lambda p: p[:, 2] <= 0.0
    placed = []
    for part in filter(None, (moving, moving.strangers)):
        for obj, pose in zip(part.description.objects, part.states(time)[0], strict=True):
            if not obj.name.startswith("zone"):
                placed.append((part is not moving, obj.shape, pose[:3], pose[3:]))
    for arm in moving.description.robots:
        links = arm.robot.link_poses(moving.joints(arm, time)[0])
        for link, parts in zip(links, arm.robot.shapes, strict=True):
            turn = Rotation.from_quat(link[3:])
            for shape, local in parts:
                place = np.array(arm.pose[:3]) + link[:3] + turn.apply(local[:3])
                quaternion = (turn * Rotation.from_quat(local[3:])).as_quat()
                placed.append((False, shape, place, quaternion))
    for strange, shape, place, quaternion in placed:
        back, within = Rotation.from_quat(quaternion).inv(), inside(shape)
        yield strange, lambda p, a=place, b=back, f=within: f(b.apply(p - a))  # type: ignore[misc]


@each("name", ["camera", "laser", "lidar"])
@each("time", [1.7, 4.2, 9.1])
def test_rays_end_where_brute_force_says(name: str, time: float) -> None:
    moving = scene_file("lidar_zone" if name == "lidar" else "camera")[0]
    world = World(moving)
    (sensor,) = (found for found in moving.sensors if found.name == name)
    world.place(time)
    seen = world.see(sensor, time)
    rows = np.arange(0, len(seen.distances), {"camera": 29, "laser": 1, "lidar": 61}[name])
    rays = Rotation.from_quat(seen.pose[3:]).apply(sensor.rays[rows])
    ends, there = seen.distances[rows, None], np.isfinite(seen.distances[rows])
    steps = np.arange(0.0, sensor.range, STEP)[None]
    before = np.where(steps < ends - CLOSE, steps, 0.0)[..., None] * rays[:, None] + seen.pose[:3]
    behind = seen.pose[:3] + (ends + CLOSE)[there] * rays[there]
    strange = np.zeros(len(seen.distances), np.bool_)
    strange[np.isfinite(seen.distances)] = seen.strange
    hit = np.zeros(len(behind), np.bool_)
    for is_strange, within in bodies(moving, time):
        assert not within(before.reshape(-1, 3)).any()
        met = within(behind)
        assert (strange[rows][there][met] == is_strange).all()
        hit |= met
    assert hit.all()
    assert there.sum() > 50
    assert strange.any() == (name != "lidar")
    points = seen.pose[:3] + ends[there] * rays[there]
    assert {*map(tuple, points.round(6))} <= {*map(tuple, seen.points.round(6))}


def arm_to_strangers(moving: Motions, time: float) -> float:
    """Return the distance of the arm to the nearest stranger, m, by a scene that knows it."""
    assert moving.strangers is not None
    scene, (arm,) = oc.Scene(accuracy="hull"), moving.description.robots
    for obj, pose in zip(
        moving.strangers.description.objects, moving.strangers.states(time)[0], strict=True
    ):
        scene.add(obj.name, obj.shape, pose)
    checker = oc.RobotScene({"arm": arm.robot}, scene, bases=[arm.pose])
    state = moving.joints(arm, time)[0]
    return float(checker.distances(state[None], self_pairs=False).distances[0])


@pytest.fixture
def demo() -> Iterator[Demo]:
    """Yield the demo, started; its sensors are never too old."""
    moving, file = scene_file("camera")
    with own_context(APART) as context:
        demo = Demo(context, DemoScene(moving, file), 30.0, 1.0, lambda _: None)
        try:
            endless = [Parameter(f"{name}.timeout", value=0.0) for name in ("camera", "laser")]
            demo.checker.set_parameters(endless)
            demo.begin()
            yield demo
        finally:
            demo.close()


def test_messages_are_as_drivers_send_them(demo: Demo) -> None:
    moving, clouds, scans, time = demo.scene.motions, list[Any](), list[Any](), 3.0
    demo.listener.create_subscription(PointCloud2, "camera", clouds.append, 2)
    demo.listener.create_subscription(LaserScan, "laser", scans.append, 2)
    demo.settle(time)
    while not (clouds and scans):  # until the subscriptions are discovered
        demo.sense(time)
    (camera, laser), world = moving.sensors, World(moving)
    world.place(time)
    cloud, seen = clouds[-1], world.see(camera, time)
    assert (cloud.height, cloud.width, cloud.row_step) == (120, 160, 160 * 12)
    assert not cloud.is_dense
    points = points_from_ros(cloud)
    assert np.array_equal(np.isnan(points).any(axis=1), np.isinf(seen.distances))
    pose, at = demo.checker.frames.lookup(
        "camera_optical_frame", stamp_from_ros(cloud.header.stamp)
    )
    assert cloud.header.frame_id == "camera_optical_frame"
    assert at == stamp_from_ros(cloud.header.stamp)
    placed = Rotation.from_quat(pose[3:]).apply(points[np.isfinite(seen.distances)]) + pose[:3]
    np.testing.assert_allclose(placed, seen.points, atol=1e-6)
    right, down, forward = Rotation.from_quat(pose[3:]).as_matrix().T
    toward = np.array([0.75, 0.0, 0.9]) - pose[:3]
    np.testing.assert_allclose(forward, toward / np.linalg.norm(toward), atol=1e-9)
    assert right[2] == pytest.approx(0.0)
    assert down[2] < 0.0
    assert 28.0 < np.degrees(np.arctan2(camera.rays[:, 0], camera.rays[:, 2])).max() < 28.65
    scan, seen = scans[-1], world.see(laser, time)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges))
    np.testing.assert_allclose(np.cos(angles), laser.rays[:, 0], atol=1e-6)
    np.testing.assert_allclose(np.sin(angles), laser.rays[:, 1], atol=1e-6)
    np.testing.assert_allclose(scan.ranges, seen.distances, rtol=1e-6)
    base = moving.states(time)[0][moving.description.names.index("base/0")]
    np.testing.assert_allclose(seen.pose[:3], base[:3] + np.array([0.4, 0.0, 0.0625]))
    for frame, reason in (("arm", "unknown frame"), ("laser_frame", "extrapolation")):
        with pytest.raises(RefusedError, match=reason):
            demo.checker.frames.lookup(frame, 1)


def met(demo: Demo, sensor: str) -> set[str]:
    """Return what collides with what a sensor sees."""
    name = f"sources/{sensor}/0"
    pairs = [{row.a, row.b} - {name} for row in demo.listener.pairs.rows if name in row[:2]]
    return {other for pair in pairs for other in pair}


def test_the_status_turns_before_the_arm_is_reached_and_tells_of_the_zone(demo: Demo) -> None:
    listener, scales, errors = demo.listener, demo.publisher.scales, 0
    for time in (0.0, 2.0, 3.6, 3.8, 3.9, 4.0, 4.2, 6.0, 9.2, 10.0, 11.5):
        demo.settle(time)
        distance, near = arm_to_strangers(demo.scene.motions, time), met(demo, "camera")
        assert all(name.startswith("arm/") for name in near)
        assert near or distance > 0.1, f"{distance} m at {time} s"
        assert not near or distance < 0.15, f"{distance} m at {time} s"
        assert met(demo, "laser") == ({"zone/0"} if 8.5 < time < 11.0 else set())
        level = "ERROR" if demo.listener.pairs.rows else "OK"
        reached = lambda level=level: listener.status.level == level  # noqa: E731
        demo.spin_until(reached, PATIENCE)
        errors += bool(near)
        if near:
            demo.spin_until(lambda: scales["arm"] == 0.0, PATIENCE)
        elif distance > 0.5:
            demo.spin_until(lambda: scales["arm"] > 0.5, PATIENCE)
    assert 3 <= errors <= 5


def test_the_arm_stops_before_the_hand_which_it_would_hit(demo: Demo) -> None:
    moving, blind = demo.scene.motions, motions()
    distances = []
    for time in np.arange(0.0, 4.75, 0.125).tolist():
        demo.publisher.publish_step(time)  # time is that of the scene, not of a clock
        demo.sense(time)
        if time > 3.0:  # the hand is far before
            distances.append([arm_to_strangers(each, time) for each in (moving, blind)])
    seeing, unseeing = np.min(distances, axis=0)
    assert moving.delays["arm"] > 0.3
    assert seeing > 0.05
    assert unseeing < 0.0


def test_without_the_self_filter_the_arm_collides_with_its_own_points(demo: Demo) -> None:
    assert met(demo, "camera") == set()
    demo.checker.set_parameters([Parameter("camera.leave_out", value=["table/*", "carton/*"])])
    demo.settle(0.0)
    assert {"arm/upper_arm/1", "arm/forearm/1", "arm/hand/1"} <= met(demo, "camera")


def test_the_picture_shows_points_and_not_the_boxes_around_them(demo: Demo) -> None:
    demo.settle(4.2)
    drawn = demo.snapshot()
    assert not [name for name in drawn.names if name.startswith("sources/")]
    assert len(drawn.cloud) > 5000
    assert len(drawn.strangers) > 200
    assert ("point of a stranger", "speck") in [entry[::2] for entry in drawn.legend()]


def test_the_page_shows_the_file_that_the_node_gets(demo: Demo) -> None:
    assert demo.scene.parameters is not None
    (block,) = re.findall(r"^```yaml\n(.*?)^```", PAGE.read_text(), re.DOTALL | re.MULTILINE)
    shown, given = map(yaml.safe_load, (block, demo.scene.parameters.read_text()))
    assert shown == given
    (values,) = (part["ros__parameters"] for part in given.values())
    for name in ("camera", "laser"):
        values |= {f"{name}.{key}": value for key, value in values.pop(name).items()}
    for name in values.keys() - {"scene_file", "robot_bases"}:  # which the demo sets in its way
        assert demo.checker.get_parameter(name).value == values[name], name

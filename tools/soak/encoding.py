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

"""The messages of a step, and scenery: shapes to build and bodies of a short life, far away."""

from __future__ import annotations

from random import Random
from typing import Any

import numpy as np
from geometry_msgs.msg import Point, TransformStamped
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.clouds import boxes_to_ros, cloud_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import (
    duration_to_ros,
    pose_to_ros,
    states_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.typing import Floats
from tools.soak.world import BOXES, MARKERS, TRANSFORM, Bodies, Body, Change, Key

FRAME = "map"
KINDS: dict[str, type] = {
    MARKERS: MarkerArray,
    TRANSFORM: TransformStamped,
    "object_states": MultiDOFJointState,
    "object_poses": PointCloud2,
    BOXES: PointCloud2,
    "points": PointCloud2,
}
"""Message of each input."""
SCENERY, PLACES = "scenery", 40
"""Namespace of the scenery, and how much of it there is at most."""
BUILT = (Marker.TRIANGLE_LIST, Marker.POINTS, Marker.SPHERE_LIST, Marker.LINE_LIST)
DEEP = 500.0
"""How far below the room they are (m)."""
CORNERS = 24
"""Points of a shape of the scenery."""
OBSTACLES = 500
"""Obstacle points of each cloud."""


def messages_of(topic: str, change: Change, header: Header, scenery: list[Marker]) -> list[Any]:
    """Return what to publish for a change, in the order of its bodies: the beacon last."""
    if topic == MARKERS:
        gone = [Marker(ns=ns, id=number, action=Marker.DELETE) for ns, number in change.gone]
        come = [marker_of(key, body, header) for key, body in change.bodies.items()]
        return [MarkerArray(markers=[*gone, *scenery, *come])]
    if topic == BOXES:
        poses, sizes = rows_of(change.bodies)
        numbers = [namespace_number(ns) for ns, _ in change.bodies]
        return [boxes_to_ros([key[1] for key in change.bodies], poses, sizes, numbers, header)]
    names = [f"{ns}/{number}" for ns, number in change.bodies]
    poses, _ = rows_of(change.bodies)
    if topic == TRANSFORM:
        pairs = zip(names, poses, strict=True)
        return [
            TransformStamped(header=header, child_frame_id=name, transform=transform_to_ros(pose))
            for name, pose in pairs
        ]
    if topic == "object_states":
        return [states_to_ros(names, poses, header)]
    numbers = [namespace_number(ns) for ns, _ in change.bodies]
    ids = [key[1] for key in change.bodies]
    return [poses_to_ros(ids, poses, numbers, header, single=change.single)]


def rows_of(bodies: Bodies) -> tuple[Floats, Floats]:
    """Return poses (n, 7) and sizes (n, 3)."""
    poses = np.array([body.pose for body in bodies.values()]).reshape(-1, 7)
    return poses, np.array([body.size for body in bodies.values()]).reshape(-1, 3)


def marker_of(key: Key, body: Body, header: Header) -> Marker:
    """Return the marker that adds or changes a body."""
    marker = Marker(header=header, ns=key[0], id=key[1], type=body.kind)
    marker.pose = pose_to_ros(body.pose)
    marker.scale.x, marker.scale.y, marker.scale.z = body.size
    return marker


def scenery_of(random: Random, header: Header) -> Marker:
    """Return a shape to be built, or a cube of a short life, in a place of its own."""
    place = random.randrange(PLACES)
    if random.random() < 0.5:
        return built_shape(random, header, place)
    marker = _placed(header, place)
    marker.type, marker.lifetime = Marker.CUBE, duration_to_ros(random.uniform(0.02, 1.0))
    return marker


def built_shape(random: Random, header: Header, place: int) -> Marker:
    """Return a shape to be built in a place, another one each time."""
    marker = _placed(header, place)
    marker.type = random.choice(BUILT)
    spread = random.random
    marker.points = [Point(x=spread(), y=spread(), z=spread()) for _ in range(CORNERS)]
    return marker


def _placed(header: Header, place: int) -> Marker:
    marker = Marker(header=header, ns=SCENERY, id=place)
    marker.pose.position.x, marker.pose.position.z = 10.0 * place, -DEEP
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    return marker


def obstacles(random: Random, side: float, header: Header) -> PointCloud2:
    """Return a cloud of points in the room."""
    rows = np.zeros(OBSTACLES, [(name, "<f4") for name in "xyz"])
    for name in "xyz":
        rows[name] = [random.uniform(0.0, side) for _ in range(OBSTACLES)]
    return cloud_to_ros(rows, header)

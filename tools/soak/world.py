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

"""The scene, the changes of each step, and their messages: the same for the same seed.

A step has at most one change per input. Each body is changed by one input at most, and each input
moves a *beacon* with every change, in and out of collision with an *anchor*: so the pairs of an
answer say which changes it has, and there is one right answer to each. Besides there is scenery,
far away: shapes to build and bodies of a short life.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

import numpy as np
from geometry_msgs.msg import Point, TransformStamped
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from obb_collision.node.messages.clouds import boxes_to_ros, cloud_to_ros, poses_to_ros
from obb_collision.node.messages.conversions import (
    duration_to_ros,
    states_to_ros,
    transform_to_ros,
)
from obb_collision.node.messages.names import namespace_number
from obb_collision.typing import Floats
from tools.fuzz.messages import box_marker

GRID = 0.125
"""Centres and half extents of exact boxes are multiples of this (m)."""
Key = tuple[str, int]
"""Namespace and id."""

MARKERS, TRANSFORM, BOXES = "objects", "object_transform", "object_boxes"
MOVING = ("object_states", "object_poses")
"""Inputs that move many bodies that markers have added."""
TOPICS = (MARKERS, TRANSFORM, *MOVING, BOXES)
SET = "boxes"
"""Namespace of the bodies that come and go by ``object_boxes``."""
SHAPES = (Marker.CUBE, Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)
"""Whose box is as large as their scale."""
ROOM_PER_BODY = 1.2
"""Cubic metres per body: each collides with about one other."""
FAR = 500.0
"""Where beacons are (m): away from the room."""
NAMESPACES = 8
"""Namespaces in use at a time ..."""
NAMESPACE_STEPS = 500
"""... of which the oldest is left after so many steps."""
INCLUDED = 0.6
"""Probability that a step has a change by an input."""
GONE = 0.5
"""Probability that as many go as come, by markers."""


class Body(NamedTuple):
    """A body: type of its marker, pose (7,), edge lengths (3,)."""

    kind: int
    pose: tuple[float, ...]
    size: tuple[float, ...]


Bodies = dict[Key, Body]


@dataclass
class Change:
    """The change of an input: new or moved bodies, and removed keys.

    single: whether poses are written in single precision; they are rounded already.
    """

    bodies: Bodies = field(default_factory=dict)
    gone: set[Key] = field(default_factory=set)
    single: bool = False

    def apply(self, bodies: Bodies) -> None:
        """Change bodies."""
        for key in self.gone:
            del bodies[key]
        bodies.update(self.bodies)


class World:
    """All bodies, and the steps: ``objects`` bodies on average besides beacons."""

    def __init__(self, seed: int, objects: int) -> None:
        self._random = np.random.default_rng(seed)
        self._objects = objects
        self.side = (ROOM_PER_BODY * objects) ** (1.0 / 3.0)
        """Edge of the room (m)."""
        self._next_id = 0
        self.steps = 0
        self.bodies: Bodies = {}
        self.lit = dict.fromkeys(TOPICS, False)
        """Whether the beacon of each input collides with its anchor."""

    def first(self) -> dict[str, Change]:
        """Return the step that begins: anchors, beacons, and the first bodies."""
        markers, boxes = Change(), Change()
        for topic in TOPICS:
            (boxes if topic == BOXES else markers).bodies[beacon(topic)] = _beacon(topic, False)
            markers.bodies[anchor(topic)] = _beacon(topic, True)
        for number in range(self._objects):
            come = boxes if number % 4 == 0 else markers
            come.bodies[self._new_key(come is boxes)] = self._body(come is boxes)
        return {MARKERS: markers, BOXES: boxes}

    def step(self) -> dict[str, Change]:
        """Return the next changes by input, for ``apply``."""
        self.steps += 1
        wanted = [topic for topic in TOPICS if self._random.random() < INCLUDED]
        wanted = wanted or [str(self._random.choice(TOPICS))]
        movable = [key for key in self.bodies if key[0].startswith("crate")]
        order = [movable[k] for k in self._random.permutation(len(movable))]
        changes = {topic: self._change(topic, order) for topic in wanted}
        for topic, change in changes.items():
            change.bodies[beacon(topic)] = _beacon(topic, not self.lit[topic])
        return changes

    def apply(self, changes: dict[str, Change]) -> None:
        """Make a step."""
        for topic, change in changes.items():
            change.apply(self.bodies)
            if beacon(topic) in change.bodies and self.steps:
                self.lit[topic] = not self.lit[topic]

    def _change(self, topic: str, order: list[Key]) -> Change:
        if topic == MARKERS:
            return self._come_and_go(order)
        if topic == BOXES:
            return self._next_set()
        count = 1 if topic == TRANSFORM else int(self._random.integers(1, 16))
        moved = [order.pop() for _ in range(min(count, len(order)))]
        change = Change(single=topic == "object_poses" and self._random.random() < 0.5)
        for key in moved:
            change.bodies[key] = self._moved(self.bodies[key], change.single)
        return change

    def _come_and_go(self, order: list[Key]) -> Change:
        """Return a change by markers, which come, go, move or get another shape."""
        change = Change()
        for _ in range(self._random.integers(0, 3)):
            if order and self._random.random() < GONE * len(self.bodies) / self._objects:
                change.gone.add(order.pop())
            else:
                change.bodies[self._new_key(False)] = self._body(False)
        for key in [order.pop() for _ in range(min(2, len(order)))]:
            other = self._body(False)
            same = self._random.random() < 0.7
            change.bodies[key] = self._moved(self.bodies[key], False) if same else other
        return change

    def _next_set(self) -> Change:
        """Return a change by a set of boxes: most move, a few come or go."""
        change = Change()
        here = [key for key in self.bodies if key[0] == SET and key != beacon(BOXES)]
        for key in here:
            if self._random.random() < 0.1:
                change.gone.add(key)
            else:
                change.bodies[key] = self._moved(self.bodies[key], False)
        while len(change.bodies) < self._objects // 4 and self._random.random() < 0.9:
            change.bodies[self._new_key(True)] = self._body(True)
        return change

    def _new_key(self, by_set: bool) -> Key:
        self._next_id += 1
        epoch = self.steps // NAMESPACE_STEPS + int(self._random.integers(NAMESPACES))
        return (SET if by_set else f"crate{epoch}", self._next_id)

    def _body(self, by_set: bool) -> Body:
        kind = Marker.CUBE if by_set else int(self._random.choice(SHAPES))
        on_grid = self._random.random() < 0.3
        size = self._random.integers(1, 5, 3) / 4.0 if on_grid else self._random.uniform(0.1, 1, 3)
        return Body(kind, self._pose(on_grid), tuple(size.tolist()))

    def _pose(self, on_grid: bool) -> tuple[float, ...]:
        place, turn = self._random.uniform(0.0, self.side, 3), self._random.normal(size=4)
        if on_grid:
            place, turn = GRID * np.round(place / GRID), np.array((0.0, 0.0, 0.0, 1.0))
        return (*place.tolist(), *(turn / np.linalg.norm(turn)).tolist())

    def _moved(self, body: Body, single: bool) -> Body:
        """Return a body at another pose: nearby, on the grid, or anywhere."""
        chance = self._random.random()
        if chance < 0.5:
            pose: Floats = np.array(body.pose)
            pose[:3] += self._random.normal(0.0, 0.05, 3)
            pose[3:] += self._random.normal(0.0, 0.05, 4)
            pose[:3] = np.clip(pose[:3], 0.0, self.side)
            pose[3:] /= np.linalg.norm(pose[3:])
        else:
            pose = np.array(self._pose(chance < 0.75))
        pose = pose.astype(np.float32).astype(np.float64) if single else pose
        return body._replace(pose=tuple(pose.tolist()))


def beacon(topic: str) -> Key:
    """Return the key of the body that an input moves with every change."""
    return (SET if topic == BOXES else "beacon", -1 - TOPICS.index(topic))


def anchor(topic: str) -> Key:
    """Return the key of the body with which the beacon of an input collides half of the time."""
    return ("anchor", TOPICS.index(topic))


def _beacon(topic: str, lit: bool) -> Body:
    place = (FAR + 10.0 * TOPICS.index(topic), 0.0 if lit else 3.0, 0.0)
    return Body(Marker.CUBE, (*place, 0.0, 0.0, 0.0, 1.0), (1.0, 1.0, 1.0))


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
"""Namespace of the scenery, and the number of its places."""
BUILT = (Marker.TRIANGLE_LIST, Marker.POINTS, Marker.SPHERE_LIST, Marker.LINE_LIST)
DEEP = 500.0
"""How far below the room they are (m)."""
CORNERS = 24
"""Points of a shape of the scenery."""
OBSTACLES = 500
"""Obstacle points of each cloud."""


def messages_of(topic: str, change: Change, header: Header, scenery: list[Marker]) -> list[Any]:
    """Return the messages of a change, in the order of its bodies, the beacon last."""
    if topic == MARKERS:
        gone = [Marker(ns=ns, id=number, action=Marker.DELETE) for ns, number in change.gone]
        come = [
            box_marker(key, body.pose, body.size, header, body.kind)
            for key, body in change.bodies.items()
        ]
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


def scenery_of(random: Random, header: Header) -> Marker:
    """Return a shape to be built, or a cube with a short lifetime, in a random place."""
    place = random.randrange(PLACES)
    if random.random() < 0.5:
        return built_shape(random, header, place)
    marker = _placed(header, place, Marker.CUBE)
    marker.lifetime = duration_to_ros(random.uniform(0.02, 1.0))
    return marker


def built_shape(random: Random, header: Header, place: int) -> Marker:
    """Return a shape of random points to be built in a place."""
    marker = _placed(header, place, random.choice(BUILT))
    spread = random.random
    marker.points = [Point(x=spread(), y=spread(), z=spread()) for _ in range(CORNERS)]
    return marker


def _placed(header: Header, place: int, kind: int) -> Marker:
    pose = (10.0 * place, 0.0, -DEEP, 0.0, 0.0, 0.0, 1.0)
    return box_marker((SCENERY, place), pose, (1.0, 1.0, 1.0), header, kind)


def obstacles(random: Random, side: float, header: Header) -> PointCloud2:
    """Return a cloud of points in the room."""
    rows = np.zeros(OBSTACLES, [(name, "<f4") for name in "xyz"])
    for name in "xyz":
        rows[name] = [random.uniform(0.0, side) for _ in range(OBSTACLES)]
    return cloud_to_ros(rows, header)

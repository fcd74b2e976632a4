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

"""Sensors of the demo: cameras and laser scanners whose rays end at what stands in a scene."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from math import pi, tan
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import (
    compose_poses,
    inverse_poses,
    quaternions_from_matrices,
    rotate_vectors,
)
from obb_collision.scene.scene import Scene
from obb_collision.scene_files.yaml_values import Reader, Value
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats, Mask

if TYPE_CHECKING:
    from obb_collision.demo.motion import Motions

TYPES = CAMERA, LASER = ("camera", "laser")
#: Most rays in a row or column, and messages per second.
MAX_RAYS, MAX_RATE = 4096, 1000.0
#: The lowest and the highest row of a laser with several, rad above the level.
RISES = -0.535, 0.185
#: Widest view of a camera, rad: its picture is plane.
WIDEST = 2.8
STRANGE, ZONE = "strange", "zone"
#: A box that nobody sees the end of: its top is the floor, z = 0.
FLOOR, BELOW = Box((1000.0, 1000.0, 1.0)), (0.0, 0.0, -0.5, 0.0, 0.0, 0.0, 1.0)


@dataclass(frozen=True, eq=False)
class Sensor:
    """A simulated sensor: its name, which is that of its topic, and its rays.

    width, height: rays in a row and in a column; angle: between the ends of a row, rad; range: m;
    rate: messages per second. pose (7,): of its frame in that of ``leader``, an object, or of the
    scene. A camera looks along z, x to the right; a laser turns about z and looks along x, and with
    several rows up and down, too.
    """

    name: str
    type: str
    width: int
    height: int
    angle: float
    range: float
    rate: float
    pose: Floats
    leader: str | None = None

    @property
    def frame(self) -> str:
        """The frame of its messages."""
        return f"{self.name}_optical_frame" if self.type == CAMERA else f"{self.name}_frame"

    @cached_property
    def rays(self) -> Floats:
        """Unit directions (height * width, 3) in its frame, row by row."""
        columns, rows = (np.arange(n) - 0.5 * (n - 1) for n in (self.width, self.height))
        if self.type == LASER:
            rises = np.linspace(*RISES, self.height) if self.height > 1 else [0.0]
            turn, rise = np.meshgrid(columns * self.step, rises)
            flat = np.cos(rise)
            rays = np.stack([flat * np.cos(turn), flat * np.sin(turn), np.sin(rise)], axis=-1)
            return rays.reshape(-1, 3)
        focal = 0.5 * self.width / tan(0.5 * self.angle)
        x, y = np.meshgrid(columns / focal, rows / focal)
        rays = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        return rays / np.linalg.norm(rays, axis=1, keepdims=True)

    @property
    def is_scan(self) -> bool:
        """Whether its messages are scans, of one row; others are clouds."""
        return self.type == LASER and self.height == 1

    @property
    def step(self) -> float:
        """The angle between two rays of a laser, rad."""
        return self.angle / max(self.width - 1, 1)


def read_sensor(value: Value, name: str, poses: Mapping[str, Floats]) -> Sensor:
    """Return a sensor; poses (7,): of objects at the start, which it may follow."""
    count: Reader = lambda entry: entry.whole(1, MAX_RAYS)  # noqa: E731
    required: dict[str, Reader] = {
        "type": lambda entry: entry.choice(TYPES),
        "width": count,
        "angle": lambda entry: entry.number("radians of a turn", lambda x: 0.0 < x <= 2.0 * pi),
        "range": Value.positive,
        "rate": lambda entry: entry.number("above 0 Hz", lambda x: 0.0 < x <= MAX_RATE),
        "position": Value.triple,
        "target": Value.triple,
    }
    optional: dict[str, Reader] = {"height": count}
    optional["follow"] = lambda entry: entry.choice(poses)
    found = value.read(required, optional)
    leader = found.pop("follow", None)
    if found["type"] == CAMERA and found["angle"] > WIDEST:
        value.refuse(f"the angle of a camera is at most {WIDEST:g} rad")
    pose = _looking(value, found.pop("position"), found.pop("target"), found["type"])
    if leader is not None:
        pose = compose_poses(inverse_poses(poses[leader]), pose)
    return Sensor(name, pose=pose, leader=leader, **{"height": 1} | found)


def _looking(value: Value, position: Any, target: Any, kind: str) -> Floats:
    """Return the pose (7,) of a sensor that looks at a target; one of a laser is level."""
    forward = np.subtract(target, position)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if not right.any():
        value.refuse("position and target must not stand above each other: then up is undefined")
    down = np.cross(forward, right)
    axes = (right, down, forward)
    if kind == LASER:
        axes = (np.cross((0.0, 0.0, 1.0), right), -right, np.array((0.0, 0.0, 1.0)))
    matrix = np.stack([axis / np.linalg.norm(axis) for axis in axes], axis=1)
    return np.concatenate([position, quaternions_from_matrices(matrix[None])[0]])


class Seen(NamedTuple):
    """What a sensor sees: its pose (7,), and the distances (n,) along its rays, infinite for none.

    points (k, 3): the ends of the others, in the frame of the scene; strange (k,): which are of
    strangers.
    """

    pose: Floats
    distances: Floats
    points: Floats
    strange: Mask


class World:
    """What sensors see: the objects of a scene but its zones, robots, strangers and the floor."""

    def __init__(self, motions: Motions) -> None:
        self._motions, self._scene = motions, Scene()
        shapes: list[tuple[Shape, str]] = []
        for kind, part in (("", motions), (STRANGE, motions.strangers)):
            for obj in part.description.objects if part is not None else ():
                is_zone = obj.color is not None and obj.color[3] < 1.0
                shapes.append((obj.shape, ZONE if is_zone else kind))
        for robot in motions.description.robots:
            shapes += [(shape, "") for placed in robot.robot.shapes for shape, _ in placed]
        kinds = np.array([kind for _, kind in shapes])
        self._rows = np.flatnonzero(kinds != ZONE)
        self._strange = np.append(kinds[self._rows] == STRANGE, False)  # the last is the floor
        poses = self._poses(0.0)
        for row in self._rows.tolist():
            self._scene.add(str(row), shapes[row][0], poses[row])
        self._scene.add("floor", FLOOR, BELOW)

    def _poses(self, time: float) -> Floats:
        """Return the poses (n, 7) of objects, strangers and links at a time (s)."""
        motions, poses = self._motions, [self._motions.states(time)[0]]
        if motions.strangers is not None:
            poses.append(motions.strangers.states(time)[0])
        for robot in motions.description.robots:
            links = robot.robot.link_poses(motions.joints(robot, time)[0])
            for link, placed in zip(links, robot.robot.shapes, strict=True):
                local = np.array([pose for _, pose in placed]).reshape(-1, 7)
                poses.append(compose_poses(np.array(robot.pose), compose_poses(link, local)))
        return np.concatenate(poses)

    def place(self, time: float) -> None:
        """Place everything where it is at a time (s)."""
        self._scene.move(list(map(str, self._rows)), self._poses(time)[self._rows])

    def see(self, sensor: Sensor, time: float) -> Seen:
        """Return what a sensor sees of what was placed, being where it is at a time (s)."""
        pose = sensor.pose
        if sensor.leader is not None:
            row = self._motions.description.names.index(sensor.leader)
            pose = compose_poses(self._motions.states(time)[0][row], pose)
        origins = np.tile(pose[:3], (len(sensor.rays), 1))
        rays = rotate_vectors(pose[3:], sensor.rays)
        hits = self._scene.cast_rays(origins, rays, sensor.range, accuracy=Accuracy.MESH)
        ends = hits.distances[hits.hits, None] * rays[hits.hits]
        return Seen(pose, hits.distances, pose[:3] + ends, self._strange[hits.boxes[hits.hits]])

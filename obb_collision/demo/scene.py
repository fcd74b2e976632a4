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

"""A scene description in motion: the poses, twists and lidar points of the demo at a time."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np

from obb_collision.geometry.poses import Pose, quaternion_from_rpy
from obb_collision.node.inputs.scene_file import keys_from_names
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.scene_files.description import Cloud, SceneDescription, SceneObject
from obb_collision.scene_files.motion import Loop
from obb_collision.shapes import Box, Cylinder, Shape, Sphere
from obb_collision.typing import Floats


class DemoScene:
    """A scene whose objects move.

    file: where the description was read from, for the node to read it too; None where its objects
    are to be published. keys and names are those on the topics, shapes by name. moving: rows of the
    objects that move. robots: those of the file, whose links are among the shapes. zones: colour of
    each region, that is of each object with an opacity below 1.
    """

    def __init__(self, description: SceneDescription, file: Path | None = None) -> None:
        self.description, self.file = description, file
        self.keys = keys_from_names(description.names)
        self.names = [name_from_key(key) for key in self.keys]
        objects = dict(zip(self.names, description.objects, strict=True))
        self.robots = description.robots
        self.shapes: dict[str, Shape] = {name: thing.shape for name, thing in objects.items()}
        self.shapes |= {
            f"{each.name}/{link}/{number}": shape
            for each in self.robots
            for link, placed in zip(each.robot.link_names, each.robot.shapes, strict=True)
            for number, (shape, _) in enumerate(placed)
        }
        self.moving = description.moving()
        self.zones = {
            name: thing.color[:3]
            for name, thing in objects.items()
            if thing.color is not None and thing.color[3] < 1.0
        }
        if description.lidar is None:
            return
        self._scene = description.build()

    @property
    def moving_count(self) -> int:
        """How many objects move, the links of robots that move included."""
        return len(self.moving) + sum(
            len(placed)
            for each in self.robots
            if each.motion is not None
            for placed in each.robot.shapes
        )

    def states(self, time: float) -> tuple[Floats, Floats]:
        """Return poses (n, 7) and twists (n, 6) at a time (s)."""
        return self.description.states(time)

    def points(self, time: float) -> Cloud | None:
        """Return the points (k, 3) that the lidar measures at a time, None without a lidar."""
        if self.description.lidar is None:
            return None
        self._scene.move(self.description.names, self.states(time)[0])
        return self.description.lidar.scan(self._scene, time)


#: Floor per object, m^2: some collide at any time, most don't.
AREA = 4.0
#: Waypoints of a way, and the range of seconds that it takes.
WAYPOINTS, PERIODS = 4, (8.0, 16.0)
#: Lengths are multiples of this (m), exact in binary: what stands on something touches it exactly.
GRID = 1.0 / 64.0
STACKED = Box((0.5, 0.375, 0.25))


def random_scene(objects: int, seed: int) -> SceneDescription:
    """Return a scene of ``objects`` objects that follows from their number and the seed.

    Every fifth object stands on the one before, every third one of the others moves along a loop.
    """
    random = np.random.default_rng(seed)
    reach = 0.5 * sqrt(AREA * objects)
    result: list[SceneObject] = []
    for k in range(objects):
        shape, kind, height = _random_shape(random)
        x, y = _on_grid(random.uniform(-reach, reach, 2))
        if k % 5 == 4 and result[-1].motion is None:
            below = result[-1]
            x, y, z, *_ = below.pose
            z += 0.5 * (_height(below.shape) + STACKED.size[2])
            result.append(SceneObject(f"box/{k}", STACKED, (x, y, z, 0.0, 0.0, 0.0, 1.0)))
            continue
        pose = (x, y, 0.5 * height, *quaternion_from_rpy(0.0, 0.0, random.uniform(-3.0, 3.0)))
        motion = _random_way(random, pose, 2.5) if k % 3 == 0 else None
        result.append(SceneObject(f"{kind}/{k}", shape, pose, motion=motion))
    return SceneDescription("random", tuple(result), f"{objects} objects at random, seed {seed}")


def _random_shape(random: np.random.Generator) -> tuple[Shape, str, float]:
    """Return a shape, its namespace and its height."""
    length, width, height = (float(x) for x in _on_grid(random.uniform(0.3, 1.0, 3)))
    kind = int(random.integers(3))
    if kind == 0:
        return Sphere(0.5 * height), "sphere", height
    if kind == 1:
        return Cylinder(0.5 * width, height), "cylinder", height
    return Box((length, width, height)), "box", height


def _random_way(random: np.random.Generator, start: Pose, reach: float) -> Loop:
    """Return a round trip from a pose, at its height."""
    poses = [start]
    for _ in range(WAYPOINTS - 1):
        x, y = np.array(start[:2]) + random.uniform(-reach, reach, 2)
        turn = quaternion_from_rpy(0.0, 0.0, random.uniform(-3.0, 3.0))
        poses.append((float(x), float(y), start[2], *turn))
    period = float(random.uniform(*PERIODS))
    return Loop(tuple(poses), tuple(period * k / WAYPOINTS for k in range(WAYPOINTS)), period)


def _height(shape: Shape) -> float:
    return 2.0 * float(shape.local_box[2][2])


def _on_grid(values: Floats) -> tuple[float, ...]:
    return tuple((2.0 * GRID * np.round(values / (2.0 * GRID))).tolist())

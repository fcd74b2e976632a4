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

"""Scenes of the demo: names, shapes and zones; and scenes made at random."""

from __future__ import annotations

from math import sqrt
from pathlib import Path

import numpy as np

from obb_collision.demo.motion import Motions, Track, object_track
from obb_collision.geometry.poses import Pose, quaternion_from_rpy
from obb_collision.node.inputs.scene_file import keys_from_names
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.scene_files.description import SceneDescription, SceneObject
from obb_collision.shapes import Box, Cylinder, Shape, Sphere
from obb_collision.typing import Floats


class DemoScene:
    """A scene in motion, as it is on the topics.

    file: the scene file, which the node reads too; None where its objects are to be published.
    parameters: the file of the node's parameters beside it, if there is one.
    keys and names are those on the topics, shapes by name. robots: those of the file, whose links
    are among the shapes. zones: colour of each region, that is of each object with an opacity
    below 1.
    """

    def __init__(self, motions: Motions, file: Path | None = None) -> None:
        self.motions, self.file = motions, file
        parameters = None if file is None else file.with_suffix(".params.yaml")
        self.parameters = parameters if parameters is not None and parameters.is_file() else None
        self.description = description = motions.description
        self.keys = keys_from_names(description.names)
        self.names = [name_from_key(key) for key in self.keys]
        objects = dict(zip(self.names, description.objects, strict=True))
        self.robots = description.robots
        self.shapes: dict[str, Shape] = {name: obj.shape for name, obj in objects.items()}
        self.shapes |= {
            f"{robot.name}/{link}/{number}": shape
            for robot in self.robots
            for link, placed in zip(robot.robot.link_names, robot.robot.shapes, strict=True)
            for number, (shape, _) in enumerate(placed)
        }
        self.zones = {
            name: obj.color[:3]
            for name, obj in objects.items()
            if obj.color is not None and obj.color[3] < 1.0
        }

    @property
    def moving_count(self) -> int:
        """How many objects move, the links of robots that move included."""
        robots = [entry.robot for entry in self.robots if entry.name in self.motions.robots]
        return len(self.motions.moving) + sum(len(placed) for r in robots for placed in r.shapes)


#: Floor per object, m^2: some collide at any time, most don't.
AREA = 4.0
#: Waypoints of a round trip, how far from its start they are along x and y at most (m), and the
#: range of its period (s).
WAYPOINTS, REACH, PERIODS = 4, 2.5, (8.0, 16.0)
#: Lengths are multiples of this (m), exact in binary: what stands on something touches it exactly.
GRID = 1.0 / 64.0
STACKED = Box((0.5, 0.375, 0.25))


def random_scene(objects: int, seed: int) -> Motions:
    """Return a scene of so many objects, always the same one for a seed.

    Every fifth object stands on the one before, every third one of the others goes round.
    """
    random = np.random.default_rng(seed)
    reach = 0.5 * sqrt(AREA * objects)
    result: list[SceneObject] = []
    tracks: dict[str, Track] = {}
    for k in range(objects):
        shape, kind, height = _random_shape(random)
        x, y = _on_grid(random.uniform(-reach, reach, 2))
        if k % 5 == 4 and result[-1].name not in tracks:
            below = result[-1]
            x, y, z, *_ = below.pose
            z += float(below.shape.local_box[2][2]) + 0.5 * STACKED.size[2]
            result.append(SceneObject(f"box/{k}", STACKED, (x, y, z, 0.0, 0.0, 0.0, 1.0)))
            continue
        pose = (x, y, 0.5 * height, *quaternion_from_rpy(0.0, 0.0, random.uniform(-3.0, 3.0)))
        result.append(SceneObject(f"{kind}/{k}", shape, pose))
        if k % 3 == 0:
            tracks[result[-1].name] = _random_track(random, pose)
    text = f"{objects} objects at random, seed {seed}"
    return Motions(SceneDescription("random", tuple(result), text), tracks)


def _random_shape(random: np.random.Generator) -> tuple[Shape, str, float]:
    """Return a shape, its namespace and its height."""
    length, width, height = (float(x) for x in _on_grid(random.uniform(0.3, 1.0, 3)))
    kind = int(random.integers(3))
    if kind == 0:
        return Sphere(0.5 * height), "sphere", height
    if kind == 1:
        return Cylinder(0.5 * width, height), "cylinder", height
    return Box((length, width, height)), "box", height


def _random_track(random: np.random.Generator, start: Pose) -> Track:
    """Return a round trip from a pose, at its height."""
    poses = [start]
    for _ in range(WAYPOINTS - 1):
        x, y = np.array(start[:2]) + random.uniform(-REACH, REACH, 2)
        turn = quaternion_from_rpy(0.0, 0.0, random.uniform(-3.0, 3.0))
        poses.append((float(x), float(y), start[2], *turn))
    period = float(random.uniform(*PERIODS))
    return object_track(np.array(poses), [period * k / WAYPOINTS for k in range(WAYPOINTS)], period)


def _on_grid(values: Floats) -> tuple[float, ...]:
    return tuple((2.0 * GRID * np.round(values / (2.0 * GRID))).tolist())

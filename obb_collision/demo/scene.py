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

from pathlib import Path

from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.scene_file import keys_from_names
from obb_collision.scene_files import SceneDescription
from obb_collision.scene_files.simulate.lidar import Cloud
from obb_collision.shapes import Shape
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
        self._scene.move_many(self.description.names, self.states(time)[0])
        return self.description.lidar.scan(self._scene, time)

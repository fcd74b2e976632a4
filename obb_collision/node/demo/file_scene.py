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

"""A scene file as the demo's scene."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.shapes import Capsule, Cylinder, Shape
from obb_collision.node.demo.layout import BLUE, CARD, NAVY, STEEL, STONE, VIOLET, WHITE, WOOD, Item
from obb_collision.node.demo.scene import FloatArray
from obb_collision.node.scene_files import keys_from_names
from obb_collision.scene.files import SceneDescription
from obb_collision.scene.files.lidar import Cloud
from obb_collision.scene.patterns import matching
from obb_collision.scene.scene import Scene

Rows = npt.NDArray[np.int64]

#: Colours of objects that name none, by namespace in the order in which they come.
PALETTE = (CARD, BLUE, WHITE, WOOD, STEEL, VIOLET, NAVY, STONE)


class FileScene:
    """A scene file with the interface of ``DemoScene``, and twists and a lidar's points.

    file: what it was read from, for the node reads it, too.
    """

    def __init__(self, description: SceneDescription, file: Path) -> None:
        self.description, self.file = description, file
        keys = keys_from_names(description.names)
        palette = dict.fromkeys(namespace for namespace, _ in keys)
        shades = {namespace: PALETTE[k % len(PALETTE)] for k, namespace in enumerate(palette)}
        self.items = [
            Item(
                namespace,
                number,
                thing.shape,
                thing.color[:3] if thing.color is not None else shades[namespace],
                partial(self._pose, row),
                "object_states" if thing.motion is not None else "",
                opacity=thing.color[3] if thing.color is not None else 1.0,
            )
            for row, ((namespace, number), thing) in enumerate(
                zip(keys, description.objects, strict=True)
            )
        ]
        self._scene = Scene()
        for thing in description.objects:
            self._scene.add(thing.name, thing.shape, thing.pose)
        sees = () if description.lidar is None else description.lidar.sees
        self._seen = np.flatnonzero(matching(sees, description.names))
        turned = (Cylinder, Capsule)
        self._turned = [isinstance(self.items[row].shape, turned) for row in self._seen]
        self._time, self._states = np.nan, description.states(0.0)  # as asked for last

    @property
    def names(self) -> list[str]:
        """The names of the objects on the topics, in their order."""
        return [item.name for item in self.items]

    def channel(self, name: str) -> list[int]:
        """Return the rows of the objects whose motion goes through a topic."""
        return [row for row, item in enumerate(self.items) if item.channel == name]

    def poses(self, time: float) -> FloatArray:
        """Return the poses (n, 7) at a time, x y z qx qy qz qw."""
        return self._at(time)[0].copy()

    def twists(self, time: float) -> FloatArray:
        """Return the twists (n, 6) at a time, linear and angular x y z, m/s and rad/s."""
        return self._at(time)[1].copy()

    def shapes(self, time: float) -> list[Shape]:
        """Return the shapes, which stay."""
        return [item.shape for item in self.items]

    def points(self, time: float) -> Cloud | None:
        """Return the points (k, 3) that the file's lidar sees at a time, None without one."""
        if self.description.lidar is None:
            return None
        return self.description.lidar.scan(self.boxes(time, self._seen), time, self._turned)

    def _at(self, time: float) -> tuple[FloatArray, FloatArray]:
        if time != self._time:
            self._time, self._states = time, self.description.states(time)
        return self._states

    def _pose(self, row: int, time: float) -> Any:
        return tuple(self._at(time)[0][row].tolist())

    def boxes(self, time: float, rows: Rows) -> Boxes:
        """Return the boxes of some of the objects at a time."""
        self._scene.move_many(self.description.names, self.poses(time))
        return self._scene.boxes.take(rows)

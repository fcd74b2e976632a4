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

"""From where the demo's picture is drawn, and how large: small scenes are drawn enlarged.

The picture's own space has the size of the demo's warehouse: light, floor and line widths suit it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.node.demo import raster
from obb_collision.node.demo.raster import FloatArray
from obb_collision.scene.files.description import View

#: Width and height of the picture, pixels.
SIZE = (1600, 900)
#: Pixels drawn for each pixel of the picture, each way: smooth edges.
SAMPLES = 2
#: Pixels of the picture per unit of slope.
FOCAL = 1730.0
#: Where the warehouse is seen from, and the place in the middle of the picture.
EYE, TARGET = np.array((6.4, -11.2, 7.0)), np.array((0.38, -0.05, 0.75))
DISTANCE = float(np.linalg.norm(EYE - TARGET))
#: Share of the picture that a scene without a view of its own fills, from the middle outwards, and
#: how often the distance is set right for that: what is nearer grows faster.
FILLED, TRIALS = 0.82, 4


@dataclass(frozen=True, eq=False)
class Camera:
    """Eye and target (3,) in the picture's space, to which world points * scale + offset go."""

    eye: FloatArray
    target: FloatArray
    scale: float = 1.0
    offset: FloatArray = field(default_factory=lambda: np.zeros(3))

    def place(self, points: FloatArray) -> FloatArray:
        """Return where world points (..., 3) are in the picture's space."""
        result: FloatArray = points * self.scale + self.offset
        return result

    def place_boxes(self, boxes: Boxes) -> Boxes:
        """Return where boxes are in the picture's space."""
        return Boxes(self.place(boxes.centers), boxes.rotations, boxes.half_extents * self.scale)

    @property
    def view(self) -> raster.View:
        """The projection of the picture's space to the pixels drawn."""
        size = (SIZE[0] * SAMPLES, SIZE[1] * SAMPLES)
        return raster.look(self.eye, self.target, FOCAL * SAMPLES, size, True)

    def pixels(self, points: FloatArray) -> FloatArray:
        """Return where world points (k, 3) are on the picture (k, 2)."""
        result: FloatArray = self.view.project(self.place(points))[:, :2] / SAMPLES
        return result


WAREHOUSE = Camera(EYE, TARGET)


def camera_of(view: View | None, boxes: Boxes) -> Camera:
    """Return the camera for a view of a scene file, or for one that has all boxes in it."""
    minimum, maximum = boxes.world_bounds()
    low, high = minimum.min(axis=0), maximum.max(axis=0)
    floor = min(0.0, float(low[2]))
    if view is not None:
        return _camera(np.array(view.eye), np.array(view.target), floor)
    target = (low + high) / 2.0
    signs = np.array(list(product((-1.0, 1.0), repeat=3)))
    reach = signs * boxes.half_extents[:, None]
    corners = boxes.centers[:, None] + np.einsum("nij,nkj->nki", boxes.rotations, reach)
    away = max(float(np.linalg.norm(high - low)), 1e-6) * 2.0
    for _ in range(TRIALS):
        camera = _camera(target + (EYE - TARGET) * (away / DISTANCE), target, floor)
        furthest = np.abs(camera.pixels(corners.reshape(-1, 3)) / SIZE - 0.5).max()
        away *= 2.0 * float(furthest) / FILLED
    return _camera(target + (EYE - TARGET) * (away / DISTANCE), target, floor)


def _camera(eye: FloatArray, target: FloatArray, floor: float) -> Camera:
    """Return the camera from world places; floor: the height that becomes the picture's."""
    scale = DISTANCE / float(np.linalg.norm(eye - target))
    offset = np.array((*(TARGET - target * scale)[:2], -floor * scale))
    return Camera(eye * scale + offset, target * scale + offset, scale, offset)

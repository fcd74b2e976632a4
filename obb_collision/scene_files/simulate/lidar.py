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

"""A simulated lidar: the cloud that a scanner in the middle of a scene would measure.

For demos and measurements of the effect ``points``. The rays hit the floor (z = 0) and, of the
objects that the sensor sees, the oriented boxes or the upright cylinders in them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.rays.rays import cast_rays
from obb_collision.typing import Floats, Rows

Cloud = NDArray[np.float32]

#: Scanners have a few lines of many points: this many, between these angles above the horizon.
LINES = 32
LOWEST, HIGHEST = np.radians(-35.0), np.radians(15.0)
#: Standard deviation of a measured distance (m), and the nearest one measured.
NOISE, NEAREST = 0.01, 0.3


@dataclass(frozen=True)
class Lidar:
    """A scanner: number of rays per revolution, range (m), position (3,), patterns of what it sees.

    seed: of the noise of the distances; equal seeds and times give equal clouds.
    """

    count: int
    range: float
    position: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sees: tuple[str, ...] = ("*",)
    seed: int = 0

    @cached_property
    def directions(self) -> Floats:
        """Unit directions (count, 3) of the rays, line by line from below."""
        lines = min(LINES, self.count)
        line = np.arange(self.count) * lines // self.count
        turn = np.modf(np.arange(self.count) * lines / self.count)[0] * 2.0 * np.pi
        rise = LOWEST + (HIGHEST - LOWEST) * line / max(lines - 1, 1)
        return np.stack(
            [np.cos(rise) * np.cos(turn), np.cos(rise) * np.sin(turn), np.sin(rise)], axis=1
        )

    def scan(self, boxes: Boxes, time: float, turned: Sequence[bool] = ()) -> Cloud:
        """Return the points (k, 3) seen at a time (s).

        boxes: of what it sees; turned (n,): whether cylinders along z stand in them.
        """
        directions, origin = self.directions, np.array(self.position)
        with np.errstate(divide="ignore"):
            ways = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        ways[ways <= 0.0] = np.inf
        local = np.einsum("nji,nj->ni", boxes.rotations, origin - boxes.centers)
        outside = (np.abs(local) > boxes.half_extents).any(axis=1)  # from inside nothing is seen
        ways = np.minimum(ways, self.range)
        met = np.flatnonzero(self._to_boxes(boxes[outside], ways) < ways)
        is_turned = np.zeros(len(boxes), np.bool_) if len(turned) == 0 else np.array(turned)
        flat = boxes[outside & ~is_turned]
        ways[met] = np.minimum(ways[met], self._to_boxes(flat, ways[met], met))
        for row in np.flatnonzero(outside & is_turned):
            to_cylinder = _to_cylinder(local[row], directions[met], boxes[row : row + 1])
            ways[met] = np.minimum(ways[met], to_cylinder)
        moment = round(time * 1e6) % 2**63  # microseconds: the resolution that matters in a stamp
        noise = np.random.default_rng([self.seed, moment]).normal(0.0, NOISE, self.count)
        seen = (ways >= NEAREST) & (ways < self.range)
        points = origin + (ways + noise)[seen, None] * directions[seen]
        return points.astype(np.float32)

    def _to_boxes(self, boxes: Boxes, reaches: Floats, rays: Rows | None = None) -> Floats:
        """Return (n,) metres along some of the rays to the first box, inf beyond their ranges."""
        directions = self.directions if rays is None else self.directions[rays]
        origins = np.tile(np.array(self.position), (len(directions), 1))
        return cast_rays(boxes, origins, directions, reaches).distances


def _to_cylinder(start: Floats, directions: Floats, box: Boxes) -> Floats:
    """Return (n,) metres along rays to the cylinder along z in a box, inf where they miss it.

    start (3,): the origin in the frame of the box.
    """
    along = directions @ box.rotations[0]
    radius, _, height = box.half_extents[0]
    a = (along[:, :2] ** 2).sum(axis=1)
    b = along[:, :2] @ start[:2]
    root = b * b - a * (start[:2] @ start[:2] - radius * radius)
    with np.errstate(divide="ignore", invalid="ignore"):
        side = np.sqrt(root) / a
        enter, leave = -b / a - side, -b / a + side
        caps = (np.array([[-height], [height]]) - start[2]) / along[:, 2]
    near, far = np.fmax(enter, caps.min(axis=0)), np.fmin(leave, caps.max(axis=0))
    return np.where((root >= 0.0) & (near <= far) & (near > 0.0), near, np.inf)

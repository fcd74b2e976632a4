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

For demos and measurements of the effect ``points``. The rays hit the floor (z = 0) and the shapes
of the objects that the sensor sees.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import compress

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import matching
from obb_collision.typing import Floats

Cloud = NDArray[np.float32]

#: Scanners have a few lines of many points: this many, between these angles above the horizon.
LINES = 32
LOWEST, HIGHEST = np.radians(-35.0), np.radians(15.0)
#: Standard deviation of a measured distance (m), and the nearest one measured.
NOISE, NEAREST = 0.01, 0.3
#: Any direction, for where a ray of no length is.
UP = 0.0, 0.0, 1.0


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

    def scan(self, scene: Scene, time: float) -> Cloud:
        """Return the points (k, 3) seen of a scene at a time (s); from inside nothing is seen."""
        directions, origin = self.directions, np.array(self.position)
        with np.errstate(divide="ignore"):
            ways = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        ways[ways <= 0.0] = np.inf
        ways = np.minimum(ways, self.range)
        there = set(compress(scene.names, matching(self.sees, scene.names)))
        while True:
            around = scene.cast_rays([origin], [UP], 0.0, accuracy=Accuracy.MESH, objects=there)
            if not around.hits[0]:
                break
            there.remove(scene.name(around.boxes[0]))
        origins = np.tile(origin, (len(directions), 1))
        found = scene.cast_rays(origins, directions, ways, accuracy=Accuracy.MESH, objects=there)
        ways = np.minimum(ways, found.distances)
        moment = round(time * 1e6) % 2**63  # microseconds: the resolution that matters in a stamp
        noise = np.random.default_rng([self.seed, moment]).normal(0.0, NOISE, self.count)
        seen = (ways >= NEAREST) & (ways < self.range)
        points = origin + (ways + noise)[seen, None] * directions[seen]
        return points.astype(np.float32)

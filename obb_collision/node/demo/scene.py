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

"""The demo's scene: a small warehouse whose objects move as functions of time.

Everything follows from (number of objects, seed, time). Metres, seconds; z is up, the floor at 0.
"""

from __future__ import annotations

from itertools import chain, islice

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.shapes import Shape
from obb_collision.node.demo.layout import DEFAULT_OBJECTS, DEFAULT_SEED, MIN_OBJECTS, PARTS, Item

FloatArray = npt.NDArray[np.float64]


class DemoScene:
    """The first ``objects`` objects of the warehouse of a seed."""

    def __init__(self, objects: int = DEFAULT_OBJECTS, seed: int = DEFAULT_SEED) -> None:
        if objects < MIN_OBJECTS:
            raise ValueError(f"objects must be at least {MIN_OBJECTS}, got {objects}")
        # one generator a part: taking fewer objects changes nothing about those that stay
        sources = (np.random.default_rng([seed, k]) for k in range(len(PARTS)))
        parts = chain.from_iterable(part(r) for part, r in zip(PARTS, sources, strict=True))
        self.items: list[Item] = list(islice(parts, objects))
        self._time, self._poses = np.nan, np.empty((0, 7))  # as asked for last

    @property
    def names(self) -> list[str]:
        """The names of the objects, in their order."""
        return [item.name for item in self.items]

    def channel(self, name: str) -> list[int]:
        """Return the rows of the objects whose motion goes through a topic."""
        return [row for row, item in enumerate(self.items) if item.channel == name]

    def poses(self, time: float) -> FloatArray:
        """Return the poses (n, 7) at a time, x y z qx qy qz qw."""
        if time != self._time:
            self._time, self._poses = time, np.array([item.motion(time) for item in self.items])
        return self._poses.copy()

    def shapes(self, time: float) -> list[Shape]:
        """Return the shapes at a time; the same values while a shape does not change."""
        return [item.stretch(time) if item.stretch else item.shape for item in self.items]

    def twists(self, time: float) -> FloatArray | None:
        """Return None: nobody is told how fast these things move."""
        return None

    def points(self, time: float) -> FloatArray | None:
        """Return None: there is no sensor."""
        return None

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


"""What sensors say about the surroundings of a base: points of their messages in their frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from obb_collision.typing import Floats

OBSERVATIONS = SCAN, CLOUD, RANGE, POLYGON = ("scan", "pointcloud", "range", "polygon")


class Observed(NamedTuple):
    """The parameters of an observation source, named as nav2_collision_monitor does."""

    name: str
    type: str
    topic: str
    enabled: bool
    source_timeout: float
    min_height: float
    max_height: float
    min_range: float
    use_global_height: bool
    obstacles_angle: float
    sampling_distance: float


def arc(distance: float, view: float, step: float) -> Floats:
    """Return points (k, 3) at a distance over a field of view (rad), one per step and both ends."""
    angles = np.arange(-0.5 * view, 0.5 * view, step)
    angles = np.append(angles, 0.5 * view)
    return np.column_stack([distance * np.cos(angles), distance * np.sin(angles), 0.0 * angles])


def border(corners: Floats, step: float) -> Floats:
    """Return points (k, 3) along the border of a polygon (n, 3), at most a step apart."""
    parts: Sequence[Floats] = [
        a + np.arange(count)[:, None] / count * (b - a)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)
        for count in [max(1, math.ceil(float(np.linalg.norm(b - a)) / step))]
    ]
    return np.concatenate([np.empty((0, 3)), *parts])

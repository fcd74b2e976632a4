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

"""Where the objects of a scene will be if they keep their twists."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.validation import Floats
from obb_collision.queries.sweep_motion import bounding_radii
from obb_collision.scene.effects.base import Cycle
from obb_collision.scene.store import Rows

#: Radians that an object turns in a piece of the horizon, where its box goes round the origin of
#: its pose: the arc is taken for its chord, which is at most 0.5 % of the radius away.
ARC = np.pi / 16
#: An object that turns faster than this many pieces allow for is looked at more coarsely.
MOST_PIECES = 64
#: A box this near to the origin of its pose, in half extents, turns in place.
IN_PLACE = 1e-6


def piece_count(cycle: Cycle, slots: Rows, horizon: float) -> int:
    """Return in how many pieces the horizon is looked at, for centres that go round an origin.

    What has its centre at the origin of its pose goes straight, and one is enough.
    """
    turns = horizon * np.linalg.norm(cycle.store.twists[slots, 3:], axis=1)
    arms = np.abs(cycle.boxes.centers[slots] - cycle.store.poses[slots, :3])
    aside = (arms > IN_PLACE * cycle.boxes.half_extents[slots].sum(axis=1, keepdims=True)).any(1)
    return max(1, int(np.ceil(min(turns[aside].max(initial=0.0) / ARC, MOST_PIECES))))


def boxes_ahead(cycle: Cycle, slots: Rows, start: float, seconds: float) -> tuple[Boxes, Floats]:
    """Return the boxes as their twists have them at a time, and twists (n, 6) of their centres.

    These lead straight to where the centres are after the seconds.
    """
    boxes, twists = cycle.boxes.take(slots), cycle.store.twists[slots]
    origins = cycle.store.poses[slots, :3]
    arms = boxes.centers - origins
    turning = np.flatnonzero(twists[:, 3:].any(axis=1))
    speeds = twists.copy()
    first = Rotation.from_rotvec(start * twists[turning, 3:])
    last = Rotation.from_rotvec((start + seconds) * twists[turning, 3:])
    chords = last.apply(arms[turning]) - first.apply(arms[turning])
    speeds[turning, :3] += chords / seconds
    if start == 0.0:
        return boxes, speeds
    centers = boxes.centers + start * twists[:, :3]
    centers[turning] += first.apply(arms[turning]) - arms[turning]
    rotations = boxes.rotations.copy()
    rotations[turning] = first.as_matrix() @ rotations[turning]
    return Boxes.trusted(centers, rotations, boxes.half_extents), speeds


def bounds_ahead(boxes: Boxes, moved: Floats) -> tuple[Floats, Floats]:
    """Return bounds (n, 3), (n, 3) that contain boxes moved and turned by (n, 6) all along."""
    minimum, maximum = boxes.world_bounds()
    turning = moved[:, 3:].any(axis=1)
    radii = bounding_radii(boxes.half_extents[turning])[:, None]
    minimum[turning] = np.nextafter(boxes.centers[turning] - radii, -np.inf)
    maximum[turning] = np.nextafter(boxes.centers[turning] + radii, np.inf)
    low, high = minimum + np.minimum(moved[:, :3], 0.0), maximum + np.maximum(moved[:, :3], 0.0)
    return np.nextafter(low, -np.inf), np.nextafter(high, np.inf)

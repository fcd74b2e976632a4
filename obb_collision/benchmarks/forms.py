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

"""Scenes of every form that a broad phase meets, and how their boxes move.

A box collides with an eighth to two others on average. All that move do so a little in each frame,
as in a simulation or at the rate of a robot: broad phases that update a tree are designed for that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from obb_collision.geometry.poses import matrices_from_quaternions
from obb_collision.typing import Floats, Rows

#: Half extents of ordinary boxes, metres, and their mean.
EXTENTS = (0.05, 0.5)
MEAN = 0.275
#: Cubic metres per box, and per box of a cluster; square metres in a plane, metres on a line.
VOLUME, CLUSTER_VOLUME, AREA, LENGTH = 1.75, 0.6, 1.75, 1.5
#: Boxes of a cluster, metres between clusters, and walls and floors through a scene.
CLUSTER, APART, WALLS = 50, 20.0, 12
#: Half thickness of a wall, metres.
THICKNESS = 0.05
#: Edge of a crate and distance of their centres, metres.
CRATE, PITCH = 0.5, 0.51
#: Coordinates far from the origin, metres; decades of sizes around a metre, each way.
FAR, DECADES = 1e7, 3.0
#: Maximum displacement of a box of mean size along each axis per frame, metres, and maximum
#: rotation about each, radians. Smaller boxes move less.
STEP, TURN = 0.02, 0.05
#: Frames of motion, which are gone through there and back.
FRAMES = 8


@dataclass(frozen=True)
class Frame:
    """Poses (n, 7) of all boxes at one moment, and the rows (k,) of those that moved."""

    poses: Floats
    rows: Rows

    @cached_property
    def moved(self) -> Floats:
        """Poses (k, 7) of those that moved."""
        return self.poses[self.rows]

    @cached_property
    def rotations(self) -> Floats:
        """Rotation matrices (k, 3, 3) of those that moved."""
        return matrices_from_quaternions(self.moved[:, 3:])


def _extents(rng: np.random.Generator, n: int) -> Floats:
    return rng.uniform(*EXTENTS, (n, 3))


def _in_room(rng: np.random.Generator, n: int, volume: float) -> Floats:
    half = 0.5 * volume ** (1 / 3)
    return rng.uniform(-half, half, (n, 3))


def uniform(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes of 0.1 to 1 m all over a room."""
    return _extents(rng, n), _in_room(rng, n, VOLUME * n)


def plane(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes with their centres in a plane."""
    half = 0.5 * np.sqrt(AREA * n)
    return _extents(rng, n), rng.uniform(-half, half, (n, 3)) * [1.0, 1.0, 0.0]


def line(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes with their centres on a line."""
    return _extents(rng, n), rng.uniform(0.0, LENGTH * n, (n, 1)) * [1.0, 0.0, 0.0]


def walls(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Walls and floors across a room of small boxes."""
    half_extents, centers = uniform(rng, n)
    count = min(WALLS, n // 2)
    half_extents[:count] = 0.5 * (VOLUME * n) ** (1 / 3)
    half_extents[np.arange(count), np.arange(count) % 3] = THICKNESS
    across = np.arange(count) % 3 == np.arange(3)[:, None]
    centers[:count] *= across.T
    return half_extents, centers


def clusters(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Tight clusters, far from one another."""
    count = -(-n // CLUSTER)
    places = _in_room(rng, count, count * APART**3)
    inside = _in_room(rng, n, CLUSTER * CLUSTER_VOLUME)
    return _extents(rng, n), places[np.arange(n) % count] + inside


def identical(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Equal crates side by side and on top of each other, in a grid."""
    side = int(np.ceil(n ** (1 / 3)))
    cells = np.stack(np.unravel_index(np.arange(n), (side, side, side)), axis=1)
    return np.full((n, 3), 0.5 * CRATE), PITCH * cells.astype(np.float64)


def decades(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Sizes over six decades, from millimetres to kilometres."""
    sizes = 10.0 ** rng.uniform(-DECADES, DECADES, (n, 1))
    reach = np.mean((sizes + rng.permutation(sizes)) ** 3) / (2.0 * MEAN) ** 3
    return sizes * rng.uniform(0.5, 1.0, (n, 3)), _in_room(rng, n, n * VOLUME * reach)


def far(rng: np.random.Generator, n: int) -> tuple[Floats, Floats]:
    """Boxes all over a room, with coordinates of ten million metres."""
    half_extents, centers = uniform(rng, n)
    return half_extents, centers + FAR


#: Half extents (n, 3) and centres (n, 3) by name.
FORMS: dict[str, Callable[[np.random.Generator, int], tuple[Floats, Floats]]] = {
    maker.__name__: maker
    for maker in (uniform, plane, line, walls, clusters, identical, decades, far)
}
#: Forms whose boxes stay parallel to the axes.
PARALLEL = {"identical"}


def make_frames(form: str, count: int, moving: float, seed: int) -> tuple[Floats, list[Frame]]:
    """Return half extents (n, 3) and frames in which a share of the boxes moves.

    The first frame is where all begin.
    """
    rng = np.random.default_rng(seed)
    half_extents, centers = FORMS[form](rng, count)
    rotations = Rotation.identity(count) if form in PARALLEL else Rotation.random(count, rng)
    if form == "walls":
        straight = np.arange(count) < min(WALLS, count // 2)
        rotations = Rotation.from_quat(
            np.where(straight[:, None], [0.0, 0.0, 0.0, 1.0], rotations.as_quat())
        )
    rows = np.sort(rng.choice(count, round(moving * count), replace=False))
    steps = STEP * np.minimum(1.0, half_extents[rows].mean(axis=1, keepdims=True) / MEAN)
    turns = np.minimum(TURN, STEP / half_extents[rows].max(axis=1, keepdims=True))
    turns *= form not in PARALLEL
    poses = np.concatenate([centers, rotations.as_quat()], axis=1)
    frames = [Frame(poses, rows)]
    for _ in range(FRAMES - 1):
        poses = poses.copy()
        poses[rows, :3] += steps * rng.uniform(-1.0, 1.0, (len(rows), 3))
        if len(rows):  # before 1.15 scipy makes no rotations of none
            turned = Rotation.from_rotvec(turns * rng.uniform(-1.0, 1.0, (len(rows), 3)))
            poses[rows, 3:] = (turned * Rotation.from_quat(poses[rows, 3:])).as_quat()
        frames.append(Frame(poses, rows))
    return half_extents, frames + frames[-2:0:-1]  # there and back: no jump at the end

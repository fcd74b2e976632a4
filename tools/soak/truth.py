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

"""Which bodies collide: all pairs, by the corners of both boxes on 15 axes.

Shares no code and no formula with the library, which projects radii and searches by bounds. Doubles
decide but for gaps below ``SURE``. Boxes on the grid are exact: their coordinates are multiples of
1/8 and their axes those of the frame, so nothing is rounded, and touching is a collision.
"""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import numpy as np

from obb_collision.typing import Floats, Integers

SURE = 1e-9
"""Gaps of this size (m) are decided: a million times what is rounded in coordinates below 1e3 m."""
GRID = 0.125
"""Centres and half extents of exact boxes are multiples of this (m)."""
NO_AXIS = 1e-7
"""Edge axes shorter than this are of parallel edges: the other axes decide."""
CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))


class Truth(NamedTuple):
    """Pairs that collide, or that doubles do not decide.

    pairs (m, 2) rows i < j; depths (m,) minimum translation that separates (m); sure (m,).
    """

    pairs: Integers
    depths: Floats
    sure: np.ndarray


def truth_of(poses: Floats, sizes: Floats) -> Truth:
    """Test each pair of boxes: poses (n, 7), sizes (n, 3) edge lengths."""
    rotations = rotations_of(poses[:, 3:])
    corners = np.einsum("kc,nic->nki", CORNERS, rotations * sizes[:, None, :])
    corners += poses[:, None, :3]
    pairs = _near(poses[:, :3], 0.5 * np.linalg.norm(sizes, axis=1))
    i, j = pairs.T
    gaps = _gaps(corners[i], corners[j], rotations[i], rotations[j])
    exact = _on_grid(poses, sizes)
    sure = (np.abs(gaps) > SURE) | (exact[i] & exact[j])
    found = (gaps <= 0.0) | ~sure
    return Truth(pairs[found], -gaps[found], sure[found])


def rotations_of(quaternions: Floats) -> Floats:
    """Return matrices (n, 3, 3) of quaternions x y z w (n, 4) of any length."""
    x, y, z, w = (quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)).T
    rows = (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
        (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
        (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
    )
    matrices: Floats = np.moveaxis(np.array(rows), 2, 0)
    return matrices


def _near(centers: Floats, radii: Floats) -> Integers:
    """Return the rows of all pairs but those whose balls are apart."""
    i, j = np.triu_indices(len(centers), 1)
    offsets = centers[i] - centers[j]
    reach = radii[i] + radii[j] + SURE
    near = np.einsum("nk,nk->n", offsets, offsets) <= reach * reach
    return np.stack([i[near], j[near]], axis=1)


def _gaps(corners_a: Floats, corners_b: Floats, axes_a: Floats, axes_b: Floats) -> Floats:
    """Return the largest gap of each pair over 15 unit axes (m); negative: the depth."""
    crossed = np.cross(axes_a[:, :, :, None], axes_b[:, :, None, :], axis=1)
    lengths = np.linalg.norm(crossed, axis=1, keepdims=True)
    null = lengths[:, 0].reshape(-1, 9) < NO_AXIS
    crossed = (crossed / np.maximum(lengths, NO_AXIS)).reshape(-1, 3, 9)
    axes = np.concatenate([axes_a, axes_b, crossed], axis=2)
    a, b = np.matmul(corners_a, axes), np.matmul(corners_b, axes)
    gaps = np.maximum(b.min(axis=1) - a.max(axis=1), a.min(axis=1) - b.max(axis=1))
    gaps[:, 6:][null] = -np.inf
    largest: Floats = gaps.max(axis=1, initial=-np.inf)
    return largest


def _on_grid(poses: Floats, sizes: Floats) -> np.ndarray:
    steps = np.concatenate([poses[:, :3], 0.5 * sizes], axis=1) / GRID
    upright = (poses[:, 3:] == (0.0, 0.0, 0.0, 1.0)).all(axis=1)
    exact: np.ndarray = (steps == np.round(steps)).all(axis=1) & upright
    return exact

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

"""A point moved into two overlapping boxes: a at the origin, b with its centre at d.

Contact points lie halfway between two faces. Where the boxes overlap by more than the thickness of
one of them, or a face leans away below the other, that is outside; most often it is not.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.queries.contacts.patch import CAPACITY, CLIP_SLACK, KEEP, clip
from obb_collision.typing import Floats

#: A point is pulled into both boxes in turns, at most this often. Most lie there already; where
#: faces meet at a sharp angle the turns take too long.
PULL_ROUNDS = 8


@njit
def move_into_both(
    x: float, y: float, z: float, a: Floats, h: Floats,
    dx: float, dy: float, dz: float, b: Floats, f: Floats, size: float,
) -> tuple[float, float, float]:  # fmt: skip
    """Return a point of both boxes near x, y, z; size: that of the pair.

    Projections onto convex sets in turns (von Neumann; Bregman 1965) never take two points further
    apart, so that what moves a little still does. If that takes too long, the way leads straight
    towards a point that is known to be common.
    """
    for _ in range(PULL_ROUNDS):
        x, y, z, _ = _pull(x, y, z, a, h)
        x, y, z, moved = _pull(x - dx, y - dy, z - dz, b, f)
        x, y, z = x + dx, y + dy, z + dz
        if moved <= KEEP * size:
            return x, y, z
    mx, my, mz, found = middle(a, h, dx, dy, dz, b, f, size)
    if not found:
        return x, y, z
    part = min(
        _part_inside(mx, my, mz, x - mx, y - my, z - mz, a, h),
        _part_inside(mx - dx, my - dy, mz - dz, x - mx, y - my, z - mz, b, f),
    )
    return mx + part * (x - mx), my + part * (y - my), mz + part * (z - mz)


@njit
def _pull(
    x: float, y: float, z: float, axes: Floats, extents: Floats
) -> tuple[float, float, float, float]:
    """Return the nearest point of a box at the origin, and the largest step along an axis."""
    p = x * axes[0, 0] + y * axes[1, 0] + z * axes[2, 0]
    q = x * axes[0, 1] + y * axes[1, 1] + z * axes[2, 1]
    r = x * axes[0, 2] + y * axes[1, 2] + z * axes[2, 2]
    p -= min(max(p, -extents[0]), extents[0])
    q -= min(max(q, -extents[1]), extents[1])
    r -= min(max(r, -extents[2]), extents[2])
    x -= p * axes[0, 0] + q * axes[0, 1] + r * axes[0, 2]
    y -= p * axes[1, 0] + q * axes[1, 1] + r * axes[1, 2]
    z -= p * axes[2, 0] + q * axes[2, 1] + r * axes[2, 2]
    return x, y, z, max(abs(p), abs(q), abs(r))


@njit
def _part_inside(
    x: float, y: float, z: float, vx: float, vy: float, vz: float, axes: Floats, extents: Floats
) -> float:
    """Return how much of v, 0 to 1, can be added to a point of a box and stay in it."""
    part = 1.0
    for i in range(3):
        start = x * axes[0, i] + y * axes[1, i] + z * axes[2, i]
        step = vx * axes[0, i] + vy * axes[1, i] + vz * axes[2, i]
        room = extents[i] - start if step > 0.0 else extents[i] + start
        if abs(step) * part > room:
            part = max(room, 0.0) / abs(step)
    return part


@njit
def middle(
    a: Floats, h: Floats, dx: float, dy: float, dz: float, b: Floats, f: Floats, size: float
) -> tuple[float, float, float, bool]:
    """Return a point common to both boxes, well inside where there is room, and whether there is.

    The mean of the vertices of all faces of each box as far as they lie in the other: together
    these bound what is common.
    """
    polygon, spare = np.empty((CAPACITY, 3)), np.empty((CAPACITY, 3))
    x, y, z, count = _sum_faces(a, h, dx, dy, dz, b, f, size, polygon, spare)
    u, v, w, more = _sum_faces(b, f, -dx, -dy, -dz, a, h, size, polygon, spare)
    total = count + more
    if total == 0:
        return 0.0, 0.0, 0.0, False
    x, y, z = x + u + more * (dx / size), y + v + more * (dy / size), z + w + more * (dz / size)
    return x * size / total, y * size / total, z * size / total, True


@njit
def _sum_faces(
    a: Floats, h: Floats, dx: float, dy: float, dz: float, b: Floats, f: Floats, size: float,
    polygon: Floats, spare: Floats,
) -> tuple[float, float, float, int]:  # fmt: skip
    """Return the sum of the vertices of faces of b that lie in a, from a, and their number.

    Faces are clipped in the frame of a, in units of size.
    """
    sx, sy, sz = 0.0, 0.0, 0.0
    total = 0
    for face in range(6):
        j, side = face // 2, 2.0 * (face % 2) - 1.0
        j1, j2 = (j + 1) % 3, (j + 2) % 3
        for corner in range(4):
            p = 1.0 if corner == 1 or corner == 2 else -1.0
            q = 1.0 if corner >= 2 else -1.0
            x = dx + side * f[j] * b[0, j] + p * f[j1] * b[0, j1] + q * f[j2] * b[0, j2]
            y = dy + side * f[j] * b[1, j] + p * f[j1] * b[1, j1] + q * f[j2] * b[1, j2]
            z = dz + side * f[j] * b[2, j] + p * f[j1] * b[2, j1] + q * f[j2] * b[2, j2]
            for i in range(3):
                polygon[corner, i] = (x * a[0, i] + y * a[1, i] + z * a[2, i]) / size
        count = 4
        for i in range(3):
            count = clip(polygon, count, i, 1.0, h[i] / size + CLIP_SLACK, spare)
            count = clip(spare, count, i, -1.0, h[i] / size + CLIP_SLACK, polygon)
        for k in range(count):
            x, y, z = polygon[k, 0], polygon[k, 1], polygon[k, 2]
            sx += x * a[0, 0] + y * a[0, 1] + z * a[0, 2]
            sy += x * a[1, 0] + y * a[1, 1] + z * a[1, 2]
            sz += x * a[2, 0] + y * a[2, 1] + z * a[2, 2]
        total += count
    return sx, sy, sz, total

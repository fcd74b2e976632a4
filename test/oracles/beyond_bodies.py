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

"""How far points are beyond the surfaces of convex bodies, by the formula of each kind."""

from __future__ import annotations

import numpy as np

from obb_collision.queries.convex.support import (
    BOX,
    CORNERS,
    CYLINDER,
    ROUND,
    SEGMENT,
    ConvexBodies,
)
from obb_collision.typing import Floats


def beyond(body: ConvexBodies, points: Floats) -> Floats:
    """Return how far points (m, 3) are outside of bodies, to first order; not of hulls.

    That those of hulls are right follows from their distances.
    """
    p = np.einsum("nij,ni->nj", body.rotations, points - body.centers)
    sizes, half = body.sizes[:, :3], body.sizes[:, 3]
    kind = int(body.kinds[0])
    if kind == CORNERS:
        return np.zeros(len(p))
    if kind == BOX:
        return (np.abs(p) - sizes).max(axis=1)
    if kind == SEGMENT:
        p[:, 2] -= np.clip(p[:, 2], -half, half)
        return np.linalg.norm(p, axis=1) - body.radii
    thin = np.where(sizes > 0.0, 0.0, np.abs(p)).max(axis=1)
    if kind == ROUND:
        return np.maximum(thin, beyond_ellipse(p, sizes))
    along = np.abs(p[:, 2]) - half
    if kind == CYLINDER:
        return np.maximum(along, beyond_ellipse(p[:, :2], sizes[:, :2]))
    flat = half == 0.0
    width = np.where(flat, 1.0, (half - p[:, 2]) / np.where(flat, 1.0, 2.0 * half))
    rim = np.linalg.norm(p[:, :2] / sizes[:, :2], axis=1)
    steep = 1.0 / np.hypot(1.0 / sizes.max(axis=1), np.where(flat, 0.0, 0.5 / half.clip(1e-300)))
    return np.maximum(along, (rim - width) * steep)


def beyond_ellipse(p: Floats, sizes: Floats) -> Floats:
    """Return the distance to first order: a function that is 1 on the surface, by its slope."""
    used = sizes > 0.0
    u = np.where(used, p / np.where(used, sizes, 1.0), 0.0)
    length = np.linalg.norm(u, axis=1)
    slope = np.linalg.norm(np.where(used, u / np.where(used, sizes, 1.0), 0.0), axis=1)
    return (length - 1.0) * length / np.where(slope > 0.0, slope, 1.0)

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

"""How far convex bodies reach along directions, in long doubles: planes that part them."""

from __future__ import annotations

import numpy as np
from convex_bodies import Pair, corners_of
from numpy.typing import NDArray

from obb_collision.queries.convex.support import BOX, CONE, CORNERS, CYLINDER, ConvexBodies
from obb_collision.typing import Floats

Long = NDArray[np.longdouble]


def exact_reach(body: ConvexBodies, n: Long) -> Long:
    """Return how far bodies reach along directions n (m, 3), of length one to 64 bits."""
    rotations, sizes = body.rotations.astype(np.longdouble), body.sizes.astype(np.longdouble)
    m = np.einsum("nij,ni->nj", rotations, n)
    x, y, z, half = (sizes[:, k] for k in range(4))
    rim = np.sqrt((x * m[:, 0]) ** 2 + (y * m[:, 1]) ** 2)
    kind = int(body.kinds[0])
    if kind == CORNERS:
        points = np.array([corners_of(body, i) for i in range(len(m))]).astype(np.longdouble)
        core = np.einsum("nkj,nj->nk", points, m).max(axis=1)
    elif kind == BOX:
        core = (np.abs(m) * sizes[:, :3]).sum(axis=1)
    elif kind == CYLINDER:
        core = rim + half * np.abs(m[:, 2])
    elif kind == CONE:
        core = np.maximum(half * m[:, 2], rim - half * m[:, 2])
    else:
        core = np.sqrt(rim**2 + (z * m[:, 2]) ** 2) + half * np.abs(m[:, 2])
    return core + body.radii * np.sqrt((n * n).sum(axis=1))


def exact_gap(pair: Pair, normals: Floats) -> Long:
    a, b = pair
    n = normals.astype(np.longdouble)
    n /= np.sqrt((n * n).sum(axis=1))[:, None]
    offset = b.centers.astype(np.longdouble) - a.centers
    gap: Long = (n * offset).sum(axis=1) - exact_reach(a, n) - exact_reach(b, -n)
    return gap

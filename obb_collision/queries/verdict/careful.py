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

"""The gap of two boxes along one axis, nearly exact: cross products without cancellation.

The result doesn't depend on the order of the boxes, or of their axes: sums are sorted. Its error
analysis is that of ``verdict``.
"""

from __future__ import annotations

import numpy as np

from obb_collision._jit import njit
from obb_collision.numerics.constants import PARALLEL
from obb_collision.numerics.vec3 import careful_cross, dot, minus, negated, norm
from obb_collision.queries.verdict.pair_frame import Box
from obb_collision.queries.verdict.sat import factors, projected_radius
from obb_collision.typing import Vector


@njit
def careful_gap(a: Box, b: Box, axis: int) -> tuple[float, Vector]:
    """Return the gap along a unit axis (numbers as in ``sat``), and the axis, from a towards b.

    Face normals are cross products too: stored axes are orthonormal to rounding only.

    Edges shorter than PARALLEL in their product count as parallel: doubles can't distinguish them.
    Such an axis can separate only if another one does up to its bound (the argument of
    ``verdict._implied_margin``, with a margin below every bound), so its gap is minus infinity.
    """
    u, v = factors(a.axes, b.axes, axis)
    x, y, z = careful_cross(u, v)
    size = norm((x, y, z))
    if size < PARALLEL:
        return -np.inf, (0.0, 0.0, 0.0)
    n = x / size, y / size, z / size
    along = dot(n, minus(b.center, a.center))
    gap = abs(along) - (
        projected_radius(n, a.axes, a.half_extents) + projected_radius(n, b.axes, b.half_extents)
    )
    return gap, negated(n) if along < 0.0 else n

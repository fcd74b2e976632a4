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

"""The separating axis test in exact arithmetic, for the pairs that doubles leave open."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.numerics.exact import Vector, cross, dot, exact_axes, exact_integers
from obb_collision.queries.verdict.sat import FACTORS

Index = int | np.integer


def exact_verdict(a: Boxes, row_a: Index, b: Boxes, row_b: Index) -> int:
    """Return 0 separate, 1 touching or 2 overlap of two boxes, decided exactly.

    Their doubles are taken as exact numbers. All 15 axes are exact cross products, also the face
    normals. Null ones (parallel edges) say nothing and are skipped.
    """
    axes_a, power_a = exact_axes(a.rotations[row_a])
    axes_b, power_b = exact_axes(b.rotations[row_b])
    power = max(power_a, power_b)
    axes_a = _scaled(axes_a, power - power_a)
    axes_b = _scaled(axes_b, power - power_b)
    parts = a.centers[row_a], b.centers[row_b], a.half_extents[row_a], b.half_extents[row_b]
    numbers, _ = exact_integers([number for part in parts for number in part.tolist()])
    # lengths along an axis vector come as (length) x (axis entry): the offset needs the factor
    offset = (
        (numbers[3] - numbers[0]) << power,
        (numbers[4] - numbers[1]) << power,
        (numbers[5] - numbers[2]) << power,
    )
    edges = list(zip(numbers[6:], axes_a + axes_b, strict=True))
    touching = False
    for i, j in FACTORS.tolist():
        axis = cross(edges[i][1], edges[j][1])
        if axis == (0, 0, 0):
            continue
        reach = sum(extent * abs(dot(axis, edge)) for extent, edge in edges)
        gap = abs(dot(axis, offset)) - reach
        if gap > 0:
            return 0
        touching = touching or gap == 0
    return 1 if touching else 2


def _scaled(axes: tuple[Vector, Vector, Vector], power: int) -> tuple[Vector, Vector, Vector]:
    x, y, z = ((v[0] << power, v[1] << power, v[2] << power) for v in axes)
    return x, y, z

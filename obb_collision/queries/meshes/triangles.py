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

"""Do two triangles collide? Certified, in three stages.

Closed triangles in space, verdicts as for boxes: SEPARATE, no common point; OVERLAP, no small
move parts them: one pierces the other; TOUCHING, undecided. Triangles in one plane
that share points are TOUCHING, like flat boxes: an arbitrarily small move along the normal parts
them. A triangle may be a segment or a point.

``triangle_signs`` decides in doubles, ``triangle_axes`` with twice the digits what is left, and
``triangle_exact``, where asked, the rest in integers.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision._jit import njit
from obb_collision.geometry.validation import as_array, check_lengths
from obb_collision.queries.meshes.tree_boxes import Place
from obb_collision.queries.meshes.triangle_axes import classify_by_axes
from obb_collision.queries.meshes.triangle_exact import exact_triangle_verdict
from obb_collision.queries.meshes.triangle_signs import (
    TOUCHING,
    UNDECIDED,
    classify_by_signs,
    triangle_at,
)
from obb_collision.typing import Floats

#: A place that changes nothing.
STILL = Place((0.0, 0.0, 0.0), ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))


def triangle_verdicts(a: ArrayLike, b: ArrayLike, exact: bool = False) -> NDArray[np.int8]:
    """Return the verdict of each triangle of a (n, 3, 3) with the same row of b, (n,) int8.

    Rows of a triangle are its corners, metres. With ``exact=True`` TOUCHING means touching
    exactly, and never wrong. Raises ValueError for other shapes, lengths that differ, and
    numbers that are not finite.
    """
    first = as_array(a, "a", (None, 3, 3)).reshape(-1, 9)
    second = as_array(b, "b", (None, 3, 3)).reshape(-1, 9)
    check_lengths(a=first, b=second)
    result = np.empty(len(first), np.int8)
    _verdict_kernel(first, second, result)
    if exact:
        still = np.zeros(3), np.eye(3)
        for n in np.flatnonzero(result == TOUCHING):
            result[n] = exact_triangle_verdict(first[n], still, second[n], still)
    return result


@njit
def _verdict_kernel(a: Floats, b: Floats, out: np.ndarray) -> None:
    """Write the verdict of each row of a and b (n, 9)."""
    for n in range(len(a)):
        p, q = triangle_at(a, n), triangle_at(b, n)
        verdict = classify_by_signs(p, q, 0.0)
        out[n] = classify_by_axes(p, STILL, q, STILL) if verdict == UNDECIDED else verdict

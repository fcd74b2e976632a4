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

"""Independent exact verdict of two triangles: all common points, by linear programming.

A common point is sum l_i p_i = sum m_j q_j with weights >= 0 that sum to one on either side: five
equations in six unknowns. The vertices of that polytope of weights have linearly independent
columns, so solving for every subset of columns in whole numbers finds them all. No separating axes,
no orientations: nothing shared with the library.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from math import lcm
from typing import Any

import numpy as np

SUBSETS = [s for size in range(2, 6) for s in combinations(range(6), size)]


def triangle_verdict(a: Any, b: Any) -> int:
    """0 separate, 1 touching or 2 overlap of corners (3, 3) and (3, 3), exactly.

    OVERLAP: the relative interiors meet (some common point has all six weights positive) and the
    edges span space, so that every small move leaves a common point.
    """
    p = [[Fraction(float(x)) for x in row] for row in np.asarray(a)]
    q = [[Fraction(float(x)) for x in row] for row in np.asarray(b)]
    scale = lcm(*(x.denominator for v in (*p, *q) for x in v))  # changes no weight
    columns = [[*(int(x * scale) for x in v), 1, 0] for v in p]
    columns += [[*(int(-x * scale) for x in v), 0, 1] for v in q]
    used: set[int] = set()
    for subset in SUBSETS:
        weights = _solve([columns[k] for k in subset])
        if weights is not None and min(weights) >= 0:
            used |= {k for k, w in zip(subset, weights, strict=True) if w > 0}
    if not used:
        return 0
    edges = [[x - y for x, y in zip(t[i], t[0], strict=True)] for t in (p, q) for i in (1, 2)]
    return 2 if len(used) == 6 and _rank(edges) == 3 else 1


def _solve(columns: list[list[int]]) -> list[int] | None:
    """Weights with sum of w_k column_k = (0, 0, 0, 1, 1); None if there are none or many.

    They are all multiplied by the same positive number: elimination without fractions (Bareiss
    1968), in which every division leaves no remainder.
    """
    target = [0, 0, 0, 1, 1]
    rows = [[c[i] for c in columns] + [target[i]] for i in range(5)]
    count, last = len(columns), 1
    for k in range(count):
        pivot = next((r for r in range(k, 5) if rows[r][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        lead, row = rows[k][k], rows[k]
        for r in range(5):
            if r != k:
                factor = rows[r][k]
                rows[r] = [
                    (lead * x - factor * y) // last for x, y in zip(rows[r], row, strict=True)
                ]
        last = lead
    if any(rows[r][count] != 0 for r in range(count, 5)):
        return None
    return [rows[k][count] if last > 0 else -rows[k][count] for k in range(count)]


def _rank(vectors: list[list[Fraction]]) -> int:
    rows, rank = [list(v) for v in vectors], 0
    for k in range(3):
        pivot = next((r for r in range(rank, len(rows)) if rows[r][k] != 0), None)
        if pivot is None:
            continue
        rows[rank], rows[pivot] = rows[pivot], rows[rank]
        for r in range(rank + 1, len(rows)):
            factor = rows[r][k] / rows[rank][k]
            rows[r] = [x - factor * y for x, y in zip(rows[r], rows[rank], strict=True)]
        rank += 1
    return rank

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

"""Independent exact distance of two triangles: the nearest point of every pair of features.

The points nearest to each other are inside of some corner, edge or face of either triangle, and
then also the nearest ones of the line or plane through it. For each of the 49 pairs these are found
by normal equations in fractions; pairs without a unique answer are parallel, and their nearest
points also lie on smaller features.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations

Vector = list[Fraction]
FEATURES = [s for size in (1, 2, 3) for s in combinations(range(3), size)]


def squared_distance(p: list[Vector], q: list[Vector]) -> Fraction:
    """Return the squared distance of two triangles of three corners each."""
    best = None
    for first in FEATURES:
        for second in FEATURES:
            square = _square([p[k] for k in first], [q[k] for k in second])
            if square is not None and (best is None or square < best):
                best = square
    assert best is not None
    return best


def _square(p: list[Vector], q: list[Vector]) -> Fraction | None:
    """Return the squared distance of the nearest points, None unless they lie inside of both."""
    ways = [_minus(v, p[0]) for v in p[1:]] + [_minus(q[0], v) for v in q[1:]]
    start = _minus(q[0], p[0])
    weights = _solved([[*(_dot(u, v) for v in ways), _dot(u, start)] for u in ways])
    if weights is None or any(w < 0 for w in weights):
        return None
    if sum(weights[: len(p) - 1]) > 1 or sum(weights[len(p) - 1 :]) > 1:
        return None
    rest = start
    for weight, way in zip(weights, ways, strict=True):
        rest = [x - weight * y for x, y in zip(rest, way, strict=True)]
    return _dot(rest, rest)


def _solved(rows: list[Vector]) -> Vector | None:
    """Return the solution of equations (n, n + 1), None if it is not unique."""
    count = len(rows)
    for k in range(count):
        pivot = next((r for r in range(k, count) if rows[r][k] != 0), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for r in range(count):
            if r != k and rows[r][k] != 0:
                factor = rows[r][k] / rows[k][k]
                rows[r] = [x - factor * y for x, y in zip(rows[r], rows[k], strict=True)]
    return [rows[k][count] / rows[k][k] for k in range(count)]


def _minus(u: Vector, v: Vector) -> Vector:
    return [x - y for x, y in zip(u, v, strict=True)]


def _dot(u: Vector, v: Vector) -> Fraction:
    return sum((x * y for x, y in zip(u, v, strict=True)), Fraction(0))

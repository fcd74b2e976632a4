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
then also the nearest ones of the line or plane through it. For each pair of features these are
found by normal equations (Cramer); pairs without a unique answer are parallel, and their nearest
points also lie on smaller features. All is done in integers, which take a tenth of the time of
fractions.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import combinations

Vector = list[Fraction]
Integers = tuple[int, int, int]
FEATURES = [s for size in (1, 2, 3) for s in combinations(range(3), size)]


def squared_distance(p: list[Vector], q: list[Vector]) -> Fraction:
    """Return the squared distance of two triangles of three corners each."""
    return _least(p, q, FEATURES)


def squared_distance_of_point(point: Vector, triangle: list[Vector]) -> Fraction:
    """Return the squared distance of a point from a triangle."""
    return _least([point], triangle, [(0,)])


def _least(p: list[Vector], q: list[Vector], features: list[tuple[int, ...]]) -> Fraction:
    """Return the least squared distance of features of p and those of q."""
    unit = math.lcm(*(x.denominator for v in (*p, *q) for x in v))
    first, second = whole(p, unit), whole(q, unit)
    found = (
        _square([first[k] for k in mine], [second[k] for k in theirs])
        for mine in features
        for theirs in FEATURES
        if len(mine) + len(theirs) < 6  # two planes have no unique points
    )
    return min(Fraction(top, low**2) for top, low in found if low) / unit**2


def whole(corners: Iterable[Sequence[Fraction]], unit: int) -> list[Integers]:
    """Return corners times a unit, which makes them whole."""
    return [tuple(x.numerator * (unit // x.denominator) for x in v) for v in corners]  # type: ignore[misc]


def _square(p: list[Integers], q: list[Integers]) -> tuple[int, int]:
    """Return n and d, n / d^2 the squared distance of the nearest points; 0, 0 if not within."""
    ways = [minus(v, p[0]) for v in p[1:]] + [minus(q[0], v) for v in q[1:]]
    start = minus(q[0], p[0])
    tops, low = nearest_weights(ways, start)
    of_p, of_q = tops[: len(p) - 1], tops[len(p) - 1 :]
    if low == 0 or min(tops, default=0) < 0 or sum(of_p) > low or sum(of_q) > low:
        return 0, 0
    rest = [
        low * x - sum(top * way[k] for top, way in zip(tops, ways, strict=True))
        for k, x in enumerate(start)
    ]
    return sum(x * x for x in rest), low


def nearest_weights(ways: list[Integers], start: Integers) -> tuple[list[int], int]:
    """Return the weights of ways, up to three, that come nearest to start, times the second."""
    if not ways:
        return [], 1
    if len(ways) == 1:
        return [dot(ways[0], start)], dot(ways[0], ways[0])
    if len(ways) == 2:
        u, v = ways
        a, b, c, x, y = dot(u, u), dot(u, v), dot(v, v), dot(u, start), dot(v, start)
        return [x * c - y * b, y * a - x * b], a * c - b * b
    u, v, w = ways
    low = _det(u, v, w)
    tops = [_det(start, v, w), _det(u, start, w), _det(u, v, start)]
    return (tops, low) if low >= 0 else ([-x for x in tops], -low)


def minus(u: Integers, v: Integers) -> Integers:
    return u[0] - v[0], u[1] - v[1], u[2] - v[2]


def dot(u: Integers, v: Integers) -> int:
    return u[0] * v[0] + u[1] * v[1] + u[2] * v[2]


def _det(u: Integers, v: Integers, w: Integers) -> int:
    x, y, z = w
    return (
        x * (u[1] * v[2] - u[2] * v[1])
        + y * (u[2] * v[0] - u[0] * v[2])
        + z * (u[0] * v[1] - u[1] * v[0])
    )

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

"""How far two sets of points are apart, hulls taken, by fractions alone: nothing of the library.

A point x of the difference of both hulls is the nearest to the origin exactly if no point w of it
has w.x < x.x, which need only be tried for the farthest points of both along x. The answer is
returned only with that proof, so it does not matter how x was found: by adding such a w to at most
four points, and trying all parts of what they span.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations

from triangle_distances import Integers, dot, minus, nearest_weights, whole

from obb_collision.typing import Floats

Vector = tuple[Fraction, Fraction, Fraction]
#: A numerator and a denominator, positive.
Point = tuple[Integers, int]


def placed(points: Floats, center: Floats, rotation: Floats) -> list[Vector]:
    """Return center + rotation p exactly, for points p (n, 3)."""
    rows = [[Fraction(x) for x in row] for row in rotation.tolist()]
    offset = [Fraction(x) for x in center.tolist()]
    result = []
    for point in points.tolist():
        p = [Fraction(x) for x in point]
        x, y, z = (
            c + sum(r * t for r, t in zip(row, p, strict=True))
            for c, row in zip(offset, rows, strict=True)
        )
        result.append((x, y, z))
    return result


def squared_distance(a: Sequence[Vector], b: Sequence[Vector]) -> Fraction:
    """Return the exact squared distance of the hulls of two sets of points; 0 if they collide."""
    unit = math.lcm(*(x.denominator for v in (*a, *b) for x in v))
    first, second = whole(a, unit), whole(b, unit)
    corners = [minus(first[0], second[0])]
    while True:
        (x, low), corners = _nearest(corners)
        w = minus(min(first, key=lambda p: dot(p, x)), max(second, key=lambda q: dot(q, x)))
        if dot(w, x) * low >= dot(x, x):
            return Fraction(dot(x, x), (low * unit) ** 2)
        corners.append(w)


def at_most(value: float, square: Fraction, radius: float = 0.0) -> bool:
    """Return whether a value is at most the root of a square, less a radius; exactly."""
    total = Fraction(value) + Fraction(radius)
    return total <= 0 or total * total <= square


def _nearest(corners: list[Integers]) -> tuple[Point, list[Integers]]:
    """Return the point of the hull of up to four corners nearest to the origin, and its part."""
    return min(_candidates(corners), key=lambda found: _square(found[0]))


def _square(point: Point) -> Fraction:
    return Fraction(dot(point[0], point[0]), point[1] ** 2)


def _candidates(corners: list[Integers]) -> Iterator[tuple[Point, list[Integers]]]:
    for count in range(1, len(corners) + 1):
        for part in combinations(corners, count):
            point = _projection(part)
            if point is not None:
                yield point, list(part)


def _projection(part: Sequence[Integers]) -> Point | None:
    """Return the point nearest to the origin of what corners span; None if it is not among them.

    Also None where they depend on each other: another part has the point then.
    """
    a, edges = part[0], [minus(p, part[0]) for p in part[1:]]
    tops, low = nearest_weights(edges, minus((0, 0, 0), a))
    if low == 0 or min(tops, default=0) < 0 or sum(tops) > low:
        return None
    x, y, z = (
        low * c + sum(t * e[k] for t, e in zip(tops, edges, strict=True)) for k, c in enumerate(a)
    )
    return (x, y, z), low

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
four points, and trying all parts of what they span. Whole numbers take a tenth of the time of
fractions.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from fractions import Fraction
from itertools import combinations
from typing import Any

from exact_vectors import Point, Vector, determinant, dot, exact, minus, moved

#: A point of whole numbers, and what they are divided by.
Divided = tuple[Point, int]


def placed(points: Any, center: Any, rotation: Any) -> list[Point]:
    """Return center + rotation p exactly, for points p (n, 3) of doubles."""
    return moved(map(exact, points), center, rotation)


def squared_distance(a: Sequence[Vector], b: Sequence[Vector]) -> Fraction:
    """Return the exact squared distance of the hulls of two sets of points; 0 if they collide."""
    first, second, unit = whole_numbers(a, b)
    corners = [minus(first[0], second[0])]
    while True:
        (x, low), corners = min(_candidates(corners), key=_square)
        w = minus(min(first, key=lambda p: dot(p, x)), max(second, key=lambda q: dot(q, x)))
        if dot(w, x) * low >= dot(x, x):
            return Fraction(dot(x, x), (low * unit) ** 2)
        corners.append(w)


def whole_numbers(a: Sequence[Vector], b: Sequence[Vector]) -> tuple[list[Point], list[Point], int]:
    """Return two sets of points times a unit that makes them whole, and the unit."""
    unit = math.lcm(*(x.denominator for v in (*a, *b) for x in v))
    first, second = ([_times(v, unit) for v in side] for side in (a, b))
    return first, second, unit


def _times(v: Vector, unit: int) -> Point:
    x, y, z = (x.numerator * (unit // x.denominator) for x in v)
    return x, y, z


def _square(found: tuple[Divided, list[Point]]) -> Fraction:
    (x, low), _ = found
    return Fraction(dot(x, x), low * low)


def _candidates(corners: list[Point]) -> Iterator[tuple[Divided, list[Point]]]:
    """Yield the points nearest to the origin of what each part of the corners spans.

    Not those that are not among the part's corners, nor of corners that depend on each other:
    another part has these points then.
    """
    for count in range(1, len(corners) + 1):
        for part in combinations(corners, count):
            edges = [minus(p, part[0]) for p in part[1:]]
            tops, low = _nearest_weights(edges, minus((0, 0, 0), part[0]))
            if low > 0 and min(tops, default=0) >= 0 and sum(tops) <= low:
                x, y, z = (
                    low * c + sum(t * e[k] for t, e in zip(tops, edges, strict=True))
                    for k, c in enumerate(part[0])
                )
                yield ((x, y, z), low), list(part)


def _nearest_weights(ways: list[Point], start: Point) -> tuple[list[int], int]:
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
    low = determinant(u, v, w)
    tops = [determinant(start, v, w), determinant(u, start, w), determinant(u, v, start)]
    return (tops, low) if low >= 0 else ([-x for x in tops], -low)

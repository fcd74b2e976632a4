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

from obb_collision.typing import Floats

Vector = tuple[Fraction, Fraction, Fraction]


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
    corners = [_minus(a[0], b[0])]
    while True:
        x, corners = _nearest(corners)
        w = _minus(min(a, key=lambda p: _dot(p, x)), max(b, key=lambda q: _dot(q, x)))
        if _dot(w, x) >= _dot(x, x):
            return _dot(x, x)
        corners.append(w)


def at_most(value: float, square: Fraction, radius: float = 0.0) -> bool:
    """Return whether a value is at most the root of a square, less a radius; exactly."""
    total = Fraction(value) + Fraction(radius)
    return total <= 0 or total * total <= square


def _nearest(corners: list[Vector]) -> tuple[Vector, list[Vector]]:
    """Return the point of the hull of up to four corners nearest to the origin, and its part."""
    return min(_candidates(corners), key=lambda found: _dot(found[0], found[0]))


def _candidates(corners: list[Vector]) -> Iterator[tuple[Vector, list[Vector]]]:
    for count in range(1, len(corners) + 1):
        for part in combinations(corners, count):
            point = _projection(part)
            if point is not None:
                yield point, list(part)


def _projection(part: Sequence[Vector]) -> Vector | None:
    """Return the point nearest to the origin of what corners span; None if it is not among them.

    Also None where they depend on each other: another part has the point then.
    """
    a, edges = part[0], [_minus(p, part[0]) for p in part[1:]]
    if not edges:
        return a
    rows = [[_dot(e, f) for f in edges] + [-_dot(e, a)] for e in edges]
    weights = _solved(rows)
    if weights is None or min(weights) < 0 or sum(weights) > 1:
        return None
    x, y, z = (
        c + sum(t * e[k] for t, e in zip(weights, edges, strict=True)) for k, c in enumerate(a)
    )
    return x, y, z


def _solved(rows: list[list[Fraction]]) -> list[Fraction] | None:
    """Return the solution of a regular system of equations, else None."""
    n = len(rows)
    for k in range(n):
        pivot = next((i for i in range(k, n) if rows[i][k]), None)
        if pivot is None:
            return None
        rows[k], rows[pivot] = rows[pivot], rows[k]
        for i in range(n):
            if i != k and rows[i][k]:
                factor = rows[i][k] / rows[k][k]
                rows[i] = [x - factor * y for x, y in zip(rows[i], rows[k], strict=True)]
    return [rows[k][n] / rows[k][k] for k in range(n)]


def _minus(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _dot(a: Vector, b: Vector) -> Fraction:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def root(square: Fraction) -> float:
    """Return the square root, whatever the magnitude."""
    if square == 0:
        return 0.0
    shift = square.numerator.bit_length() - square.denominator.bit_length()
    shift -= shift % 2
    return math.ldexp(math.sqrt(square / Fraction(2) ** shift), shift // 2)

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

"""How far points, segments and boxes are apart, by fractions alone: nothing of the library.

Each body is a corner and some edges, {corner + sum t_i e_i, 0 <= t_i <= 1}, its doubles taken as
exact numbers. The squared distance of two is the least square of (corner - corner') + sum t_i e_i
over all edges. A convex quadratic has its least value where some t are 0 or 1 and the others, by a
regular system of equations, are free: all choices are tried.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from fractions import Fraction
from itertools import product

from exact_bodies import Box, fractions

from obb_collision.typing import Floats

Vector = list[Fraction]
Body = tuple[Vector, list[Vector]]


def segment(start: Floats, end: Floats) -> Body:
    """Return a segment; a point where both ends are the same."""
    p, q = fractions(start), fractions(end)
    edge = [y - x for x, y in zip(p, q, strict=True)]
    return p, [edge] if any(edge) else []


def box(stored: Box) -> Body:
    """Return a stored box as its lowest corner and its edges; those without length left out."""
    center, rotation, half = stored
    corner = fractions(center)
    edges = []
    for column, h in zip(rotation.T, fractions(half), strict=True):
        axis = fractions(column)
        corner = [c - h * x for c, x in zip(corner, axis, strict=True)]
        if h:
            edges.append([2 * h * x for x in axis])
    return corner, edges


def squared_distance(a: Body, b: Body) -> Fraction:
    """Return the exact squared distance of two bodies."""
    offset = [x - y for x, y in zip(a[0], b[0], strict=True)]
    edges = a[1] + [[-x for x in edge] for edge in b[1]]
    gram = [[_dot(e, f) for f in edges] for e in edges]
    slopes = [_dot(e, offset) for e in edges]
    best = _dot(offset, offset)
    for places in product((0, 1, None), repeat=len(edges)):
        t = _solve(gram, slopes, places)
        if t is None or not all(0 <= x <= 1 for x in t):
            continue
        point = [
            x + sum(s * e[k] for s, e in zip(t, edges, strict=True)) for k, x in enumerate(offset)
        ]
        best = min(best, _dot(point, point))
    return best


def root(square: Fraction) -> float:
    """Return the square root, whatever the magnitude."""
    if square == 0:
        return 0.0
    shift = square.numerator.bit_length() - square.denominator.bit_length()
    shift -= shift % 2
    return math.ldexp(math.sqrt(square / Fraction(2) ** shift), shift // 2)


def _dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), Fraction(0))


def _solve(
    gram: list[Vector], slopes: Vector, places: tuple[int | None, ...]
) -> list[Fraction] | None:
    """Return t with a zero slope along the free ones (place None); None for a singular system."""
    free = [i for i, place in enumerate(places) if place is None]
    fixed = [i for i, place in enumerate(places) if place == 1]
    rows = [
        [gram[i][j] for j in free] + [-slopes[i] - sum((gram[i][j] for j in fixed), Fraction(0))]
        for i in free
    ]
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
    solved = iter(rows[k][n] / rows[k][k] for k in range(n))
    return [next(solved) if place is None else Fraction(place) for place in places]

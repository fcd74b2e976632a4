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

"""Independent exact time at which a ray first hits a triangle, in fractions (Cramer)."""

from __future__ import annotations

from fractions import Fraction

Vector = list[Fraction]


def first_hit(origin: Vector, direction: Vector, triangle: list[Vector]) -> Fraction | None:
    """Return the least t >= 0 at which origin + t direction is in the triangle, None if never."""
    u, v = _minus(triangle[1], triangle[0]), _minus(triangle[2], triangle[0])
    w = _minus(origin, triangle[0])
    whole = _determinant(u, v, direction)
    if whole == 0:
        times = [_on_edge(origin, direction, triangle[k], triangle[(k + 1) % 3]) for k in range(3)]
        return min((t for t in times if t is not None), default=None)
    r = _determinant(w, v, direction) / whole
    s = _determinant(u, w, direction) / whole
    t = -_determinant(u, v, w) / whole
    return t if min(r, s, 1 - r - s, t) >= 0 else None


def _on_edge(origin: Vector, direction: Vector, start: Vector, end: Vector) -> Fraction | None:
    """Return when a ray first hits an edge, if it does so and is not parallel to it.

    Where it is parallel, or begins on the edge, other edges are hit as early.
    """
    edge, way = _minus(end, start), _minus(start, origin)
    across = _cross(direction, edge)
    square = sum(x * x for x in across)
    if square == 0:
        return None
    t = _dot(_cross(way, edge), across) / square
    s = _dot(_cross(way, direction), across) / square
    if t < 0 or not 0 <= s <= 1:
        return None
    rest = [w + s * e - t * d for w, e, d in zip(way, edge, direction, strict=True)]
    return t if not any(rest) else None


def _minus(u: Vector, v: Vector) -> Vector:
    return [x - y for x, y in zip(u, v, strict=True)]


def _dot(u: Vector, v: Vector) -> Fraction:
    return sum((x * y for x, y in zip(u, v, strict=True)), Fraction(0))


def _cross(u: Vector, v: Vector) -> Vector:
    return [u[(k + 1) % 3] * v[(k + 2) % 3] - u[(k + 2) % 3] * v[(k + 1) % 3] for k in range(3)]


def _determinant(u: Vector, v: Vector, w: Vector) -> Fraction:
    return _dot(u, _cross(v, w))

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

"""The volume that two boxes share, exactly: corners of all planes, in whole and rational numbers.

Nothing is clipped: every three of the twelve planes that meet in a point within both boxes give a
corner; the corners on each plane are ordered as a polygon, and polygons make tetrahedra with a
corner. Boxes are the parallelepipeds of the doubles as stored.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from math import gcd, lcm
from typing import Any

from obb_collision.typing import Floats

Point = tuple[Fraction, Fraction, Fraction]
Whole = tuple[int, int, int]
Vector = Point | Whole
#: Outward normal and offset: inside is n . x <= d.
Plane = tuple[int, int, int, int]
Box = tuple[Floats, Floats, Floats]


def overlap_volume(a: Box, b: Box) -> Fraction:
    """Return the volume common to two boxes (centre, rotation, half extents)."""
    if not (all(a[2].tolist()) and all(b[2].tolist())):
        return Fraction(0)
    numbers = [x for box in (a, b) for v in (_point(box[0].tolist()), *_edges(box)) for x in v]
    scale = lcm(*(x.denominator for x in numbers))  # all are whole in this unit
    planes = list(dict.fromkeys([*_planes(a, scale), *_planes(b, scale)]))
    corners: set[Point] = set()
    for three in combinations(planes, 3):
        met = _meet(*three)
        if met is not None and _is_within(planes, *met):
            corners.add(_point([Fraction(x, met[1]) for x in met[0]]))
    if not corners:
        return Fraction(0)
    apex = min(corners)
    volume = Fraction(0)
    for plane in planes:
        face = _ordered([p for p in corners if _gap(plane, p) == 0], plane)
        for k in range(1, len(face) - 1):
            edges = [_minus(p, apex) for p in (face[0], face[k], face[k + 1])]
            volume += abs(_dot(edges[0], _cross(edges[1], edges[2])))
    return volume / (6 * scale**3)


def _edges(box: Box) -> list[Point]:
    """Return the half edges of a box."""
    _, rotation, half_extents = box
    columns = rotation.T.tolist()
    return [
        _point([Fraction(x) * Fraction(h) for x in column])
        for column, h in zip(columns, half_extents.tolist(), strict=True)
    ]


def _planes(box: Box, scale: int) -> list[Plane]:
    """Return the six planes of a box, divided by what their numbers share: equal ones are equal."""
    center, *edges = (
        _whole([int(x * scale) for x in v]) for v in (_point(box[0].tolist()), *_edges(box))
    )
    planes = []
    for k in range(3):
        normal = _cross(edges[(k + 1) % 3], edges[(k + 2) % 3])
        reach = abs(_dot(normal, edges[k]))
        for side in (normal, _whole([-x for x in normal])):
            numbers = [*side, _dot(side, center) + reach]
            shared = gcd(*numbers)
            nx, ny, nz, offset = (number // shared for number in numbers)
            planes.append((nx, ny, nz, offset))
    return planes


def _meet(p: Plane, q: Plane, r: Plane) -> tuple[Whole, int] | None:
    """Return the point of three planes and what divides it; None without a single one (Cramer)."""
    qr, rp, pq = (_cross(_normal(u), _normal(v)) for u, v in ((q, r), (r, p), (p, q)))
    determinant = _dot(_normal(p), qr)
    if determinant == 0:
        return None
    sign = 1 if determinant > 0 else -1
    top = (p[3] * x + q[3] * y + r[3] * z for x, y, z in zip(qr, rp, pq, strict=True))
    return _whole([sign * x for x in top]), sign * determinant


def _is_within(planes: list[Plane], point: Whole, divisor: int) -> bool:
    """Return whether a point, divided by a positive number, is outside of no plane."""
    return all(_dot(_normal(plane), point) <= plane[3] * divisor for plane in planes)


def _ordered(points: list[Point], plane: Plane) -> list[Point]:
    """Return the points of a convex polygon in a plane in order (Andrew's monotone chain)."""
    drop = max(range(3), key=lambda k: abs(plane[k]))
    flat = sorted(points, key=lambda p: [x for k, x in enumerate(p) if k != drop])
    i, j = (k for k in range(3) if k != drop)
    halves = []
    for some in (flat, flat[::-1]):
        half: list[Point] = []
        for p in some:
            while len(half) > 1 and (half[-1][i] - half[-2][i]) * (p[j] - half[-2][j]) <= (
                half[-1][j] - half[-2][j]
            ) * (p[i] - half[-2][i]):
                half.pop()
            half.append(p)
        halves.append(half[:-1])
    return halves[0] + halves[1]


def _point(numbers: list[float] | list[Fraction]) -> Point:
    x, y, z = (Fraction(x) for x in numbers)
    return x, y, z


def _whole(numbers: list[int]) -> Whole:
    x, y, z = numbers
    return x, y, z


def _normal(plane: Plane) -> Whole:
    return plane[0], plane[1], plane[2]


def _gap(plane: Plane, point: Point) -> Fraction:
    return _dot(_normal(plane), point) - plane[3]


def _minus(p: Point, q: Point) -> Point:
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


def _dot(p: Vector, q: Vector) -> Any:
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


def _cross(p: Vector, q: Vector) -> Any:
    return (
        p[1] * q[2] - p[2] * q[1],
        p[2] * q[0] - p[0] * q[2],
        p[0] * q[1] - p[1] * q[0],
    )

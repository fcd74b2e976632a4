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
corner; the corners on two planes are ends of an edge, and edges make tetrahedra with a corner of
one of their planes and a corner of all. Boxes are the parallelepipeds of the doubles as stored.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations
from math import gcd

from exact_vectors import Box, Point, cross, determinant, dot, exact, minus
from hull_distances import whole_numbers

#: Outward normal and offset: inside is n . x <= d.
Plane = tuple[Point, int]


def overlap_volume(a: Box, b: Box) -> Fraction:
    """Return the volume common to two boxes."""
    if not (a[2].all() and b[2].all()):
        return Fraction(0)
    first, second, unit = whole_numbers(_center_and_edges(a), _center_and_edges(b))
    planes = list(dict.fromkeys([*_planes(*first), *_planes(*second)]))
    corners = _corners(planes)
    if not corners:
        return Fraction(0)
    apex = min(corners)
    volume = Fraction(0)
    for plane in planes:
        face = [p for p in corners if _on(plane, p)]
        lines = [[p for p in face if _on(other, p)] for other in planes if other != plane]
        for ends in {(min(line), max(line)) for line in lines if line}:
            volume += abs(determinant(*(minus(p, apex) for p in (*ends, face[0]))))
    return volume / (6 * unit**3)


def _center_and_edges(box: Box) -> list[Point]:
    """Return the centre and the half edges of a box."""
    center, rotation, half = box
    axes = zip(exact(half), map(exact, rotation.T), strict=True)
    return [exact(center), *((h * x, h * y, h * z) for h, (x, y, z) in axes)]


def _planes(center: Point, *edges: Point) -> list[Plane]:
    """Return the six planes of a box, divided by what their numbers share: equal ones are equal."""
    planes = []
    for k in range(3):
        normal = cross(edges[k - 2], edges[k - 1])
        reach = abs(dot(normal, edges[k]))
        for x, y, z in (normal, minus((0, 0, 0), normal)):
            offset = dot((x, y, z), center) + reach
            shared = gcd(x, y, z, offset)
            planes.append(((x // shared, y // shared, z // shared), offset // shared))
    return planes


def _corners(planes: list[Plane]) -> set[Point]:
    """Return the points of three planes each that are outside of none (Cramer)."""
    found = set()
    for (n, d), (m, e), (o, f) in combinations(planes, 3):
        sides = cross(m, o), cross(o, n), cross(n, m)
        low = dot(n, sides[0])
        sign = -1 if low < 0 else 1
        x, y, z = (sign * dot((d, e, f), column) for column in zip(*sides, strict=True))
        if low and all(dot(normal, (x, y, z)) <= offset * abs(low) for normal, offset in planes):
            found.add((Fraction(x, abs(low)), Fraction(y, abs(low)), Fraction(z, abs(low))))
    return found


def _on(plane: Plane, point: Point) -> bool:
    return bool(dot(plane[0], point) == plane[1])

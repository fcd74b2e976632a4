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

"""The slow, independent truth about boxes: integers and fractions, nothing of the library.

A stored double is an exact number, so a stored box is an exact parallelepiped
``{c + t_0 h_0 a_0 + t_1 h_1 a_1 + t_2 h_2 a_2, |t_i| <= 1}`` with ``a_i`` the columns of the
rotation as stored. The axes are orthonormal only to rounding, so its face normals are the cross
products ``a_j x a_k``, not the axes. Every question here is answered for that set exactly.

The separating axis test works by *intervals*: all eight corners of both boxes are projected on
each of the 15 candidate axes (3 + 3 face normals, 9 edge cross products; null ones skipped) and
the two intervals are compared. The library uses projected radii instead, so the two
share neither code nor formula. Boxes are closed:

* SEPARATE (0): the intervals are disjoint on some axis;
* TOUCHING (1): on no axis, but on some they share one point only;
* OVERLAP (2): on every axis they share more than that.

Verdicts of many pairs come from the same intervals in doubles where their rounding can't matter,
and from integers elsewhere.

The volume that two boxes share comes from corners of all planes, and nothing is clipped: every
three of the twelve planes that meet in a point within both boxes give a corner; the corners on two
planes are ends of an edge, and edges make tetrahedra with a corner of one of their planes and a
corner of all.

A box is any triple ``(center (3,), rotation (3, 3), half_extents (3,))`` of doubles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import combinations, product
from typing import Any

import numpy as np
from exact_vectors import Box, Point, Vector, cross, determinant, dot, exact, minus, whole
from exact_vectors import corners as corners
from hull_distances import whole_numbers

SEPARATE, TOUCHING, OVERLAP = 0, 1, 2

_SIGNS = list(product((-1, 1), repeat=3))


class ExactPair:
    """Two boxes in integers: lengths in units of ``2**exponent`` metres, origin at centre a."""

    def __init__(self, a: Box, b: Box) -> None:
        lengths, unit = whole(np.array([a[0], b[0], a[2], b[2]], float))
        # of about one at most, so that a shift brings centres to the unit of lengths times axes
        axes, fine = whole(np.array([np.transpose(a[1]), np.transpose(b[1])], float))
        places = np.array(_SIGNS, object) @ (lengths[2:, :, None] * axes)
        places[1] += (lengths[1] - lengths[0]) << -fine
        self.exponent, self.size = unit + fine, lengths[2:].sum() << -fine
        self.axes_a, self.axes_b = axes.tolist()
        self.corners_a, self.corners_b = places.tolist()

    def candidate_axes(self) -> Iterator[Vector]:
        """Yield the 15 exact candidate axes, not normalised; parallel edges give none."""
        for axes in (self.axes_a, self.axes_b):
            for i in range(3):
                yield cross(axes[(i + 1) % 3], axes[(i + 2) % 3])
        for u in self.axes_a:
            for v in self.axes_b:
                axis = cross(u, v)
                if axis != (0, 0, 0):
                    yield axis

    def gap(self, axis: Vector) -> int:
        """Signed gap of the two intervals along ``axis``, times its length."""
        low_a, high_a = _interval(axis, self.corners_a)
        low_b, high_b = _interval(axis, self.corners_b)
        return max(low_b - high_a, low_a - high_b)

    def verdict(self) -> int:
        """SEPARATE, TOUCHING or OVERLAP, exactly."""
        touching = False
        for axis in self.candidate_axes():
            gap = self.gap(axis)
            if gap > 0:
                return SEPARATE
            touching = touching or gap == 0
        return TOUCHING if touching else OVERLAP

    def separation(self) -> float:
        """Signed gap in metres, the largest over the 15 unit axes: minus the least penetration.

        Each quotient is rounded once from an exact quotient of squares: relative error < 1e-15.
        """
        root, exponent = self._largest_gap(1)
        return math.ldexp(root, exponent + self.exponent)

    def relative_separation(self) -> float:
        """`separation` as a fraction of the sum of all six half extents (infinite for points)."""
        if self.size == 0:
            return math.inf if self.verdict() == SEPARATE else 0.0
        return math.ldexp(*self._largest_gap(self.size))

    def _largest_gap(self, unit: int) -> tuple[float, int]:
        """Largest gap / (axis length * unit), as a mantissa and an exponent of two."""
        gaps = [(self.gap(axis), dot(axis, axis) * unit * unit) for axis in self.candidate_axes()]
        positive = [_root(gap, squared) for gap, squared in gaps if gap > 0]
        if positive:
            return max(positive, key=lambda r: (r[1], r[0]))
        if any(gap == 0 for gap, _ in gaps):
            return 0.0, 0
        return max((_root(gap, squared) for gap, squared in gaps), key=lambda r: (-r[1], r[0]))


def _root(gap: int, squared: int) -> tuple[float, int]:
    """``gap / sqrt(squared)`` as (mantissa of size 0.5 to 1, exponent): no under- or overflow."""
    numerator = gap * gap
    shift = numerator.bit_length() - squared.bit_length()
    quotient = numerator / (squared << shift) if shift >= 0 else (numerator << -shift) / squared
    if shift % 2:
        quotient, shift = quotient * 2.0, shift - 1
    mantissa, exponent = math.frexp(math.copysign(math.sqrt(quotient), 1 if gap > 0 else -1))
    return mantissa, exponent + shift // 2


def _interval(axis: Vector, corners: Sequence[Vector]) -> tuple[int, int]:
    along = [dot(axis, corner) for corner in corners]
    return min(along), max(along)


def verdict(a: Box, b: Box) -> int:
    """Exact verdict of two boxes."""
    return ExactPair(a, b).verdict()


def verdicts(a: Sequence[Any], b: Sequence[Any]) -> np.ndarray:
    """Exact verdicts row by row; ``a`` and ``b`` are (centers, rotations, half_extents)."""
    found = _certain_verdicts(a, b)
    rows = np.flatnonzero(found < 0)
    arrays = [np.asarray(array)[rows] for array in (*a, *b)]
    found[rows] = [ExactPair(r[:3], r[3:]).verdict() for r in zip(*arrays, strict=True)]
    return found


#: Rounding of gaps along axes, relative to all lengths of a pair: more than 64 roundoffs.
_ROUNDING = 1e-13


def _certain_verdicts(a: Sequence[Any], b: Sequence[Any]) -> np.ndarray:
    """Return the verdicts that doubles are certain of, -1 where they are not."""
    (p, r, h), (q, s, k) = ([np.asarray(x, np.float64) for x in side] for side in (a, b))
    with np.errstate(all="ignore"):
        size = np.abs(np.hstack([p, q, h, k])).sum(axis=1)
        plain = (size > 1e-100) & (size < 1e100)  # no under- or overflow
        edges = [side.transpose(0, 2, 1) for side in (r, s)]
        normals = [np.cross(np.roll(e, -1, axis=1), np.roll(e, -2, axis=1)) for e in edges]
        crossed = np.cross(edges[0][:, :, None], edges[1][:, None]).reshape(-1, 9, 3)
        axes = np.concatenate([*normals, crossed], axis=1)
        signs = np.array(_SIGNS, float)
        along_a = np.einsum("nki,nji->nkj", (signs * h[:, None]) @ edges[0], axes)
        along_b = np.einsum(
            "nki,nji->nkj", (signs * k[:, None]) @ edges[1] + (q - p)[:, None], axes
        )
        gaps = np.maximum(
            along_b.min(axis=1) - along_a.max(axis=1), along_a.min(axis=1) - along_b.max(axis=1)
        )
        doubt = _ROUNDING * size[:, None]
        found = np.full(len(p), -1, np.int8)
        found[plain & (gaps < -doubt).all(axis=1)] = OVERLAP
        found[plain & (gaps > doubt).any(axis=1)] = SEPARATE
    return found


def relative_separations(a: Sequence[Any], b: Sequence[Any]) -> np.ndarray:
    """`ExactPair.relative_separation` row by row."""
    rows = zip(*a, *b, strict=True)
    return np.array([ExactPair(r[:3], r[3:]).relative_separation() for r in rows])


def separations(a: Sequence[Any], b: Sequence[Any]) -> np.ndarray:
    """`ExactPair.separation` row by row, metres."""
    return np.array([ExactPair(r[:3], r[3:]).separation() for r in zip(*a, *b, strict=True)])


def gap_along(a: Box, b: Box, axis: Iterable[float]) -> Fraction:
    """Exact ``min(b . axis) - max(a . axis)`` for a double vector, times the vector's length.

    Positive: the plane normal to ``axis`` has all of a on one side and all of b on the other,
    and the axis points from a to b.
    """
    n = exact(axis)
    first, second = ([dot(n, p) for p in corners(box)] for box in (a, b))
    return Fraction(min(second) - max(first))


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
            shared = math.gcd(x, y, z, offset)
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

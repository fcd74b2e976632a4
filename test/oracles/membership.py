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

"""Whether a point lies in a stored box, by fractions alone: nothing of the library.

A box is {c + sum t_i h_i a_i, abs(t_i) <= 1} for its doubles as stored, a_i the columns of the
rotation. The coordinates y = R^-1 (p - c) come from Cramer's rule; abs(y_i) <= h_i decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np

from obb_collision.typing import Floats, Mask

Box = tuple[Floats, Floats, Floats]
Point = Sequence[Fraction]


def fractions(values: Iterable[float]) -> list[Fraction]:
    """Doubles as fractions."""
    return [Fraction(float(value)) for value in values]


def determinant(a: Point, b: Point, c: Point) -> Fraction:
    """Return the determinant of the matrix with columns a, b, c."""
    return (
        a[0] * (b[1] * c[2] - b[2] * c[1])
        - a[1] * (b[0] * c[2] - b[2] * c[0])
        + a[2] * (b[0] * c[1] - b[1] * c[0])
    )


def outside(box: Box, points: Iterable[Point]) -> list[Fraction]:
    """How far each point is outside along the worst axis (metres, <= 0 inside), exactly."""
    center, rotation, half = box
    c, h = fractions(center), fractions(half)
    a, b, d = (fractions(column) for column in rotation.T)
    volume = determinant(a, b, d)
    found = []
    for point in points:
        v = [x - y for x, y in zip(point, c, strict=True)]
        y = (determinant(v, b, d), determinant(a, v, d), determinant(a, b, v))
        found.append(max(abs(y_i / volume) - h_i for y_i, h_i in zip(y, h, strict=True)))
    return found


def whole(values: Floats) -> tuple[Any, int]:
    """Return doubles as integers of any size (an array), and the exponent of two of their unit."""
    mantissas, exponents = np.frexp(values)
    exponents = np.where(mantissas == 0.0, 0, exponents - 53)
    least = int(exponents.min(initial=0))
    integers = (mantissas * 2.0**53).astype(np.int64).astype(object)
    return integers << (exponents - least).astype(object), least


def inside(box: Box, points: Floats) -> Mask:
    """Which of points (n, 3) the box contains, exactly: as ``outside``, in integers."""
    lengths, _ = whole(np.vstack([box[0], box[2], points]))
    axes, exponent = whole(box[1])
    normals = np.cross(axes.T[[1, 2, 0]], axes.T[[2, 0, 1]])
    reach = abs(lengths[1] * (axes[:, 0] @ normals[0]))
    along = abs((lengths[2:] - lengths[0]) @ normals.T)
    return np.asarray((along << -exponent <= reach).all(axis=1), np.bool_)


def holds(box: Box, points: Floats) -> bool:
    """Whether the box contains all points (n, 3), exactly."""
    return bool(inside(box, points).all())


def corners(box: Box) -> list[list[Fraction]]:
    """Return the eight corners, exactly."""
    center, rotation, half = box
    c, h = fractions(center), fractions(half)
    axes = [fractions(column) for column in rotation.T]
    return [
        [c[k] + sum(s * h[i] * axes[i][k] for i, s in enumerate(signs)) for k in range(3)]
        for signs in product((-1, 1), repeat=3)
    ]


def moved(points: Iterable[Point], matrix: Floats) -> list[list[Fraction]]:
    """Return the points under a matrix (4, 4), exactly."""
    rows = [fractions(row) for row in matrix.tolist()]
    return [[sum(row[i] * p[i] for i in range(3)) + row[3] for row in rows[:3]] for p in points]


def assert_proper(box: Box) -> None:
    """Right-handed, orthonormal to 16 unit roundoffs, half extents finite and not negative."""
    center, rotation, half = box
    assert center.shape == half.shape == (3,)
    assert rotation.shape == (3, 3)
    assert np.isfinite(center).all()
    assert all(value >= 0.0 for value in half.tolist())
    assert np.isfinite(half).all()
    axes, exponent = whole(rotation)
    unit = 1 << -2 * exponent
    assert (abs(axes.T @ axes - unit * np.eye(3, dtype=object)) << 49 <= unit).all()
    assert axes[:, 0] @ np.cross(axes[:, 1], axes[:, 2]) > 0

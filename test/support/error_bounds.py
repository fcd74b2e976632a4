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

"""Observed errors over their bounds, in exact arithmetic.

Two ways to see an error. Where a kernel returns a number, that number is compared with the exact
one. Where it only decides, a body is moved to where the decision changes, to neighbouring doubles:
there the number that the kernel has computed is its bound, and the exact quantity differs from the
bound by the error. Both give a ratio of observed error to bound. Above 1 a decision could be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction

import numpy as np
from exact_vectors import Box, Vector, cross, dot, exact, norm, taxicab
from oracle import ExactPair
from support import family, loosened, row_of, stored

from obb_collision import Boxes
from obb_collision.typing import Floats, Mask
from tools.cases.families import FAMILIES

Rows = Sequence[Vector]
#: Bits that are kept of fractions.
BITS = 200


def check_ratios(ratios: Iterable[Fraction]) -> None:
    """Assert that no observed error exceeds its bound, and that there were errors to observe."""
    largest = float(max(ratios))
    print(f"largest observed error over bound: {largest:.2g}")  # noqa: T201  # pytest -rP
    assert 0.0 < largest <= 1.0


def flips(
    decide: Callable[[Floats], Mask], most: Floats, least: Floats | None = None
) -> tuple[Floats, Floats]:
    """Return neighbouring doubles (n,) between which each row's decision becomes True."""
    low, high = (np.zeros_like(most) if least is None else least), most.copy()
    assert decide(high).all()
    assert not decide(low).any()
    for _ in range(80):
        middle = low + 0.5 * (high - low)
        yes = decide(middle)
        low, high = np.where(yes, low, middle), np.where(yes, middle, high)
    return low, high


def observed_at_flip(unsure: Fraction, certain: Fraction) -> Fraction:
    """Return the error seen where a decision becomes certain, over its bound.

    Both are the exact quantity in units of the bound: at the last place that left the decision
    open, and at the first that did not. Without errors they would lie on either side of 1.
    """
    return max(1 - certain, unsure - 1, Fraction(0))


def check_flips(
    decide: Callable[[Floats], Mask],
    quantity: Callable[[int, float], Fraction],
    most: Floats,
    least: Floats | None = None,
) -> None:
    """Check where the decision of each row becomes True; quantity: exactly, over the bound."""
    low, high = (end.tolist() for end in flips(decide, most, least))
    pairs = enumerate(zip(low, high, strict=True))
    ratios = [observed_at_flip(quantity(n, x), quantity(n, y)) for n, (x, y) in pairs]
    check_ratios(ratios)


def normals(columns: Rows) -> Rows:
    """Return the vector products (3) of columns (3): of the second and the third one first."""
    return [cross(columns[k - 2], columns[k - 1]) for k in range(3)]


def solved(columns: Rows, v: Vector) -> list[Fraction]:
    """Return the coordinates of a vector along columns (3), exactly (Cramer)."""
    return [dot(n, v) / dot(n, column) for n, column in zip(normals(columns), columns, strict=True)]


def extents(*boxes: Box) -> Fraction:
    """Return the sum of all half extents."""
    return sum((taxicab(exact(box[2])) for box in boxes), Fraction(0))


def exact_gaps(a: Box, b: Box) -> list[Fraction]:
    """Return the gaps along the unit axes in metres, parallel edges left out: 15 without any."""
    pair = ExactPair(a, b)
    unit = Fraction(2) ** pair.exponent
    return [pair.gap(axis) * unit / norm(axis) for axis in pair.candidate_axes()]


def edge_lengths(a: Box, b: Box) -> list[float]:
    """Return the lengths of the nine cross products of edges, rounded."""
    lengths = np.linalg.norm(np.cross(a[1].T[:, None], b[1].T[None]), axis=2).ravel()
    return [float(length) for length in lengths]


def rounded(value: Fraction) -> Fraction:
    """Return a fraction of few bits: they grow without end otherwise."""
    return Fraction(round(value * 2**BITS), 2**BITS)


def sine_and_cosine(angle: Fraction) -> tuple[Fraction, Fraction]:
    """Return both by their series, halved until that is short."""
    halvings = 12
    x, term = angle / 2**halvings, Fraction(1)
    sums = [Fraction(0), Fraction(0)]
    for n in range(24):
        sums[n % 2] += (-1) ** (n // 2) * term
        term = rounded(term * x / (n + 1))
    cosine, sine = sums
    for _ in range(halvings):
        sine, cosine = rounded(2 * sine * cosine), rounded(cosine * cosine - sine * sine)
    return sine, cosine


def turn(axis: Vector, angle: Fraction) -> Rows:
    """Return the rows of the rotation by an angle about an axis, by the formula of Rodrigues."""
    length = norm(axis)
    x, y, z = (each / length for each in axis)
    s, c = sine_and_cosine(angle)
    nil = Fraction(0)
    cross = [[nil, -z, y], [z, nil, -x], [-y, x, nil]]
    along = [[a * b for b in (x, y, z)] for a in (x, y, z)]
    return [
        [rounded((1 - c) * along[i][j] + s * cross[i][j] + (c if i == j else 0)) for j in range(3)]
        for i in range(3)
    ]


class Moved:
    """Pairs of boxes of all families, the second at a distance from the first along a direction.

    Every other pair is at the origin, where the offset of the centres is not rounded. loose: axes
    as far from orthonormal as bounds allow for, 64 roundoffs; else to 16.
    """

    def __init__(
        self, count: int, families: Iterable[str] = tuple(FAMILIES), loose: bool = False
    ) -> None:
        sides = [family(name, count) for name in families]
        self.a, self.b = (join([pair[side] for pair in sides]) for side in (0, 1))
        self.a.arrays.centers[::2] = 0.0
        if loose:
            for side in (self.a, self.b):
                side.arrays.rotations[:] = loosened(side.arrays.rotations, np.random.default_rng(2))
        directions = np.random.default_rng(1).normal(size=(len(self.a), 3))
        self.directions = directions / np.linalg.norm(directions, axis=1)[:, None]
        #: As far as no two boxes reach.
        self.farthest = 4.0 * (self.a.half_extents + self.b.half_extents).sum(axis=1)
        self.farthest += 100.0 * np.spacing(np.abs(self.a.centers).max(axis=1)) + 1e-300

    def points(self, distances: Floats) -> Floats:
        """Return the points at distances (n,) from the centres of the first boxes."""
        return np.asarray(self.a.centers + distances[:, None] * self.directions)

    def at(self, distances: Floats) -> tuple[Boxes, Boxes]:
        """Return the boxes of all pairs at distances (n,)."""
        centers = self.points(distances)
        return self.a, Boxes.trusted(centers, self.b.rotations, self.b.half_extents)

    def check(
        self,
        decide: Callable[[Boxes, Boxes], Mask],
        quantity: Callable[[Box, Box], Fraction],
    ) -> None:
        """Check where a decision becomes True; quantity: exactly, in units of the bound."""

        def of_row(n: int, distance: float) -> Fraction:
            a, b = self.at(np.full(len(self.a), distance))
            return quantity(row_of(a, n), row_of(b, n))

        check_flips(lambda d: decide(*self.at(d)), of_row, self.farthest)


def join(boxes: list[Boxes]) -> Boxes:
    """Return boxes one after the other, as copies."""
    return Boxes.trusted(*(np.concatenate(part) for part in zip(*map(stored, boxes), strict=True)))

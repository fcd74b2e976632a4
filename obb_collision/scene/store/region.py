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

"""Region: the part of a space that one of several scenes answers for, so that they share it.

Every pair belongs to exactly one region: that of its canonical point, the largest of the lower
corners of both bounds, coordinate by coordinate. Where bounds overlap it lies in both of them, so
the region that owns the pair is one that both objects reach into, however large they are. It is a
choice among numbers that are there, without arithmetic, so all scenes with the same boxes agree on
it bit for bit; and regions are half-open, so a point on a border is in one of them only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.geometry.validation import as_any_array, as_array, as_shaped, as_whole
from obb_collision.geometry.values import ArrayValue
from obb_collision.numerics.constants import UNDERFLOW
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import shown

#: Relative growth of what an object reaches: more than the slack of all bounds of boxes and
#: spheres in use, 2^-38 at the most.
REACH_SLACK = 2.0**-35
#: Regions of one split at most: far more than there are machines.
MOST_PARTS = 4096


@dataclass(frozen=True, eq=False)
class Region(ArrayValue):
    """The half-open box from a minimum up to, not including, a maximum, which may be infinite.

    Parameters
    ----------
    minimum, maximum : (3,) array_like
        Metres; -inf and inf: without an end.
    halo : float
        Metres around it in which objects take part, at least as far as effects look from objects.

    Raises
    ------
    ValueError
        For NaN, a minimum that is not below the maximum, and a halo that is negative or infinite.

    Examples
    --------
    >>> west = oc.regions.Region([-np.inf, -np.inf, -np.inf], [5, np.inf, np.inf], halo=1.0)
    >>> west.holds([[4.9, 0, 0], [5, 0, 0]]).tolist()
    [True, False]
    """

    minimum: Floats
    maximum: Floats
    halo: float

    def __init__(self, minimum: ArrayLike, maximum: ArrayLike, halo: float = 0.0) -> None:
        low, high = (
            as_shaped(value, name, (3,)).copy()
            for value, name in ((minimum, "minimum"), (maximum, "maximum"))
        )
        if not (low < high).all():
            raise ValueError("minimum must be below maximum on every axis")
        if (low == np.inf).any() or (high == -np.inf).any():
            raise ValueError("minimum must be below inf and maximum above -inf")
        width = float(as_array(halo, "halo", ()))
        if width < 0.0:
            raise ValueError("halo must not be negative")
        for corner in (low, high):
            corner.flags.writeable = False
        vars(self).update(minimum=low, maximum=high, halo=width)

    @property
    def is_everything(self) -> bool:
        """Whether it has no end."""
        return bool(np.isneginf(self.minimum).all() and np.isposinf(self.maximum).all())

    def holds(self, points: ArrayLike) -> Mask:
        """Return which points are in it.

        Parameters
        ----------
        points : (n, 3) array_like

        Returns
        -------
        (n,) array of bool

        Examples
        --------
        >>> oc.regions.Region([0, 0, 0], [1, 1, 1]).holds([[0, 0, 0], [0, 0, 1]]).tolist()
        [True, False]
        """
        return owns(self, as_array(points, "points", (None, 3)))


def split_regions(
    minimum: ArrayLike, maximum: ArrayLike, parts: Sequence[int], halo: float = 0.0
) -> list[Region]:
    """Cut a box into equal regions, of which the outermost ones are without end outwards.

    Together they hold every point of space exactly once.

    Parameters
    ----------
    minimum, maximum : (3,) array_like
        Corners of the box (m); along an axis with one part they do not matter.
    parts : sequence of int
        Parts along x, y and z.
    halo : float
        Metres.

    Returns
    -------
    list of Region
        Along z first, then along y, then along x.

    Raises
    ------
    ValueError
        Naming the argument; also if parts are so thin that two cuts are one number.

    Examples
    --------
    >>> [r.maximum[0].item() for r in oc.regions.split_regions([0, 0, 0], [9, 1, 1], [3, 1, 1])]
    [3.0, 6.0, inf]
    """
    low, high = as_array(minimum, "minimum", (3,)), as_array(maximum, "maximum", (3,))
    counts = as_any_array(parts, "parts", "three whole numbers").tolist()
    if not isinstance(counts, list) or len(counts) != 3:
        raise ValueError(f"parts must be three whole numbers, got {shown(parts)}")
    counts = [as_whole(count, "parts", 1, MOST_PARTS) for count in counts]
    if np.prod(counts, dtype=float) > MOST_PARTS:
        raise ValueError(f"parts must make at most {MOST_PARTS} regions, got {shown(parts)}")
    edges = []
    for start, stop, count in zip(low.tolist(), high.tolist(), counts, strict=True):
        if count > 1 and not start < stop:
            raise ValueError("minimum must be below maximum along an axis with several parts")
        inner = np.linspace(start, stop, count + 1)[1:-1].tolist()
        edges.append([-np.inf, *inner, np.inf])
    cells = product(*(range(count) for count in counts))
    return [
        Region(
            [axis[k] for axis, k in zip(edges, cell, strict=True)],
            [axis[k + 1] for axis, k in zip(edges, cell, strict=True)],
            halo,
        )
        for cell in cells
    ]


def coverage(regions: Sequence[Region]) -> tuple[bool, list[int]]:
    """Return whether some points of space are in no region, and which regions overlap others.

    Exact: bounds are compared, and volumes are counted in whole cells between them. Where regions
    overlap, a gap in between may be found only once they do not.
    """
    low, high = (
        np.array([getattr(region, end) for region in regions]) for end in ("minimum", "maximum")
    )
    overlaps = [
        row
        for row in range(len(regions))
        if np.count_nonzero(((low < high[row]) & (low[row] < high)).all(axis=1)) > 1
    ]
    whole, volumes, is_open = 1, np.ones(len(regions), np.int64), False
    for axis in range(3):
        cuts = np.unique([low[:, axis], high[:, axis]])
        is_open |= bool(cuts[0] > -np.inf or cuts[-1] < np.inf)
        whole *= len(cuts) - 1
        volumes *= np.searchsorted(cuts, high[:, axis]) - np.searchsorted(cuts, low[:, axis])
    return is_open or sum(volumes.tolist()) < whole, overlaps


def owns(region: Region, points: Floats) -> Mask:
    """Return which canonical points (n, 3), possibly infinite, are in it; nothing checked."""
    above = (points >= region.minimum).all(axis=1)
    return np.asarray(above & ((points < region.maximum) | (region.maximum == np.inf)).all(axis=1))


def owns_pairs(region: Region, minimum: Floats, pairs: Rows) -> Mask:
    """Return which pairs (m, 2) of rows of bounds, of which ``minimum`` (n, 3), are its own."""
    return owns(region, np.maximum(minimum[pairs[:, 0]], minimum[pairs[:, 1]]))


def balls_near(region: Region, centers: Floats, radii: Floats) -> Mask:
    """Return which balls about (n, 3), radii (n,), may come within the halo of it.

    With the radii of the spheres around boxes: never False where any bounds in use reach there.
    """
    reach = region.halo + radii
    reach += REACH_SLACK * (reach + np.abs(centers).sum(axis=1)) + UNDERFLOW
    low, high = centers + reach[:, None], centers - reach[:, None]
    return np.asarray(((low >= region.minimum) & (high <= region.maximum)).all(axis=1))

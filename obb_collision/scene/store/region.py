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

"""Regions: parts of space, one for each of several scenes, and the merger of their reports.

Every pair belongs to exactly one region: that of its canonical point, the larger coordinates of the
lower corners of both bounds. Where bounds overlap the point lies in both, so both objects reach
into the region that owns the pair, however large they are. The point is a choice among existing
numbers, so all scenes with the same boxes agree on it bit for bit. Regions are half-open, so a
point on a border is in one of them only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from obb_collision.geometry.validation import (
    as_any_array,
    as_array,
    as_shaped,
    as_whole,
    check_kind,
)
from obb_collision.geometry.values import ArrayValue, SetOnce
from obb_collision.numerics.constants import UNDERFLOW
from obb_collision.typing import Floats, Mask, Rows
from obb_collision.words import check_names, shown

#: Relative growth of the reach of an object: more than the slack of all bounds of boxes and
#: spheres, 2^-38 at most.
REACH_SLACK = 2.0**-35
#: Limit of regions in one split: far more than there are machines.
MOST_PARTS = 4096


@dataclass(frozen=True, eq=False)
class Region(ArrayValue):
    """The half-open box from a minimum up to, not including, a maximum, which may be infinite.

    Parameters
    ----------
    minimum, maximum : (3,) array_like
        Metres, the minimum below the maximum; -inf and inf: without an end.
    halo : float
        Metres around it in which objects take part: as far as effects look from objects.

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
        """Whether the region is all of space."""
        return bool(np.isneginf(self.minimum).all() and np.isposinf(self.maximum).all())

    def holds(self, points: ArrayLike) -> Mask:
        """Return which points are in the region, (n,).

        Parameters
        ----------
        points : (n, 3) array_like

        Examples
        --------
        >>> oc.regions.Region([0, 0, 0], [1, 1, 1]).holds([[0, 0, 0], [0, 0, 1]]).tolist()
        [True, False]
        """
        return owns(self, as_array(points, "points", (None, 3)))


def split_regions(
    minimum: ArrayLike, maximum: ArrayLike, parts: Sequence[int], halo: float = 0.0
) -> list[Region]:
    """Cut a box into equal regions, the outermost of which have no end outwards.

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
    """Return whether points of space are in no region, and which regions overlap others.

    Exact: volumes are counted in whole cells between the bounds. While regions overlap, a gap may
    stay unnoticed.
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
    """Return which canonical points (n, 3), possibly infinite, are in a region."""
    above = (points >= region.minimum).all(axis=1)
    return np.asarray(above & ((points < region.maximum) | (region.maximum == np.inf)).all(axis=1))


def owns_pairs(region: Region, minimum: Floats, pairs: Rows) -> Mask:
    """Return which pairs (m, 2) of rows of bounds with minimum (n, 3) belong to a region."""
    return owns(region, np.maximum(minimum[pairs[:, 0]], minimum[pairs[:, 1]]))


def balls_near(region: Region, centers: Floats, radii: Floats) -> Mask:
    """Return which balls of centers (n, 3) and radii (n,), metres, may reach into a region's halo.

    For spheres around boxes: never False where the bounds of a box reach there.
    """
    reach = region.halo + radii
    reach += REACH_SLACK * (reach + np.abs(centers).sum(axis=1)) + UNDERFLOW
    low, high = centers + reach[:, None], centers - reach[:, None]
    return np.asarray(((low >= region.minimum) & (high <= region.maximum)).all(axis=1))


PAIR_FIELDS = ("ns_a", "id_a", "ns_b", "id_b")
OBJECT_FIELDS = ("ns", "id")
CLOUD_FIELDS = (*OBJECT_FIELDS, "cloud_ns", "cloud_id")
#: Stamps that wait for the rows of other regions: a second at 100 Hz.
MOST_WAITING = 100


@dataclass
class RegionState:
    """State of a region by its messages: times in seconds, and numbers of objects."""

    last: float = -np.inf
    since: float = np.inf  #: begin of the time without a fault
    counts: list[tuple[float, int]] = field(default_factory=list)


class RegionMerger(SetOnce):
    """Joins rows of several regions once all have evaluated a stamp.

    A region is missing while it is silent for longer than the timeout, while it has fewer objects
    than another region had all that time (it began late, or again), and for one timeout after that.
    Its rows are not used meanwhile, so that joined rows are complete. Needs no ROS: times are those
    of any steady clock. KeyError for an unknown region.

    Parameters
    ----------
    regions : sequence of str
        Distinct names.
    timeout : float
        Seconds.

    Examples
    --------
    >>> merger = oc.regions.RegionMerger(["west", "east"], timeout=0.5)
    >>> merger.missing(0.0)
    {'west': 'no message yet', 'east': 'no message yet'}
    """

    def __init__(self, regions: Sequence[str], timeout: float = 0.5) -> None:
        if isinstance(regions, str):
            raise TypeError(f"regions must be a sequence of names, got {shown(regions)}")
        check_kind(regions, Sequence, "regions")
        check_names(regions, "regions")
        if not regions or len(set(regions)) < len(regions):
            raise ValueError(f"regions must be distinct names, at least one, got {shown(regions)}")
        self.timeout = float(as_array(timeout, "timeout", ()))
        if self.timeout <= 0.0:
            raise ValueError(f"timeout must be positive, got {shown(timeout)}")
        self._regions = {name: RegionState() for name in regions}
        self._waiting: dict[str, dict[int, dict[str, NDArray[Any]]]] = {}
        self._repeated = 0

    @property
    def repeated(self) -> int:
        """Number of rows left out because several regions had them: these regions overlap."""
        return self._repeated

    def mark_alive(self, region: str, objects: int, now: float) -> None:
        """Note a message of a region, and how many objects it has.

        Parameters
        ----------
        region : str
        objects : int
        now : float
            Seconds.

        Examples
        --------
        >>> merger = oc.regions.RegionMerger(["west"], timeout=0.5)
        >>> merger.mark_alive("west", 10, 0.0)
        >>> merger.missing(0.25)
        {'west': 'back for 0.2 s'}
        """
        number, when = as_whole(objects, "objects"), float(as_array(now, "now", ()))
        presence = self._presence(region)
        if when - presence.last > self.timeout:
            presence.since = np.inf
        presence.last = when
        recent = [(then, n) for then, n in presence.counts if when - then <= self.timeout]
        presence.counts = [*recent, (when, number)]
        self.missing(when)

    def missing(self, now: float) -> dict[str, str]:
        """Return the missing regions, and why, by name.

        Parameters
        ----------
        now : float
            Seconds.

        Examples
        --------
        >>> merger = oc.regions.RegionMerger(["west"], timeout=0.5)
        >>> merger.mark_alive("west", 10, 0.0)
        >>> merger.missing(2.0)
        {'west': 'silent for 2.0 s'}
        """
        when = float(as_array(now, "now", ()))
        faults = {name: self._fault(name, when) for name in self._regions}
        return {name: fault for name, fault in faults.items() if fault}

    def take(
        self, region: str, stamp: int, rows: NDArray[Any], now: float, topic: str = "collisions"
    ) -> NDArray[Any] | None:
        """Take the rows of a region for a stamp; return the sorted rows of all once complete.

        Parameters
        ----------
        region : str
        stamp : int
            Nanoseconds; rows of equal stamps are joined.
        rows : (n,) structured array
            With the fields ``ns_a id_a ns_b id_b``, or ``ns id``, as in the clouds of the node.
            They replace rows of the same region and stamp that are not joined yet, except passed
            pairs, which a node reports once.
        now : float
            Seconds.
        topic : str
            Topic of the rows; each topic is joined by itself.

        Examples
        --------
        >>> merger = oc.regions.RegionMerger(["west"], timeout=0.5)
        >>> for now in (0.0, 0.25, 0.5):
        ...     merger.mark_alive("west", 10, now)
        >>> rows = np.zeros(1, [("ns", "<i4"), ("id", "<i4")])
        >>> merger.take("west", 1_000_000_000, rows, 0.6).tolist()
        [(0, 0)]
        """
        self._presence(region)
        number, when = as_whole(stamp, "stamp"), float(as_array(now, "now", ()))
        fields = _fields_of(rows)
        check_kind(topic, str, "topic")
        if self._fault(region, when):
            return None
        waiting = self._waiting.setdefault(topic, {})
        parts = waiting.setdefault(number, {})
        parts[region] = _with_passed(rows, parts.get(region))
        if len(parts) < len(self._regions):
            if len(waiting) > MOST_WAITING:
                del waiting[next(iter(waiting))]
            return None
        for older in list(waiting):  # earlier stamps are too late
            del waiting[older]
            if older == number:
                break
        return self._join([parts[name] for name in self._regions], fields)

    def _presence(self, region: str) -> RegionState:
        presence = self._regions.get(region) if isinstance(region, str) else None
        if presence is None:
            raise KeyError(f"no region named {shown(region)}")
        return presence

    def _fault(self, region: str, now: float) -> str:
        """Return why a region is missing, "" if it is not."""
        presence = self._regions[region]
        if presence.last == -np.inf:
            return "no message yet"
        if now - presence.last > self.timeout:
            presence.since = np.inf
            return f"silent for {now - presence.last:.1f} s"
        most = max(count for _, count in presence.counts)
        others = [
            min(count for _, count in other.counts)
            for name, other in self._regions.items()
            if name != region and now - other.last <= self.timeout
        ]
        if others and most < max(others):
            presence.since = np.inf
            return f"{most} of {max(others)} objects"
        presence.since = min(presence.since, now)
        if now - presence.since < self.timeout:
            return f"back for {now - presence.since:.1f} s"
        return ""

    def _join(self, parts: list[NDArray[Any]], fields: tuple[str, ...]) -> NDArray[Any]:
        """Return the rows of all regions, sorted, each pair or object from one region only."""
        rows = np.concatenate(parts)
        if len(parts) == 1 or len(rows) == 0:
            return rows
        owners = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
        names = [*fields, *(name for name in ("passed",) if name in (rows.dtype.names or ()))]
        order = np.lexsort([rows[name] for name in reversed(names)])
        rows, owners = rows[order], owners[order]
        begins = np.ones(len(rows), np.bool_)
        begins[1:] = np.any([rows[name][1:] != rows[name][:-1] for name in names], axis=0)
        firsts = np.flatnonzero(begins)[np.cumsum(begins) - 1]
        kept = owners == owners[firsts]
        self._repeated += int(np.count_nonzero(~kept))
        return rows if kept.all() else rows[kept]


def _with_passed(rows: NDArray[Any], before: NDArray[Any] | None) -> NDArray[Any]:
    """Return rows, and those earlier rows of passed pairs that ``rows`` lacks."""
    if before is None or "passed" not in (rows.dtype.names or ()) or before.dtype != rows.dtype:
        return rows
    fields = list(_fields_of(rows))
    again = set(rows[rows["passed"] != 0][fields].tolist())
    gone = before[before["passed"] != 0]
    missed = [thing not in again for thing in gone[fields].tolist()]
    return np.concatenate([rows, gone[np.array(missed, np.bool_)]])


def _fields_of(rows: NDArray[Any]) -> tuple[str, ...]:
    """Return the fields that name the pair or object of a row; ValueError without them."""
    names = rows.dtype.names if isinstance(rows, np.ndarray) and rows.ndim == 1 else None
    for fields in (PAIR_FIELDS, CLOUD_FIELDS, OBJECT_FIELDS):
        if names is not None and set(fields) <= set(names):
            return fields
    raise ValueError(f"rows must be a structured array with {' '.join(PAIR_FIELDS)}, or ns id")

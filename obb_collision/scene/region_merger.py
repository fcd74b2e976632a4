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

"""Merger: joins what several regions found, by stamp, and says which regions are missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.validation import as_array, as_whole, check_kind
from obb_collision.geometry.values import SetOnce
from obb_collision.words import check_names, shown

PAIR_FIELDS = ("ns_a", "id_a", "ns_b", "id_b")
OBJECT_FIELDS = ("ns", "id")
#: Stamps that wait for the rows of other regions: a second at 100 Hz.
MOST_WAITING = 100


@dataclass
class Presence:
    """When the last message of a region came, and how many objects it held: times in seconds."""

    last: float = -np.inf
    since: float = np.inf  #: has been right since then
    counts: list[tuple[float, int]] = field(default_factory=list)


class RegionMerger(SetOnce):
    """Joins rows of several regions where all have evaluated a stamp.

    A region is missing while it is silent for longer than the timeout, while it has fewer objects
    than another one had all that time (it began late, or again), and for one timeout after that.
    What it finds meanwhile is not used, so that what is joined is complete. Needs no ROS: times are
    those of any steady clock.

    Parameters
    ----------
    regions : sequence of str
        Their names.
    timeout : float
        Seconds.

    Raises
    ------
    ValueError
        For names that are none, or the same, and a timeout that is not positive.

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
        self._regions = {name: Presence() for name in regions}
        self._waiting: dict[str, dict[int, dict[str, NDArray[Any]]]] = {}
        self._repeated = 0

    @property
    def repeated(self) -> int:
        """Number of rows left out as more than one region had them: these regions overlap."""
        return self._repeated

    def mark_alive(self, region: str, objects: int, now: float) -> None:
        """Note that a region is there, and how many objects it has.

        Parameters
        ----------
        region : str
        objects : int
        now : float
            Seconds.

        Raises
        ------
        KeyError
            For an unknown region.

        Examples
        --------
        >>> merger = oc.regions.RegionMerger(["west"], timeout=0.5)
        >>> merger.mark_alive("west", 10, 0.0)
        >>> merger.missing(0.25)
        {'west': 'back for 0.2 s'}
        """
        number, when = as_whole(objects, "objects"), float(as_array(now, "now", ()))
        found = self._presence(region)
        if when - found.last > self.timeout:
            found.since = np.inf
        found.last = when
        recent = [(then, n) for then, n in found.counts if when - then <= self.timeout]
        found.counts = [*recent, (when, number)]
        self.missing(when)

    def missing(self, now: float) -> dict[str, str]:
        """Return the regions of which nothing is known, and why.

        Parameters
        ----------
        now : float
            Seconds.

        Returns
        -------
        dict of str to str

        Examples
        --------
        >>> merger = oc.regions.RegionMerger(["west"], timeout=0.5)
        >>> merger.mark_alive("west", 10, 0.0)
        >>> merger.missing(2.0)
        {'west': 'silent for 2.0 s'}
        """
        when = float(as_array(now, "now", ()))
        found = {name: self._fault(name, when) for name in self._regions}
        return {name: reason for name, reason in found.items() if reason}

    def take(
        self, region: str, stamp: int, rows: NDArray[Any], now: float, topic: str = "collisions"
    ) -> NDArray[Any] | None:
        """Take the rows that a region found for a stamp; return those of all once they are there.

        Parameters
        ----------
        region : str
        stamp : int
            Nanoseconds; rows of equal stamps are joined.
        rows : (n,) structured array
            With the fields ``ns_a id_a ns_b id_b``, or ``ns id``, as the clouds of the node. They
            replace those of the same region and stamp that are not joined yet, but for what has
            passed: a node reports that once.
        now : float
            Seconds.
        topic : str
            What they are: each is joined by itself.

        Returns
        -------
        (m,) structured array or None
            Sorted by these fields.

        Raises
        ------
        KeyError
            For an unknown region.

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
        for older in list(waiting):  # what came before is too late
            del waiting[older]
            if older == number:
                break
        return self._join([parts[name] for name in self._regions], fields)

    def _presence(self, region: str) -> Presence:
        found = self._regions.get(region) if isinstance(region, str) else None
        if found is None:
            raise KeyError(f"no region named {shown(region)}")
        return found

    def _fault(self, region: str, now: float) -> str:
        """Return why a region is missing, "" if it is not."""
        found = self._regions[region]
        if found.last == -np.inf:
            return "no message yet"
        if now - found.last > self.timeout:
            found.since = np.inf
            return f"silent for {now - found.last:.1f} s"
        most = max(count for _, count in found.counts)
        others = [
            min(count for _, count in other.counts)
            for name, other in self._regions.items()
            if name != region and now - other.last <= self.timeout
        ]
        if others and most < max(others):
            found.since = np.inf
            return f"{most} of {max(others)} objects"
        found.since = min(found.since, now)
        if now - found.since < self.timeout:
            return f"back for {now - found.since:.1f} s"
        return ""

    def _join(self, parts: list[NDArray[Any]], fields: tuple[str, ...]) -> NDArray[Any]:
        """Return rows of all regions, sorted, each thing from one of them only."""
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
    """Return rows, and those of things that had passed before and are not among them."""
    if before is None or "passed" not in (rows.dtype.names or ()) or before.dtype != rows.dtype:
        return rows
    fields = list(_fields_of(rows))
    again = set(rows[rows["passed"] != 0][fields].tolist())
    gone = before[before["passed"] != 0]
    missed = [thing not in again for thing in gone[fields].tolist()]
    return np.concatenate([rows, gone[np.array(missed, np.bool_)]])


def _fields_of(rows: NDArray[Any]) -> tuple[str, ...]:
    """Return the fields that say what a row is about; ValueError where there are none."""
    names = rows.dtype.names if isinstance(rows, np.ndarray) and rows.ndim == 1 else None
    for fields in (PAIR_FIELDS, OBJECT_FIELDS):
        if names is not None and set(fields) <= set(names):
            return fields
    raise ValueError(f"rows must be a structured array with {' '.join(PAIR_FIELDS)}, or ns id")

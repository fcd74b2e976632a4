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

"""Lines that the demo prints: pairs as they begin and end, and what is new of effects.

A narrator per topic: ``update`` takes a message's named rows and yields the lines that are worth
printing, ``summary`` those at the end. ``rows`` are the latest ones, for the picture.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from obb_collision import node

#: Seconds after which a collision that is predicted again is printed again.
FORGET = 0.5
#: Metres: what is less deep rests on the other. Far above rounding, far below what can be seen.
TOUCH_DEPTH = 1e-6


def pair_of(row: Any) -> str:
    """Return the names of a row's objects as text."""
    return f"{row.a} – {row.b}"  # noqa: RUF001 - an en dash, as in print


def is_touching(row: node.NamedPair) -> bool:
    """Return whether the objects touch without overlapping; False where the depth is unknown."""
    return row.depth < TOUCH_DEPTH


def pair_text(row: node.NamedPair) -> str:
    """Return a pair and its depth as text."""
    depth = "" if np.isnan(row.depth) else f"  {1e3 * row.depth:.0f} mm"
    return pair_of(row) + ("  touching" if is_touching(row) else depth)


class PairsNarrator:
    """Colliding pairs: which begin and end."""

    def __init__(self) -> None:
        self.rows: list[node.NamedPair] = []
        self._seen: set[tuple[str, str]] = set()
        self._most = 0

    def update(self, rows: list[node.NamedPair], seconds: float) -> Iterator[str]:
        """Take the pairs; yield those that begin and those that end."""
        before = {row[:2]: row for row in self.rows}
        now = {row[:2]: row for row in rows}
        self.rows = rows
        self._seen |= now.keys()
        self._most = max(self._most, len(now))
        yield from (f"begins  {pair_text(now[pair])}" for pair in now if pair not in before)
        yield from (f"ends    {pair_of(before[pair])}" for pair in before if pair not in now)

    def summary(self) -> Iterator[str]:
        """Yield how many pairs there were."""
        touching = sum(is_touching(row) for row in self.rows)
        yield (
            f"{len(self._seen)} pairs in all, at most {self._most} at once; at the end "
            f"{len(self.rows)}: {len(self.rows) - touching} overlapping, {touching} touching"
        )


class ContactsNarrator:
    """Contact points: how many there were at once."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._most = 0

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the contact points; their pairs are printed already."""
        self.rows = rows
        self._most = max(self._most, len(rows))
        yield from ()

    def summary(self) -> Iterator[str]:
        """Yield how many there were."""
        yield f"contacts: {len(self.rows)} points at the end, at most {self._most} at once"


class ClearancesNarrator:
    """Near pairs: the minimum distance of those that are apart."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._minimum: tuple[float, str, float] | None = None

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the distances; no line, as they change all the time."""
        self.rows = [row for row in rows if row.distance > 0]
        apart = [(row.distance, pair_of(row), seconds) for row in self.rows]
        known = [] if self._minimum is None else [self._minimum]
        self._minimum = min([*apart, *known], default=None)
        yield from ()

    def summary(self) -> Iterator[str]:
        """Yield the minimum over all time, and at the end."""
        if self._minimum is not None:
            distance, pair, seconds = self._minimum
            yield f"clearance: minimum {1e3 * distance:.1f} mm, {pair}, at {seconds:.1f} s"
        if self.rows:
            near = min(self.rows, key=lambda row: row.distance)
            nearest = f"{1e3 * near.distance:.1f} mm, {pair_of(near)}"
            yield f"clearance at the end: {len(self.rows)} pairs, minimum {nearest}"


class Predictions:
    """Collisions predicted, and those that passed between two states."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._last: dict[tuple[str, str], float] = {}  # when each was predicted last
        self._predicted, self._passed = 0, 0

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the predictions; yield those that are new, and all that passed."""
        self.rows = [row for row in rows if row.time >= 0.0 and not row.undecided]
        for row in rows:
            pair = pair_of(row)
            if row.undecided:
                yield f"undecided {pair}  may collide from {row.time:.2f} s on"
                continue
            if row.time < 0.0:
                self._passed += 1
                yield f"passed  {pair}  {-1e3 * row.time:.0f} ms ago, between two states"
                continue
            if seconds - self._last.get((row.a, row.b), -np.inf) > FORGET:
                self._predicted += 1
                yield f"predicted {pair}  in {row.time:.2f} s"
            self._last[row.a, row.b] = seconds

    def summary(self) -> Iterator[str]:
        """Yield how many there were, and the next ones at the end."""
        yield f"sweep: {self._predicted} collisions predicted, {self._passed} between two states"
        for row in sorted(self.rows, key=lambda row: row.time)[:3]:
            yield f"time to collision at the end: {row.time:.2f} s, {pair_of(row)}"


class PointsInsideNarrator:
    """Points in zones: how many, and when a zone is entered and left."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._most: dict[str, int] = {}

    def update(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the counts; yield the objects that points enter or leave."""
        before = {row.name for row in self.rows}
        self.rows = [row for row in rows if row.points > 0]
        for row in self.rows:
            self._most[row.name] = max(self._most.get(row.name, 0), row.points)
            if row.name not in before:
                yield f"entered {row.name}  {row.points} points inside"
        for name in sorted(before - {row.name for row in self.rows}):
            yield f"left    {name}"

    def summary(self) -> Iterator[str]:
        """Yield the counts."""
        now = {row.name: row.points for row in self.rows}
        for name, most in sorted(self._most.items()):
            yield f"points in {name}: {now.get(name, 0)} at the end, at most {most}"


def _all_predictions(message: Any, namespaces: Any) -> list[node.NamedPrediction]:
    """Return the rows of ``predicted_collisions``: what is ahead, and what passed."""
    return [
        *node.named_predictions(message, namespaces),
        *node.named_passed_collisions(message, namespaces),
    ]


#: By effect: what gives a message's rows names, and the narrator.
NARRATORS: dict[str, tuple[Callable[..., list[Any]], type]] = {
    "contacts": (node.named_contacts, ContactsNarrator),
    "clearance": (node.named_clearances, ClearancesNarrator),
    "sweep": (_all_predictions, Predictions),
    "points": (node.named_points_inside, PointsInsideNarrator),
}

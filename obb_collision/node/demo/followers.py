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

"""Followers of the effects that a scene file calls for: contacts, distances, times, points.

Each follows one topic: ``take`` gets a message's named rows and yields what is worth a line,
``ends`` says what goes in the summary.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from obb_collision.node import (
    NamedPrediction,
    named_clearances,
    named_contacts,
    named_passed_collisions,
    named_points_inside,
    named_predictions,
)
from obb_collision.node.conversions import FloatArray

#: Seconds without which a foreseen collision counts as gone; predictions come and go with curves.
FORGET = 0.5


def pair_of(row: Any) -> str:
    """Return the names of a row's objects for people."""
    return f"{row.a} – {row.b}"  # noqa: RUF001 - an en dash, as in print


class Contacts:
    """Contact points: how many there were at once."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._most = 0

    def take(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the contact points; the pairs are told by ``collisions`` already."""
        self.rows = rows
        self._most = max(self._most, len(rows))
        yield from ()

    def ends(self) -> Iterator[str]:
        """Tell how many there were."""
        yield f"contacts: {len(self.rows)} points at the end, at most {self._most} at once"

    @property
    def points(self) -> FloatArray:
        """The points (k, 3) of the latest message."""
        return np.array([row.point for row in self.rows], np.float64).reshape(-1, 3)


class Clearances:
    """Near pairs: the nearest one that did not touch."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._least: tuple[float, str, float] | None = None

    def take(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the distances; no line, for they change all the time."""
        self.rows = rows
        apart = [(row.distance, pair_of(row), seconds) for row in rows if row.distance > 0]
        known = [] if self._least is None else [self._least]
        self._least = min([*apart, *known], default=None)
        yield from ()

    def ends(self) -> Iterator[str]:
        """Tell the nearest of all, and of the end."""
        if self._least is not None:
            distance, pair, seconds = self._least
            yield f"clearance: least {1e3 * distance:.1f} mm, {pair}, at {seconds:.1f} s"
        apart = [row for row in self.rows if row.distance > 0]
        if apart:
            near = min(apart, key=lambda row: row.distance)
            least = f"{1e3 * near.distance:.1f} mm, {pair_of(near)}"
            yield f"clearance at the end: {len(apart)} pairs, nearest {least}"

    @property
    def lines(self) -> FloatArray:
        """The closest points (k, 2, 3) of the pairs that are apart."""
        apart = [(row.point_a, row.point_b) for row in self.rows if row.distance > 0]
        return np.array(apart, np.float64).reshape(-1, 2, 3)


class Predictions:
    """Collisions to come, and those that passed between two states."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._foreseen: dict[tuple[str, str], float] = {}  # when each was foreseen last
        self._told, self._passed = 0, 0

    def take(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the predictions; tell those that are new, and all that passed."""
        self.rows = [row for row in rows if row.time >= 0.0 and not row.undecided]
        for row in rows:
            pair = pair_of(row)
            if row.undecided:
                yield f"unclear {pair}  may collide from {row.time:.2f} s on"
                continue
            if row.time < 0.0:
                self._passed += 1
                yield f"passed  {pair}  {-1e3 * row.time:.0f} ms before, unseen by the states"
                continue
            if seconds - self._foreseen.get((row.a, row.b), -np.inf) > FORGET:
                self._told += 1
                yield f"coming  {pair}  in {row.time:.2f} s"
            self._foreseen[row.a, row.b] = seconds

    def ends(self) -> Iterator[str]:
        """Tell how many there were, and what is coming at the end."""
        yield f"sweep: {self._told} collisions foreseen, {self._passed} found between two states"
        for row in sorted(self.rows, key=lambda row: row.time)[:3]:
            yield f"time to collision at the end: {row.time:.2f} s, {pair_of(row)}"


class Insides:
    """Points in zones: how many, and when a zone is entered and left."""

    def __init__(self) -> None:
        self.rows: list[Any] = []
        self._most: dict[str, int] = {}

    def take(self, rows: list[Any], seconds: float) -> Iterator[str]:
        """Take the counts; tell where there are points now or none any more."""
        before = {row.name for row in self.rows}
        self.rows = [row for row in rows if row.points > 0]
        for row in self.rows:
            self._most[row.name] = max(self._most.get(row.name, 0), row.points)
            if row.name not in before:
                yield f"entered {row.name}  {row.points} points inside"
        for name in sorted(before - {row.name for row in self.rows}):
            yield f"left    {name}"

    def ends(self) -> Iterator[str]:
        """Tell the counts."""
        now = {row.name: row.points for row in self.rows}
        for name, most in sorted(self._most.items()):
            yield f"points in {name}: {now.get(name, 0)} at the end, at most {most}"


def all_predictions(message: Any, namespaces: Any) -> list[NamedPrediction]:
    """Return the rows of ``predicted_collisions``: what is to come, and what passed."""
    return [
        *named_predictions(message, namespaces),
        *named_passed_collisions(message, namespaces),
    ]


#: How each effect is read and followed.
EFFECTS: dict[str, tuple[Callable[..., list[Any]], type]] = {
    "contacts": (named_contacts, Contacts),
    "clearance": (named_clearances, Clearances),
    "sweep": (all_predictions, Predictions),
    "points": (named_points_inside, Insides),
}

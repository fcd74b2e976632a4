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

"""Rows of the clouds with the names of their objects, as the readers return them."""

from __future__ import annotations

from math import isnan
from typing import NamedTuple

Triple = tuple[float, float, float]


class NamedPair(NamedTuple):
    """One collision with the objects' names, ``ns/id``, and its depth (m).

    touching: touching, or not distinguishable from touching in doubles; it counts as colliding.
    """

    a: str
    b: str
    depth: float
    touching: bool


class NamedContact(NamedTuple):
    """One contact point: where (m), unit normal from a to b, depth (m)."""

    a: str
    b: str
    point: Triple
    normal: Triple
    depth: float


class NamedClearance(NamedTuple):
    """One pair that is near: signed distance (m) and the closest points."""

    a: str
    b: str
    distance: float
    point_a: Triple
    point_b: Triple


class NamedPrediction(NamedTuple):
    """One collision to come or passed: when (s from the stamp), where (m), unit normal from a to b.

    If it is ``undecided``, it is not known whether the objects collide: they certainly don't
    before the time, but they may from then on. Point and normal are NaN then.
    """

    a: str
    b: str
    time: float
    point: Triple
    normal: Triple

    @property
    def undecided(self) -> bool:
        """Whether it is not known if they collide."""
        return isnan(self.point[0])


class NamedEvent(NamedTuple):
    """The begin or end of a collision: "begin", "end", or "lasting" for one that began before.

    depth: the greatest so far (m); duration: since the begin (s); reason: why it ended, "apart",
    "removed" or "not checked"; "" if it did not.
    """

    a: str
    b: str
    event: str
    depth: float
    duration: float
    reason: str


class NamedPoints(NamedTuple):
    """One object with points inside: how many, indices in the cloud of the first and the nearest.

    distance: from the box centre to the nearest one (m).
    """

    name: str
    points: int
    first: int
    nearest: int
    distance: float

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

"""Pairs of boxes that collide, and their contacts, in the words of the tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from one_set import contacts
from support import family, joined

from obb_collision import Boxes, Verdict, verdicts
from obb_collision.queries.contacts import Contacts
from obb_collision.typing import Floats
from tools.cases.placement import turns


def colliding(name: str, n: int) -> tuple[Boxes, Boxes]:
    """Return the pairs of a family that are not separate."""
    a, b = family(name, n)
    rows = np.flatnonzero(verdicts(a, b) != Verdict.SEPARATE)
    return a[rows], b[rows]


def between(a: Boxes, b: Boxes, limit: int = 4) -> Contacts:
    """Return the contacts of each row of a with the same row of b."""
    boxes, pairs = joined(a, b)
    return contacts(boxes, pairs, limit)


def one(a: Any, b: Any, limit: int = 4) -> tuple[Floats, Floats, float]:
    """Return points, normal and depth of one pair of (centre, rotation, half extents)."""
    boxes = Boxes(*([x, y] for x, y in zip(a, b, strict=True)))
    found = contacts(boxes, [[0, 1]], limit)
    return found.positions[0, : found.counts[0]], found.normals[0], float(found.depths[0])


def assert_same_places(found: Floats, wanted: Any, tolerance: float = 1e-12) -> None:
    """Assert that two sets of points (n, 3) are the same in any order."""
    wanted = np.asarray(wanted, float)
    assert found.shape == wanted.shape
    distances = np.linalg.norm(found[:, None] - wanted[None], axis=2)
    assert distances.min(axis=1).max() <= tolerance
    assert distances.min(axis=0).max() <= tolerance


CUBE = ([0.0, 0.0, 0.0], np.eye(3), [1.0, 1.0, 1.0])


def turned(axis: list[float], degrees: float) -> Floats:
    return turns(np.array([axis]), np.radians([degrees]))[0]

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

"""Questions about pairs (m, 2) of rows of one set of boxes, as most tests ask them."""

from __future__ import annotations

from numpy.typing import ArrayLike

import obb_collision as oc
from obb_collision import Boxes, MovingBoxes, sweeps
from obb_collision.queries.clearance import Clearances
from obb_collision.queries.contacts import Contacts
from obb_collision.queries.sweep import TOLERANCE, Sweeps


def contacts(boxes: Boxes, pairs: ArrayLike, limit: int = 4) -> Contacts:
    return oc.contacts(boxes, boxes, pairs, max_points=limit)


def clearances(boxes: Boxes, pairs: ArrayLike) -> Clearances:
    return oc.clearances(boxes, boxes, pairs)


def sweep(
    start: Boxes, end: Boxes, pairs: ArrayLike, tolerance: float = TOLERANCE, *,
    contacts: bool = True,
) -> Sweeps:  # fmt: skip
    """Sweep boxes from pose to pose."""
    moving = MovingBoxes(start, end)
    return sweeps(moving, moving, pairs, tolerance=tolerance, contacts=contacts)


def sweep_twists(
    boxes: Boxes, twists: ArrayLike, pairs: ArrayLike, horizon: float,
    tolerance: float = TOLERANCE, *, origins: ArrayLike | None = None, contacts: bool = True,
) -> Sweeps:  # fmt: skip
    """Sweep boxes by their twists."""
    moving = MovingBoxes.from_twists(boxes, twists, horizon, origins=origins)
    return sweeps(moving, moving, pairs, tolerance=tolerance, contacts=contacts)

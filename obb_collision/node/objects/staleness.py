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

"""Objects without a new state for too long, and what happens to them: kept, ignored or grown.

With the policy ``collide`` a stale object is grown by what it can have moved since its last state:
no point of it is faster than ``speed``, or than its last twist said, so the grown box contains the
object wherever it is by now. Beyond ``reach`` boxes grow no more, and where it is is not known.
"""

from __future__ import annotations

import numpy as np

from obb_collision.node.messages.conversions import NANOSECONDS
from obb_collision.node.objects.placement import Placement
from obb_collision.node.objects.table import ObjectTable, Slots
from obb_collision.scene.scene import Scene
from obb_collision.typing import Floats

KEEP, IGNORE, COLLIDE = "keep", "ignore", "collide"
POLICIES = (KEEP, IGNORE, COLLIDE)


class Staleness:
    """Marks stale objects, and applies the policy to them.

    speed: maximum speed of any point of an object (m/s), where its last twist says no more; reach:
    maximum growth (m).
    """

    def __init__(self, scene: Scene, table: ObjectTable, placement: Placement) -> None:
        self._scene, self._table, self._placement = scene, table, placement
        self.policy = KEEP
        self.speed = self.reach = 0.0
        self._grown: Slots = np.empty(0, np.int64)

    def set(self, policy: str, speed: float, reach: float) -> None:
        """Set the policy for stale objects; they are reported with any of them."""
        self.policy, self.speed, self.reach = policy, speed, reach
        if self._placement.ignore_stale != (policy == IGNORE):
            self._placement.ignore_stale = policy == IGNORE
            self._placement.enable(np.flatnonzero(self._table.live))

    def mark(self, now: int, timeout: float) -> None:
        """Mark objects whose state is older than ``timeout`` (s; 0: none) at time ``now`` (ns)."""
        table = self._table
        stale = table.live & table.placed & (timeout > 0)
        stale &= now - table.world_received > int(timeout * NANOSECONDS)
        changed = np.flatnonzero(table.live & (stale != table.stale))
        table.stale[:] = stale
        if len(changed):
            gone = changed[stale[changed]]
            table.order[gone] = 0  # a restarted sender may begin anew
            table.speed[gone] = self._scene.speeds_of(gone, table.twist[gone])
            self._placement.stop(gone)  # how they move is not known any more
            self._placement.enable(changed)
        self._grow(now)

    def _grow(self, now: int) -> None:
        """Grow stale objects by what they can have moved, and others no longer."""
        table = self._table
        rows = np.flatnonzero(table.stale) if self.policy == COLLIDE else self._grown[:0]
        if len(rows) == len(self._grown) == 0:
            return
        back = np.setdiff1d(self._grown[table.live[self._grown]], rows)
        self._scene.grow_indices(back, np.zeros(len(back)))
        moved = np.maximum(table.speed[rows], self.speed) * self._ages(rows, now)
        self._scene.grow_indices(rows, np.minimum(np.nextafter(moved, np.inf), self.reach))
        table.lost[:] = False
        table.lost[rows] = moved > self.reach
        self._grown = rows

    def _ages(self, rows: Slots, now: int) -> Floats:
        """Return how old (s) the states of objects are: by their stamps, if those are believed."""
        stamps, received = self._table.world_stamp[rows], self._table.world_received[rows]
        since = np.where(stamps > 0, np.minimum(stamps, received), received)
        ages: Floats = np.maximum(now - since, 0) / NANOSECONDS
        return ages

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

"""Objects without a new state for longer than their age limit, and what is done with them.

With the policy ``collide`` a stale object is grown by what it can have moved since its last state:
no point of it is faster than ``speed``, or than its last twist said, so the grown box contains the
object wherever it is by now. Beyond ``reach`` boxes grow no more, and where it is is not known.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from obb_collision.node.messages.conversions import NANOSECONDS, name_from_key
from obb_collision.node.objects.conditions import (
    IGNORED,
    LIVE,
    LOST,
    STALE,
    UNPLACED,
)
from obb_collision.node.objects.placement import Placement
from obb_collision.node.objects.table import (
    COLLIDE,
    IGNORE,
    POLICIES,
    UNKNOWN,
    ObjectTable,
    Slots,
)
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import Overrides
from obb_collision.typing import Floats, Mask


@dataclass(frozen=True)
class AgeLimits:
    """After how long objects are stale, and what is done then.

    timeout: age limit (s) of objects from their second message on, 0 for none; timeouts: limits of
    objects by name, from the first message on; policy, policies: what is done, by name. speed:
    maximum speed of any point of an object (m/s), where its last twist says no more; reach: maximum
    growth (m).
    """

    timeout: float = 0.0
    timeouts: Overrides[float] = field(default_factory=Overrides)
    policy: str = UNKNOWN
    policies: Overrides[str] = field(default_factory=Overrides)
    speed: float = 0.0
    reach: float = 0.0


class Staleness:
    """Marks stale objects, and applies their policies."""

    def __init__(self, scene: Scene, table: ObjectTable, placement: Placement) -> None:
        self._scene, self._table, self._placement = scene, table, placement
        self._limits = AgeLimits()
        self._grown: Slots = np.empty(0, np.int64)

    @property
    def limits(self) -> AgeLimits:
        """The limits of all objects."""
        return self._limits

    @limits.setter
    def limits(self, limits: AgeLimits) -> None:
        self._limits = limits
        self._table.limited[:] = False  # whose limit has been looked up
        self._look_up()
        self._judge(np.flatnonzero(self._has(COLLIDE)))  # unless the next cycle says otherwise
        self._placement.enable(np.flatnonzero(self._table.live))

    def _has(self, policy: str) -> Mask:
        """Return (rows,) which objects are stale, and have a policy for that."""
        return self._table.has(STALE) & (self._table.policy == POLICIES.index(policy))

    def _judge(self, beyond: Slots) -> None:
        """Apply the policies of stale objects; beyond: those that can be beyond their box."""
        self._table.judge(IGNORED, self._has(IGNORE))
        lost = self._has(UNKNOWN)
        lost[beyond] = True
        self._table.judge(LOST, lost)

    def mark(self, now: int) -> None:
        """Mark objects whose state is older than their limit at time ``now`` (ns)."""
        table = self._table
        self._look_up()
        has_limits = self._limits.timeout or self._limits.timeouts
        if not (has_limits or len(self._grown) or table.facts & STALE):
            return
        before = table.has(STALE)
        default = np.where(table.repeated, int(self._limits.timeout * NANOSECONDS), 0)
        limits = np.where(table.limit < 0, default, table.limit)
        placed = (table.condition & (LIVE | UNPLACED)) == LIVE
        stale = placed & (limits > 0) & (now - table.world_received > limits)
        table.judge(STALE, stale)
        changed = np.flatnonzero(stale != before)
        if len(changed):
            gone = changed[stale[changed]]
            table.order[gone] = 0  # a restarted sender may begin anew
            table.speed[gone] = self._scene.objects.speeds_of(gone, table.twist[gone])
            self._placement.stop(gone)  # how they move is not known any more
        self._judge(self._grow(now))
        self._placement.enable(changed)

    def _look_up(self) -> None:
        """Give new objects their limit, -1 for that of all, and their policy."""
        table, limits = self._table, self._limits
        rows = np.flatnonzero(table.live & ~table.limited)
        table.limit[rows], table.policy[rows] = -1, POLICIES.index(limits.policy)
        table.limited[rows] = True
        if not (limits.timeouts or limits.policies):
            return
        for slot in rows.tolist():
            name = name_from_key(table.key(slot))
            timeout, policy = limits.timeouts.value(name), limits.policies.value(name)
            if timeout is not None:
                table.limit[slot] = int(timeout * NANOSECONDS)
            if policy is not None:
                table.policy[slot] = POLICIES.index(policy)

    def _grow(self, now: int) -> Slots:
        """Grow stale objects by what they can have moved, and others no longer.

        Returns those that can have moved farther than their boxes grow.
        """
        table, limits = self._table, self._limits
        rows = np.flatnonzero(self._has(COLLIDE))
        if len(rows) == len(self._grown) == 0:
            return rows
        back = np.setdiff1d(self._grown[table.has(LIVE, self._grown)], rows)
        self._scene.objects.grow(back, np.zeros(len(back)))
        moved = np.maximum(table.speed[rows], limits.speed) * self._ages(rows, now)
        self._scene.objects.grow(rows, np.minimum(np.nextafter(moved, np.inf), limits.reach))
        self._grown = rows
        return rows[moved > limits.reach]

    def _ages(self, rows: Slots, now: int) -> Floats:
        """Return how old (s) the states of objects are: by their stamps, if those are believed."""
        stamps, received = self._table.world_stamp[rows], self._table.world_received[rows]
        since = np.where(stamps > 0, np.minimum(stamps, received), received)
        ages: Floats = np.maximum(now - since, 0) / NANOSECONDS
        return ages

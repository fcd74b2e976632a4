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

"""States of objects: stored as they arrive, the latest one wins; without a new one they are stale.

With the policy ``collide`` a stale object is grown by what it can have moved since its last state:
no point of it is faster than ``speed``, or than its last twist, so the grown box contains the
object wherever it is by now. Beyond ``reach`` boxes grow no more, and where it is is not known.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np

from obb_collision.geometry.poses import unit_poses
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.conversions import FAR as FAR_KIND
from obb_collision.node.messages.conversions import NANOSECONDS, Kinds, pose_kinds
from obb_collision.node.objects.conditions import (
    FUTURE,
    HELD_BACK,
    IGNORED,
    LIVE,
    LOST,
    OVERTAKEN,
    POSE_GIVEN,
    POSE_OVERTAKEN,
    POSE_REFUSED,
    STALE,
    UNPLACED,
    WAITING,
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
from obb_collision.scene.store.placing import as_slice
from obb_collision.typing import Floats, Mask

JUDGED_BY = BY_STAMP, _ = "stamp_and_receipt", "receipt"
"""What ages go by: the older of both, or receipt alone."""
OLDER = "older stamp"
"""Reason: a state was received after one with a newer stamp."""
FAR = "quaternion far from unit length"
"""Doubt: its length is more than 0.1 off 1; it is normalised."""
AHEAD = "stamp from the future"
"""Doubt: a state's stamp is ahead of the node's clock by more than the tolerance."""
ANEW = "stamps restarted"
"""Doubt: a state is older than the one before, received so long ago that its sender must have
restarted."""


@dataclass(frozen=True)
class State:
    """Where poses come from: frame, stamp (ns, 0: none), time of receipt (ns), topic and sender.

    Stamp, time of receipt and sender are those of all poses, or arrays with one for each. carried:
    when the transform was true that has placed them already (ns), 0 for none.
    """

    frame: str
    stamp: int | Slots
    received: int | Slots
    topic: str = "objects"
    carried: int = 0
    sender: int | Slots = 0


class States:
    """Stores states in the table, and counts their faults by the monitors of their topics."""

    def __init__(
        self, table: ObjectTable, placement: Placement, monitors: Mapping[str, InputMonitor]
    ) -> None:
        self._table, self._placement, self._monitors = table, placement, monitors
        self.by_stamp = True
        """Whether a state is as old as its stamp says, if that is older than its receipt."""
        self.wants_twists: Callable[[], bool] = lambda: True
        """Whether anything depends on how objects move."""
        self.stamp_tolerance = NANOSECONDS // 2
        """Stamps further than this ahead of the node's clock (ns) are not believed."""
        self.order_timeout = NANOSECONDS
        """For how long after a state (ns) an older one is taken for late, not for a new start."""

    def store(
        self,
        slots: Slots,
        poses: Floats,
        state: State,
        twists: Floats | None = None,
        kinds: Kinds | None = None,
    ) -> Mask:
        """Store poses (n, 7) of slots (n,) for the next cycle; returns which were too old (n,).

        The poses are finite with quaternions that are not zero, the twists (n, 6) finite or NaN for
        none: inputs see to that. kinds: of the poses, where the input has them from
        ``pose_kinds``. Of rows for the same object the last one stays. Raises RefusedError
        ("unknown frame").
        """
        frame = self._placement.frame_index(state.frame)
        stamps = np.broadcast_to(state.stamp, len(slots))
        received = np.broadcast_to(state.received, len(slots))
        senders = np.broadcast_to(state.sender, len(slots))
        old = self._find_old(slots, stamps, received, state.topic)
        if old.any():
            new = ~old
            slots, poses, twists = slots[new], poses[new], None if twists is None else twists[new]
            stamps, received, senders = stamps[new], received[new], senders[new]
            kinds = None if kinds is None else kinds[new]
        if len(slots):
            self._monitors[state.topic].superseded += self._placement.supersede(slots, frame)
            kinds = pose_kinds(poses) if kinds is None else kinds
            poses = self._unit(slots, poses, kinds == FAR_KIND, state.topic)
            table, rows = self._table, as_slice(slots)
            table.pose[rows], table.frame[rows] = poses, frame
            table.twist[rows] = self._used_twists(slots, twists)
            table.topic[rows] = self._placement.topics.index(state.topic)
            table.sender[rows] = senders
            table.locked[rows] = False
            if frame == 0:  # others get it when they are placed
                table.carried[rows] = state.carried
            table.mark(rows, POSE_GIVEN)
            self._stamp(slots, stamps, received, state.topic)
        return old

    def _used_twists(self, slots: Slots, twists: Floats | None) -> Floats | float:
        """Return the twists that move objects on, and store all for when they are stale.

        Poses alone say nothing of how fast an object can be.
        """
        if twists is None:
            return 0.0
        valid = np.asarray(~np.isnan(twists).any(axis=1))
        self._table.last_twist[slots[valid]] = twists[valid]
        return np.where(valid[:, None], twists, 0.0) if self.wants_twists() else 0.0

    def _stamp(self, slots: Slots, stamps: Slots, received: Slots, topic: str) -> None:
        """Store stamps; one that is not believed orders nothing."""
        table, rows = self._table, as_slice(slots)
        table.repeated[rows] |= table.received[rows] > 0
        table.stamp[rows], table.received[rows] = stamps, received
        ahead = stamps - received
        doubted = ahead > self.stamp_tolerance
        if doubted.any():
            most = f"{ahead.max() / NANOSECONDS:.1f} s ahead of the node's clock"
            self._doubt(AHEAD, slots[doubted], topic, most)
        orders = ~doubted & (stamps != 0)
        table.order[rows] = np.where(orders, stamps, table.order[rows])

    def since(self, stamp: int, received: int) -> int:
        """Return since when (ns) a value is known; stamp: 0 for none."""
        return min(stamp, received) if self.by_stamp and stamp > 0 else received

    def _unit(self, slots: Slots, poses: Floats, far: Mask, topic: str) -> Floats:
        """Normalise the quaternions that are far from unit length."""
        if not far.any():
            return poses
        self._doubt(FAR, slots[far], topic, "taken as normalised")
        return np.where(far[:, None], unit_poses(poses), poses)

    def find_late(self, slots: Slots, stamps: Slots | int, received: Slots | int) -> Mask:
        """Return which states (n,) come too late: soon after newer ones of their objects.

        Their objects are marked, and doubtful if nothing newer comes. Slot -1: a new object.
        """
        table = self._table
        late = (slots >= 0) & (stamps < table.order[slots]) & (np.asarray(stamps) > 0)
        late &= received - table.received[slots] <= self.order_timeout
        if late.any():
            table.mark(slots[late], POSE_OVERTAKEN)
        return late

    def _find_old(self, slots: Slots, stamps: Slots, received: Slots, topic: str) -> Mask:
        """Return which states are too old (n,), and note which senders restarted."""
        before = self._table.order[slots] - stamps
        if not (before > 0).any():
            return np.zeros(len(slots), np.bool_)
        old = self.find_late(slots, stamps, received)
        anew = ~old & (before > 0) & (stamps != 0)
        if anew.any():
            most = f"{before[anew].max() / NANOSECONDS:.1f} s before the last one"
            self._doubt(ANEW, slots[anew], topic, most)
        return old

    def _doubt(self, reason: str, slots: Slots, topic: str, detail: str) -> None:
        name = self._table.name(int(slots[0]))
        self._monitors[topic].doubt(reason, name, detail, len(slots))

    def lock(self, slots: Slots) -> None:
        """Place the stored poses in every cycle by the current transforms of their frames."""
        self._table.locked[slots] = self._table.frame[slots] != 0
        self._table.stamp[slots] = 0

    def refuse(self, slots: Slots) -> None:
        """Mark that the latest poses of slots could not be used."""
        self._table.mark(slots, POSE_REFUSED)

    def mark_doubtful(self, now: int) -> None:
        """Mark objects whose state is from the future, or older than one received before."""
        table = self._table
        table.judge(FUTURE, table.world_stamp > now + self.stamp_tolerance)
        if table.facts & (OVERTAKEN | HELD_BACK):
            since = now - table.received
            overtaken = table.has(OVERTAKEN) & (since <= self.order_timeout)
            table.judge(OVERTAKEN, overtaken)
            table.judge(HELD_BACK, overtaken & (since > self.order_timeout // 2))


@dataclass(frozen=True)
class AgeLimits:
    """After how long objects are stale, and how they are treated then.

    timeout: age limit (s) of objects from their second message on, 0 for none; timeouts: limits of
    objects by name, from the first message on; policy, policies: their treatment, by name. speed:
    maximum speed of any point of an object (m/s), where its last twist is slower; reach: maximum
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

    def __init__(
        self, scene: Scene, table: ObjectTable, states: States, placement: Placement
    ) -> None:
        self._scene, self._table, self._states, self._placement = scene, table, states, placement
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
        judged = table.facts & (STALE | IGNORED | LOST) or len(self._grown)
        if not (self._limits.timeout or self._limits.timeouts or judged):
            return
        since, limits = self._judged()
        placed = (table.condition & (LIVE | UNPLACED)) == LIVE
        stale = placed & (limits > 0) & (now - since > limits)
        if not (judged or stale.any()):
            return
        changed = np.flatnonzero(stale != table.has(STALE))
        table.judge(STALE, stale)
        if len(changed):
            gone = changed[stale[changed]]
            table.order[gone] = 0  # a restarted sender may begin anew
            table.speed[gone] = self._scene.objects.speeds_of(gone, table.last_twist[gone])
            self._placement.stop(gone)  # how they move is not known any more
        self._judge(self._grow(now - since))
        self._placement.enable(changed)

    def _judged(self) -> tuple[Slots, Slots]:
        """Return (rows,) since when states are known, and their age limits (ns), 0 for none.

        By the oldest of stamp, receipt and transform. An object that is locked to a
        frame and was sent once does not age itself, but its transform does.
        """
        table, most = self._table, int(self._limits.timeout * NANOSECONDS)
        since = self.known_since
        limits = np.where(table.limit < 0, table.repeated * most, table.limit)
        if table.carried.any():
            carried = table.carried > 0
            alone = carried & table.locked & (limits == 0)
            since = np.where(carried & ~alone, np.minimum(since, table.carried), since)
            since = np.where(alone, table.carried, since)
            limits = np.where(alone & (table.limit < 0), most, limits)
        return since, limits

    @property
    def known_since(self) -> Slots:
        """Return (rows,) since when states are known (ns), whatever placed them."""
        stamps, received = self._table.world_stamp, self._table.world_received
        if not self._states.by_stamp:
            return received
        since, unknown = np.minimum(stamps, received), stamps <= 0
        since[unknown] = received[unknown]
        return since

    def keep_ages(self, shift: int) -> None:
        """Keep ages that go by stamps, which mean nothing after a jump of the clock (ns)."""
        table, since = self._table, self.known_since
        older = (since < table.world_received) & ((table.carried == 0) | (since < table.carried))
        older &= ~table.has(WAITING) | (table.frame != 0)  # those have that of what they wait for
        table.carried[older] = since[older]
        carried = table.carried > 0
        table.carried[carried] = np.maximum(table.carried[carried] + shift, 1)

    def _look_up(self) -> None:
        """Give new objects their limit, -1 for that of all, and their policy."""
        table, limits = self._table, self._limits
        rows = np.flatnonzero(table.live & ~table.limited)
        table.limit[rows], table.policy[rows] = -1, POLICIES.index(limits.policy)
        table.limited[rows] = True
        if not (limits.timeouts or limits.policies):
            return
        for slot in rows.tolist():
            name = table.name(slot)
            timeout, policy = limits.timeouts.value(name), limits.policies.value(name)
            if timeout is not None:
                table.limit[slot] = int(timeout * NANOSECONDS)
            if policy is not None:
                table.policy[slot] = POLICIES.index(policy)

    def _grow(self, ages: Slots) -> Slots:
        """Grow stale objects by what they can have moved, and others no longer.

        ages: (rows,) of all states (ns). Returns those that can have moved farther than boxes grow.
        """
        table, limits = self._table, self._limits
        rows = np.flatnonzero(self._has(COLLIDE))
        if len(rows) == len(self._grown) == 0:
            return rows
        back = np.setdiff1d(self._grown[table.has(LIVE, self._grown)], rows)
        self._scene.objects.grow(back, np.zeros(len(back)))
        seconds = np.maximum(ages[rows], 0) / NANOSECONDS
        moved = np.maximum(table.speed[rows], limits.speed) * seconds
        self._scene.objects.grow(rows, np.minimum(np.nextafter(moved, np.inf), limits.reach))
        self._grown = rows
        return rows[moved > limits.reach]

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

"""Stored poses -> the scene: from their frame to the fixed one, in time or refused.

Of each object the newest state that can be placed is, as with tf2's MessageFilter: a transform that
is always a little late must not freeze an object. The latest state is in the table of objects;
those before it that are not placed yet are queued here. One that waits longer than the timeout is
counted as refused on the topic by which it came; the latest of an object is tried again now and
then, for its frame may become known at last.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.poses import as_poses, compose_poses
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.conversions import NANOSECONDS, unusable_poses
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import FrameTable, check_name
from obb_collision.node.objects.conditions import (
    ABSENT,
    FOLLOWING,
    IGNORED,
    LIVE,
    PLACED,
    PLACED_EARLIER,
    PLACED_TIRED,
    TIMED_OUT,
    TIRED,
    TIRED_OUT,
    UNPLACEABLE,
    UNPLACED,
    WAITING,
)
from obb_collision.node.objects.frames import (
    EXTRAPOLATION,
    LINK_NOT_KNOWN,
    FrameSource,
    LatestTransforms,
    Transforms,
)
from obb_collision.node.objects.table import ObjectTable, Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.placing import as_slice
from obb_collision.typing import Floats, Mask

States = npt.NDArray[Any]
"""Rows of ``STATE``."""

STATE = np.dtype(
    [
        ("slot", np.int64),
        ("number", np.int64),  # the later it came, the higher
        ("frame", np.int64),
        ("stamp", np.int64),
        ("received", np.int64),
        ("topic", np.int64),
        ("counted", np.bool_),  # as one that was not placed in time
        ("pose", np.float64, (7,)),
        ("twist", np.float64, (6,)),
    ]
)
MAX_WAITING = 100_000
"""Maximum number of states (15 MB): 10,000 objects at 50 Hz whose transform is 0.2 s late."""
LONGEST_LAG = 10 * NANOSECONDS
"""For so long (ns) a state waits for a transform that lags, though its object is late by then."""
MOST_LATE, MAX_LATE = 64, 20_000
"""Maximum number of states that are late by then, of an object and, at two or more each, of all."""


def latest_states(table: ObjectTable, slots: Slots) -> States:
    """Return the latest state of objects, as rows."""
    states = np.empty(len(slots), STATE)
    states["slot"], states["pose"] = slots, table.pose[slots]
    for column in ("number", "frame", "stamp", "received", "topic", "twist"):
        states[column] = getattr(table, column)[slots]
    states["counted"] = table.has(TIRED, slots)
    return states


def spaced(slots: Slots, received: Slots) -> Mask:
    """Return which states (n,), in the order of receipt, are to be kept, so that they are few.

    received: times within LONGEST_LAG of each other. Of an object with too many the oldest one in
    each span of time stays: that is placed some day, though newer ones keep coming.
    """
    _, which, counts = np.unique(slots, return_inverse=True, return_counts=True)
    most = min(max(MAX_LATE // max(len(counts), 1), 2), MOST_LATE)
    kept: Mask = counts[which] <= most
    if not kept.all():
        spans = received // (2 * LONGEST_LAG // most)
        kept[np.unique(np.column_stack((slots, spans)), axis=0, return_index=True)[1]] = True
    return kept


class WaitingStates:
    """States that could not be placed so far, in the order of receipt; ``most``: maximum rows."""

    def __init__(self, most: int = MAX_WAITING) -> None:
        self._most = most
        self._parts: list[States] = []
        self._count = 0

    def __len__(self) -> int:
        return self._count

    @property
    def rows(self) -> States:
        """All waiting states."""
        if len(self._parts) != 1:
            self._parts = [np.concatenate([np.empty(0, STATE), *self._parts])]
        return self._parts[0]

    @rows.setter
    def rows(self, states: States) -> None:
        self._parts, self._count = [states], len(states)

    def add(self, states: States) -> None:
        """Queue more states.

        Where they are too many, every other one of each object goes: the time they reach back,
        which decides whether there is a transform, stays.
        """
        self._parts.append(states)
        self._count += len(states)
        if self._count > self._most:
            kept = _every_other(self.rows)
            self.rows = kept[np.argsort(kept["number"], kind="stable")][-self._most :]


def _every_other(states: States) -> States:
    """Return every other state of each object, counted from the newest, and the oldest."""
    order = np.lexsort((-states["number"], states["slot"]))
    slots = states["slot"][order]
    starts = np.flatnonzero(np.append(True, slots[1:] != slots[:-1])[: len(slots)])
    ranks = np.arange(len(slots)) - np.repeat(starts, np.diff(np.append(starts, len(slots))))
    ends = np.append(starts[1:], len(slots)) - 1
    ranks[ends[ends >= 0]] = 0
    return states[order[ranks % 2 == 0]]


RETRY_PERIOD = NANOSECONDS // 2
"""How often the latest state of an object is tried again once it has waited too long."""


class Placement:
    """Moves objects to the poses stored in the table, and includes them in collisions."""

    def __init__(
        self,
        scene: Scene,
        table: ObjectTable,
        frame_table: FrameTable,
        frames: FrameSource,
        guard: Guard,
        monitors: Mapping[str, InputMonitor],
    ) -> None:
        self._scene, self._table, self._frames = scene, table, frames
        self._guard, self._monitors = guard, monitors
        self.frame_table = frame_table
        self.latest = LatestTransforms()
        self.topics = list(monitors)
        """Input topics: states have their indices."""
        self._next_retry = 0
        self._count = 0
        self.waiting = WaitingStates()
        self.timeout = 0.0
        """Maximum time that a pose waits for its frame (s)."""

    def frame_index(self, frame: str) -> int:
        """Return the index of a frame; an empty name means the fixed frame.

        Raises RefusedError ("bad name", "too many frames", "unknown frame").
        """
        if not (self._frames.waits or self.frame_table.is_fixed(frame)):
            check_name(frame, "frame")
            try:
                self._frames.lookup(frame, 0)
            except RefusedError as error:
                if error.reason != LINK_NOT_KNOWN:  # which may be known later
                    raise
        if self.frame_table.is_full and frame not in self.frame_table:
            self.forget_unused_frames()
        return self.frame_table.index(frame)

    def forget_unused_frames(self) -> None:
        """Make room in the table of frames."""
        frames = self._table.frame[self._table.live], self.waiting.rows["frame"]
        self.frame_table.keep_only(np.unique(np.concatenate(frames)).tolist())

    def supersede(self, slots: Slots, frame: int) -> int:
        """Queue the states of objects that are not placed yet: newer ones in a frame replace them.

        Not where both are in the fixed frame, for the newer one does not wait; returns how many
        states are dropped so.
        """
        table = self._table
        rows = as_slice(slots)
        wait = table.has(WAITING, rows)
        dropped = int(np.count_nonzero(wait))
        if dropped:
            wait = wait & ((table.frame[rows] != 0) | (frame != 0))
            wait &= ~table.locked[rows]
            dropped -= int(np.count_nonzero(wait))
        if wait.any():
            self.waiting.add(latest_states(table, np.unique(slots[wait])))
        self._count += 1
        table.number[rows] = self._count
        return dropped

    def begin(self, slots: Slots | int) -> None:
        """Initialise new objects: queued states of their slots belong to earlier objects."""
        self._table.number[slots] = self._table.world_number[slots] = self._count

    def place(self, now: int) -> None:
        """Place all objects whose pose is new or must be placed again."""
        table = self._table
        table.mark(np.flatnonzero(table.locked & table.live), FOLLOWING)
        rows = np.flatnonzero(table.has(WAITING))
        elsewhere = table.frame[rows] != 0
        slots, rows = rows[~elsewhere], rows[elsewhere]
        if len(slots):
            here = as_slice(slots)
            columns = table.stamp[here], table.received[here], table.number[here]
            try:  # by plain columns: twice as fast as by rows of states
                self._set(slots, table.pose[here], table.twist[here], columns)
            except Exception:
                self._move(latest_states(table, slots))
        if len(rows) or len(self.waiting):
            self._place(rows, now)

    def enable(self, slots: Slots) -> None:
        """Include objects in collisions or exclude them."""
        self._scene.objects.set_enabled(slots, self.takes_part(slots))

    def takes_part(self, slots: Slots) -> Mask:
        """Return which objects (n,) are to be checked."""
        return ~self._table.has(ABSENT | IGNORED, slots)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._next_retry = 0
        self.waiting.rows["received"] += shift
        self.latest.clock_jumped(shift)

    def stop(self, slots: Slots) -> None:
        """Set the twists of objects to zero."""
        table = self._table
        placed = slots[~table.has(WAITING, slots) | table.locked[slots]]
        table.twist[placed] = 0.0
        self._set_twists(slots, np.zeros((len(slots), 6)))

    def _place(self, rows: Slots, now: int) -> None:
        """Place states given in other frames: per object the newest one that can be placed."""
        table = self._table
        if now < self._next_retry:
            rows = rows[~table.has(TIRED, rows) | table.locked[rows]]
        elif table.has(TIRED, rows).any():
            self._next_retry = now + RETRY_PERIOD
        self._drop_superseded()
        both = self.waiting.rows, latest_states(table, rows)
        transforms = Transforms(self._frames, self.frame_table.name, self._guard)
        columns = [np.concatenate([part[name] for part in both]) for name in ("frame", "stamp")]
        can = np.split(transforms.reach(*columns), [len(both[0])])
        ready = np.concatenate([part[ok] for part, ok in zip(both, can, strict=True)])
        ready = ready[np.argsort(-ready["number"], kind="stable")]
        ready = ready[np.unique(ready["slot"], return_index=True)[1]]  # the newest of each object
        pairs = np.column_stack((ready["frame"], ready["stamp"]))
        groups, which = np.unique(pairs, axis=0, return_inverse=True)
        which = which.reshape(-1)  # numpy 2.0 gave it another shape
        for number, (frame, stamp) in enumerate(groups.tolist()):
            transform = transforms.get(frame, stamp) if frame else None
            states = ready[which == number]
            if transform is not None:
                outer, at = transform
                # the stamp of a state says when its transform was true
                since = 0 if stamp else self.latest.since(self.frame_table.name(frame), at, now)
                self._move(states, outer, since)
            elif frame == 0:
                self._move(states)
        self._drop_superseded()
        self._time_out(latest_states(table, rows[table.has(WAITING, rows)]), transforms, now)

    def _drop_superseded(self) -> None:
        """Drop states older than the one placed last, and those of removed objects."""
        table, states = self._table, self.waiting.rows
        slots = states["slot"]
        kept = table.has(LIVE, slots) & (states["number"] > table.world_number[slots])
        if not kept.all():
            self.waiting.rows = states[kept]

    def _time_out(self, latest: States, transforms: Transforms, now: int) -> None:
        """Count states that waited too long, and mark their objects, which were not placed in time.

        Where a transform lags some of them wait on: the object follows as late as its transform.
        """
        table, limit = self._table, int(self.timeout * NANOSECONDS)
        waiting = self.waiting.rows
        ages = now - waiting["received"]
        late = ages > limit
        if late.any():
            table.mark(waiting["slot"][late], TIMED_OUT)
            lags = [f for f, e in transforms.errors.items() if e.reason == EXTRAPOLATION]
            waits_on = ~late | (np.isin(waiting["frame"], lags) & (ages <= LONGEST_LAG))
            rows = np.flatnonzero(late & waits_on)
            waits_on[rows] = spaced(waiting["slot"][rows], waiting["received"][rows])
            late &= ~waiting["counted"]
            counted, waiting["counted"] = waiting[late], waiting["counted"] | late
            self.waiting.rows, waiting, late = waiting[waits_on], counted, late[late]
        slots = latest["slot"]
        tired = (now - latest["received"] > limit) | table.locked[slots]
        tired &= ~table.has(TIRED, slots)
        table.mark(slots[tired], TIRED_OUT)
        self._refuse(np.concatenate((waiting[late], latest[tired])), transforms.errors)

    def _refuse(self, states: States, errors: dict[int, RefusedError]) -> None:
        """Count states that could not be placed, and mark their objects."""
        table = self._table
        table.mark(states["slot"], TIMED_OUT)
        for frame, topic in np.unique(np.array([states["frame"], states["topic"]]), axis=1).T:
            alike = states[(states["frame"] == frame) & (states["topic"] == topic)]
            error = errors.get(int(frame)) or RefusedError("bad pose", "out of range once placed")
            name = table.name(int(alike["slot"][0]))
            monitor = self._monitors[self.topics[topic]]
            monitor.refuse(error.reason, name, error.detail, len(alike))

    def _move(self, states: States, outer: Floats | None = None, carried: int = 0) -> None:
        """Move objects to states, given in a frame that is at ``outer`` (7,).

        carried: when that was true (ns), 0 for none. A state that fails is refused alone.
        """
        try:
            poses, twists = (np.ascontiguousarray(states[name]) for name in ("pose", "twist"))
            if outer is not None:
                poses = compose_poses(outer, poses)
                usable = ~unusable_poses(poses)
                states, poses, twists = states[usable], poses[usable], twists[usable]
                if twists.any():  # given in a frame that stands still
                    turn = as_poses(outer[None], warn=False)[1][0].T
                    twists = np.hstack((twists[:, :3] @ turn, twists[:, 3:] @ turn))
            columns = states["stamp"], states["received"], states["number"]
            self._set(states["slot"], poses, twists, columns)
            if outer is not None:
                self._table.carried[states["slot"]] = carried
        except Exception as error:
            if len(states) > 1:
                for row in range(len(states)):
                    self._move(states[row : row + 1], outer, carried)
                return
            slot, frame, number = states[["slot", "frame", "number"]].tolist()[0]
            name = self._table.name(slot)
            if self._table.number[slot] <= number:
                self._table.mark(slot, UNPLACEABLE)
            self._table.world_number[slot] = number  # it is not tried again
            self._refuse(states, {frame: self._guard.refusal("placing objects", error, name)})

    def _set(self, slots: Slots, poses: Floats, twists: Floats, columns: Sequence[Slots]) -> None:
        """Move objects; columns: stamp, time of receipt and number of the states."""
        table, (stamps, received, numbers) = self._table, columns
        self._scene.objects.place(slots, poses)
        self._set_twists(slots, twists)
        rows = as_slice(slots)
        table.world_stamp[rows] = stamps
        table.world_received[rows] = received
        table.world_number[rows] = numbers
        new, newer = slots[table.has(UNPLACED, rows)], table.number[rows] > numbers
        if newer.any():
            tired = newer & table.has(TIRED, rows)
            table.mark(slots[~newer], PLACED)
            table.mark(slots[newer & ~tired], PLACED_EARLIER)
            table.mark(slots[tired], PLACED_TIRED)
        else:
            table.mark(rows, PLACED)
        if len(new):
            self.enable(new)

    def _set_twists(self, slots: Slots, twists: Floats) -> None:
        if len(slots) == 0 or not (twists.any() or self._table.moving.any()):
            return
        moving = twists.any(axis=1)
        changed = moving | self._table.moving[slots]
        if changed.any():
            self._scene.objects.set_twists(slots[changed], twists[changed])
            self._table.moving[slots] = moving

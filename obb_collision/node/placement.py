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

"""Stored poses -> the scene: from their frame to the fixed one, in time or refused."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from obb_collision.geometry.poses import as_poses
from obb_collision.node.conversions import (
    NANOSECONDS,
    FloatArray,
    compose_poses,
    name_from_key,
    pose_faults,
)
from obb_collision.node.errors import RefusedError
from obb_collision.node.frames import FrameSource
from obb_collision.node.names import FrameTable, check_name
from obb_collision.node.object_table import ObjectTable, Slots
from obb_collision.scene.scene import Scene

RETRY_PERIOD = NANOSECONDS // 2
"""How often a pose in a frame that is not known yet is tried again."""


class Placement:
    """Moves objects to the poses stored in the table.

    on_refused(reason, item, detail) hears of poses that could not be placed, on_placed(slot) of
    objects that have a place for the first time.
    """

    def __init__(
        self,
        scene: Scene,
        table: ObjectTable,
        frames: FrameSource,
        fixed_frame: str,
        on_refused: Callable[[str, str, str], None],
        on_placed: Callable[[int], None],
    ) -> None:
        self._scene, self._table, self._frames = scene, table, frames
        self.frame_table = FrameTable(fixed_frame, self._frames_used)
        self._on_refused, self._on_placed = on_refused, on_placed
        self._next_retry = 0
        self.timeout = 0.0
        """How long a pose may wait for its frame (s)."""

    def frame_index(self, frame: str) -> int:
        """Index of a frame; an empty one means the fixed frame.

        Raises RefusedError ("bad name", "too many frames", "unknown frame").
        """
        if not (self._frames.waits or self.frame_table.is_fixed(frame)):
            check_name(frame, "frame")
            self._frames.lookup(frame, 0)
        return self.frame_table.index(frame)

    def _frames_used(self) -> list[int]:
        table = self._table
        used: list[int] = np.unique(table.frame[table.live]).tolist()
        return used

    def place(self, now: int) -> None:
        """Bring all objects with a new pose, or one that is to be placed anew, to their place."""
        table = self._table
        table.pending |= table.live & table.locked
        rows = np.flatnonzero(table.pending)
        if rows.size:
            here = table.frame[rows] == 0
            self._move(rows[here], table.given[rows[here]], table.twist[rows[here]])
            if not here.all():
                self._place(rows[~here], now)

    def try_again(self) -> None:
        """Look up frames at the next cycle that were not known."""
        self._next_retry = 0

    def stop(self, slots: Slots) -> None:
        """Take the twists of objects away."""
        self._table.twist[slots] = 0.0
        self._set_twists(slots, self._table.twist[slots])

    def _place(self, rows: Slots, now: int) -> None:
        """Place poses given in other frames: one look-up for each frame and stamp."""
        table = self._table
        if now < self._next_retry:
            rows = rows[~table.frame_refused[rows] | table.locked[rows]]
        else:
            self._next_retry = now + RETRY_PERIOD
        pairs = np.column_stack((table.frame[rows], table.stamp[rows]))
        groups, which = np.unique(pairs, axis=0, return_inverse=True)
        which = which.reshape(-1)  # numpy 2.0 gave it another shape
        for number, (frame, stamp) in enumerate(groups.tolist()):
            members = rows[which == number]
            try:
                outer = self._frames.lookup(self.frame_table.name(frame), stamp)
                placed = compose_poses(outer, table.given[members])
                if any(fault.any() for fault in pose_faults(placed)):
                    raise RefusedError("bad pose", "out of range once placed")
                self._move(members, placed, turned_twists(table.twist[members], outer))
            except RefusedError as error:
                late = now - table.received[members] > int(self.timeout * NANOSECONDS)
                self._refuse(members[late | table.locked[members]], error)

    def _refuse(self, slots: Slots, error: RefusedError) -> None:
        for slot in slots[~self._table.frame_refused[slots]].tolist():
            self._on_refused(error.reason, name_from_key(self._table.key(slot)), error.detail)
        self._table.frame_refused[slots] = True

    def _move(self, slots: Slots, poses: FloatArray, twists: FloatArray) -> None:
        table = self._table
        self._scene.move_indices(slots, poses)
        self._set_twists(slots, twists)
        table.world[slots] = poses
        table.world_stamp[slots] = table.stamp[slots]
        table.pending[slots] = False
        table.frame_refused[slots] = False
        for slot in slots[~table.placed[slots]].tolist():
            table.placed[slot] = True
            self._on_placed(slot)

    def _set_twists(self, slots: Slots, twists: FloatArray) -> None:
        moving = twists.any(axis=1)
        changed = moving | self._table.moving[slots]
        if changed.any():
            self._scene.set_twists(slots[changed], twists[changed])
            self._table.moving[slots] = moving


def turned_twists(twists: FloatArray, frame: FloatArray) -> FloatArray:
    """Twists (n, 6) given in a frame that stands still, seen from where that frame is (7,)."""
    if not twists.any():
        return twists
    rotation = as_poses(frame[None])[1][0]
    return np.hstack((twists[:, :3] @ rotation.T, twists[:, 3:] @ rotation.T))

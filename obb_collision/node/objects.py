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

"""The objects of the node: they come, get poses, turn stale, expire and go.

Messages are stored here as they arrive (the latest state of an object wins); once a cycle
``update`` brings the scene up to date. An object whose latest state is refused, or that is stale,
keeps its last box and goes on colliding.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.shapes import Shape
from obb_collision.node.accuracy import Overrides
from obb_collision.node.conversions import NANOSECONDS, FloatArray, Key, name_from_key
from obb_collision.node.errors import RefusedError
from obb_collision.node.frames import FrameSource
from obb_collision.node.marker_shapes import Signature
from obb_collision.node.names import shortened
from obb_collision.node.object_table import NEVER, ObjectTable, Slots
from obb_collision.node.placement import Placement
from obb_collision.scene.scene import Scene

DEFAULT_LIMIT = 1000
MAX_UNPLACEABLE = 1000
"""Refused newcomers remembered, the latest ones: senders can't make the node grow."""


@dataclass(frozen=True)
class State:
    """Where poses come from: their frame, stamp (ns, 0: none) and time of receipt (ns)."""

    frame: str
    stamp: int
    received: int


class Objects:
    """Bookkeeping from keys to the scene.

    ``on_refused(reason, item, detail)`` hears of poses that could not be placed at a cycle.
    """

    def __init__(
        self,
        fixed_frame: str,
        frames: FrameSource,
        on_refused: Callable[[str, str, str], None],
    ) -> None:
        self.scene = Scene()
        self.table = ObjectTable()
        self.overrides = Overrides()
        self.unplaceable: dict[Key, str] = {}
        self.max_objects = DEFAULT_LIMIT
        self.ignore_stale = False
        self._signatures: dict[int, Signature] = {}
        self.placement = Placement(
            self.scene, self.table, frames, fixed_frame, on_refused, self._enable
        )

    def signature(self, key: Key) -> Signature | None:
        """Signature of the object's shape, None for an unknown object."""
        return self._signatures.get(self.table.slots.get(key, -1))

    def signatures(self, slots: Slots) -> list[Signature | None]:
        """Signatures of shapes by slot, None where there is no object."""
        return [self._signatures.get(slot) for slot in slots.tolist()]

    def note_signatures(self, slots: Slots, signatures: Iterable[Signature]) -> None:
        """Take note of the shapes that objects have now."""
        self._signatures.update(zip(slots.tolist(), signatures, strict=True))

    def is_old(self, key: Key, stamp: int) -> bool:
        """Whether a state with this stamp comes after a newer one of the same object."""
        slot = self.table.slots.get(key)
        return slot is not None and 0 < stamp < self.table.order[slot]

    def put(
        self,
        key: Key,
        shape: Shape | None,
        signature: Signature,
        expiry: int | None,
        padding: float | None = None,
    ) -> int:
        """Add an object, or give it a new shape (None keeps the one it has); returns its slot.

        ``expiry`` is when its lifetime ends (ns), None for never; ``padding`` in place of the
        scene's (m). A new object takes part once it has a pose. Raises RefusedError ("too many
        objects", "too many namespaces", "namespace number taken", "bad name", "bad shape").
        """
        table, name = self.table, name_from_key(key)
        slot = table.slots.get(key)
        if slot is None and len(table) >= self.max_objects:
            raise RefusedError("too many objects", f"{self.max_objects} is the limit")
        if slot is None:
            table.namespaces.admit(key[0])
        if shape is not None:
            try:
                pose = table.world[slot] if slot is not None and table.placed[slot] else None
                rung = self.overrides.rung(name)
                index = self.scene.add(name, shape, pose, padding=padding, accuracy=rung)
            except ValueError as error:
                raise RefusedError("bad shape", str(error)) from error
            if slot is None:
                table.claim(index, key, name)
            slot = index
            self._signatures[slot] = signature
            self._enable(slot)
        assert slot is not None
        table.expiry[slot] = NEVER if expiry is None else expiry
        table.shape_refused[slot] = table.seen[slot] = False
        self.forget_unplaceable(key)
        return slot

    def remove(self, key: Key) -> None:
        """Take an object out, if there is one."""
        self.forget_unplaceable(key)
        if key in self.table.slots:
            name = name_from_key(key)
            self._signatures.pop(self.table.release(key, name), None)
            self.scene.remove(name)

    def remove_all(self, namespace: str | None = None) -> int:
        """Take out all objects, of one namespace if given; returns how many there were."""
        keys = [key for key in self.table.slots if namespace in (None, key[0])]
        for key in keys:
            self.remove(key)
        self.forget_unplaceables(namespace)
        return len(keys)

    def forget_unplaceable(self, key: Key) -> None:
        """Forget that an object could not be added."""
        self.unplaceable.pop((shortened(key[0]), key[1]), None)

    def forget_unplaceables(self, namespace: str | None) -> None:
        """Forget which objects could not be added, all or those of a namespace."""
        shown = None if namespace is None else shortened(namespace)
        for key in [key for key in self.unplaceable if shown in (None, key[0])]:
            self.forget_unplaceable(key)

    def clear(self) -> int:
        """Take out all objects, and forget every name; returns how many objects there were."""
        count = self.remove_all()
        self.table.namespaces.forget_unused()
        self.placement.frame_table.forget_unused()
        return count

    def store_poses(
        self, slots: Slots, poses: FloatArray, state: State, twists: FloatArray | float = 0.0
    ) -> npt.NDArray[np.bool_]:
        """Store poses (n, 7) of slots (n,) for the next cycle; returns which were too old (n,).

        The poses are finite with quaternions that are not zero, the twists (n, 6) finite. Of rows
        for the same object the last one stays. Raises RefusedError ("unknown frame").
        """
        table, frame = self.table, self.placement.frame_index(state.frame)
        twists = np.broadcast_to(twists, (len(slots), 6))
        old = (table.order[slots] > state.stamp) & (state.stamp != 0)
        if old.any():
            slots, poses, twists = slots[~old], poses[~old], twists[~old]
        table.given[slots] = poses
        table.twist[slots] = twists
        table.frame[slots] = frame
        table.stamp[slots] = state.stamp
        if state.stamp:
            table.order[slots] = state.stamp
        table.received[slots] = state.received
        table.pending[slots] = True
        table.pose_refused[slots] = False
        table.frame_refused[slots] = False
        table.locked[slots] = False
        return old

    def lock(self, slot: int) -> None:
        """Place the stored pose anew every cycle, where its frame is then."""
        self.table.locked[slot] = self.table.frame[slot] != 0
        self.table.stamp[slot] = 0

    def refuse(self, key: Key, reason: str, shape: bool) -> None:
        """Mark that the latest state (shape or pose) of an object could not be used."""
        slot = self.table.slots.get(key)
        if slot is None:
            key = shortened(key[0]), key[1]
            self.unplaceable.pop(key, None)
            self.unplaceable[key] = reason
            if len(self.unplaceable) > MAX_UNPLACEABLE:
                del self.unplaceable[next(iter(self.unplaceable))]
        elif shape:
            self.table.shape_refused[slot] = True
        else:
            self.table.pose_refused[slot] = True

    def refuse_poses(self, slots: Slots) -> None:
        """Mark that the latest poses of slots could not be used."""
        self.table.pose_refused[slots] = True

    def forget_order(self, now: int) -> None:
        """After a jump of the clock: stamps and ages of before mean nothing any more."""
        self.table.order[:] = 0
        self.table.received[:] = now
        self.placement.try_again()

    def update(self, now: int, timeout: float) -> None:
        """Bring the scene up to date at time ``now`` (ns): expire, place, mark stale.

        ``timeout`` (s) is the age at which a state is stale, 0 for never.
        """
        table = self.table
        for slot in np.flatnonzero(table.live & table.seen & (table.expiry <= now)).tolist():
            self.remove(table.key(slot))
        self.placement.place(now)
        stale = table.live & table.placed & (timeout > 0)
        stale &= now - table.received > int(timeout * NANOSECONDS)
        changed = np.flatnonzero(table.live & (stale != table.stale))
        table.stale[:] = stale
        gone = changed[stale[changed]]
        table.order[gone] = 0  # a restarted sender may begin anew
        self.placement.stop(gone)  # nobody knows by now
        self.enable_many(changed)
        table.seen[:] = table.live  # whose lifetime is over has taken part once, at least

    def _enable(self, slot: int) -> None:
        enabled = self.table.placed[slot] and not (self.ignore_stale and self.table.stale[slot])
        self.scene.set_enabled(name_from_key(self.table.key(slot)), bool(enabled))

    def enable_many(self, slots: Slots) -> None:
        """Let objects take part in collisions, or not."""
        shown = self.table.placed[slots] & ~(self.ignore_stale & self.table.stale[slots])
        self.scene.set_enabled_indices(slots, shown)

    def set_ignore_stale(self, ignore: bool) -> None:
        """Whether stale objects take no part in collisions (they are still reported)."""
        self.ignore_stale = ignore
        self.enable_many(np.flatnonzero(self.table.live))

    def set_overrides(self, overrides: Overrides) -> None:
        """Give objects, those to come too, an accuracy of their own by their names."""
        self.overrides = overrides
        for name in self.table.by_name:
            self.scene.set_accuracy(name, overrides.rung(name))

    def newest_stamp(self, now: int) -> int:
        """Stamp (ns) of the newest state evaluated; time of receipt where none has a stamp."""
        table = self.table
        rows = table.live & table.placed
        if not rows.any():
            return now
        newest = int(table.world_stamp[rows].max())
        return newest or int(table.received[rows].max())

    @property
    def doubtful(self) -> npt.NDArray[np.bool_]:
        """(rows,) objects whose box is not known to be where it should be: shown grey."""
        table = self.table
        refused = table.shape_refused | table.pose_refused | table.frame_refused
        return table.live & (table.stale | refused)

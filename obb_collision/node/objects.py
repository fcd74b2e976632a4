"""The objects of the node: they come, get poses, turn stale, expire and go.

Messages are stored here as they arrive (the latest state of an object wins); once a cycle
``update`` brings the scene up to date. An object whose latest state is refused, or that is stale,
keeps its last box and goes on colliding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.shapes import Shape
from obb_collision.node.accuracy import Overrides
from obb_collision.node.conversions import (
    NANOSECONDS,
    FloatArray,
    Key,
    compose_poses,
    name_from_key,
    pose_faults,
)
from obb_collision.node.errors import RefusedError
from obb_collision.node.frames import FrameSource
from obb_collision.node.marker_shapes import Signature
from obb_collision.node.object_table import NEVER, ObjectTable, Slots
from obb_collision.scene.scene import Scene

RETRY_PERIOD = NANOSECONDS // 2
"""How often a pose in a frame that is not known yet is tried again."""
MAX_NAMES = 1000
"""Namespaces, frames and refused newcomers remembered: senders can't make the node grow."""


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
        self.max_objects = MAX_NAMES
        self.transform_timeout = 0.0
        self.ignore_stale = False
        self._signatures: dict[int, Signature] = {}
        self._frames = frames
        self._frame_names = [fixed_frame]
        self._on_refused = on_refused
        self._next_retry = 0

    def signature(self, key: Key) -> Signature | None:
        """Signature of the object's shape, None for an unknown object."""
        return self._signatures.get(self.table.slots.get(key, -1))

    def check_frame(self, frame: str) -> int:
        """Index of a frame; an empty one means the fixed frame.

        Raises RefusedError ("unknown frame") where it can't become known.
        """
        if frame in ("", self._frame_names[0]):
            return 0
        if not self._frames.waits:
            self._frames.lookup(frame, 0)
        if frame not in self._frame_names:
            if len(self._frame_names) >= MAX_NAMES:
                raise RefusedError("unknown frame", "too many frames")
            self._frame_names.append(frame)
        return self._frame_names.index(frame)

    def is_old(self, key: Key, stamp: int) -> bool:
        """Whether a state with this stamp comes after a newer one of the same object."""
        slot = self.table.slots.get(key)
        return slot is not None and 0 < stamp < self.table.order[slot]

    def put(self, key: Key, shape: Shape | None, signature: Signature, expiry: int | None) -> int:
        """Add an object, or give it a new shape (None keeps the one it has); returns its slot.

        ``expiry`` is when its lifetime ends (ns), None for never. A new object takes part once it
        has a pose. Raises RefusedError ("too many objects", "bad shape").
        """
        table, name = self.table, name_from_key(key)
        slot = table.slots.get(key)
        if slot is None and len(table) >= self.max_objects:
            raise RefusedError("too many objects", f"{self.max_objects} is the limit")
        if not table.knows_namespace(key[0]) and len(table.namespaces) >= MAX_NAMES:
            raise RefusedError("too many namespaces", f"{MAX_NAMES} is the limit")
        if shape is not None:
            try:
                pose = table.world[slot] if slot is not None and table.placed[slot] else None
                rung = self.overrides.rung(name)
                index = self.scene.add(name, shape, pose, accuracy=rung)
            except ValueError as error:
                raise RefusedError("bad shape", str(error)) from error
            if slot is None:
                table.claim(index, key, name)
            slot = index
            self._signatures[slot] = signature
            self._enable(slot)
        assert slot is not None
        table.expiry[slot] = NEVER if expiry is None else expiry
        table.shape_refused[slot] = False
        self.unplaceable.pop(key, None)
        return slot

    def remove(self, key: Key) -> None:
        """Take an object out, if there is one."""
        self.unplaceable.pop(key, None)
        if key in self.table.slots:
            name = name_from_key(key)
            self._signatures.pop(self.table.release(key, name), None)
            self.scene.remove(name)

    def remove_all(self, namespace: str | None = None) -> int:
        """Take out all objects, of one namespace if given; returns how many there were."""
        keys = [key for key in self.table.slots if namespace in (None, key[0])]
        for key in [*keys, *(key for key in self.unplaceable if namespace in (None, key[0]))]:
            self.remove(key)
        return len(keys)

    def store_poses(self, slots: Slots, poses: FloatArray, state: State) -> npt.NDArray[np.bool_]:
        """Store poses (n, 7) of slots (n,) for the next cycle; returns which were too old (n,).

        The poses are finite with quaternions that are not zero. Of rows for the same object the
        last one stays. Raises RefusedError ("unknown frame").
        """
        table, frame = self.table, self.check_frame(state.frame)
        old = (table.order[slots] > state.stamp) & (state.stamp != 0)
        if old.any():
            slots, poses = slots[~old], poses[~old]
        table.given[slots] = poses
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
            if len(self.unplaceable) < max(MAX_NAMES, self.max_objects):
                self.unplaceable[key] = reason
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
        self._next_retry = 0

    def update(self, now: int, timeout: float) -> None:
        """Bring the scene up to date at time ``now`` (ns): expire, place, mark stale.

        ``timeout`` (s) is the age at which a state is stale, 0 for never.
        """
        table = self.table
        for slot in np.flatnonzero(table.live & (table.expiry <= now)).tolist():
            self.remove(table.key(slot))
        table.pending |= table.live & table.locked
        rows = np.flatnonzero(table.pending)
        if rows.size:
            here = table.frame[rows] == 0
            self._move(rows[here], table.given[rows[here]])
            if not here.all():
                self._place(rows[~here], now)
        stale = table.live & table.placed & (timeout > 0)
        stale &= now - table.received > int(timeout * NANOSECONDS)
        changed = np.flatnonzero(table.live & (stale != table.stale))
        table.stale[:] = stale
        table.order[changed[stale[changed]]] = 0  # a restarted sender may begin anew
        for slot in changed.tolist():
            self._enable(slot)

    def _place(self, rows: Slots, now: int) -> None:
        """Place poses given in other frames: one look-up for each frame and stamp."""
        table = self.table
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
                outer = self._frames.lookup(self._frame_names[frame], stamp)
                placed = compose_poses(outer, table.given[members])
                if any(fault.any() for fault in pose_faults(placed)):
                    raise RefusedError("bad pose", "out of range once placed")
                self._move(members, placed)
            except RefusedError as error:
                late = now - table.received[members] > int(self.transform_timeout * NANOSECONDS)
                self._refuse_placed(members[late | table.locked[members]], error)

    def _refuse_placed(self, slots: Slots, error: RefusedError) -> None:
        for slot in slots[~self.table.frame_refused[slots]].tolist():
            self._on_refused(error.reason, name_from_key(self.table.key(slot)), error.detail)
        self.table.frame_refused[slots] = True

    def _move(self, slots: Slots, poses: FloatArray) -> None:
        table = self.table
        self.scene.move_indices(slots, poses)
        table.world[slots] = poses
        table.world_stamp[slots] = table.stamp[slots]
        table.pending[slots] = False
        table.frame_refused[slots] = False
        for slot in slots[~table.placed[slots]].tolist():
            table.placed[slot] = True
            self._enable(slot)

    def _enable(self, slot: int) -> None:
        enabled = self.table.placed[slot] and not (self.ignore_stale and self.table.stale[slot])
        self.scene.set_enabled(name_from_key(self.table.key(slot)), bool(enabled))

    def set_ignore_stale(self, ignore: bool) -> None:
        """Whether stale objects take no part in collisions (they are still reported)."""
        self.ignore_stale = ignore
        for slot in np.flatnonzero(self.table.live).tolist():
            self._enable(slot)

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

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

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from obb_collision.geometry.poses import unit_poses
from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    Key,
    far_from_unit,
    name_from_key,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import shortened
from obb_collision.node.messages.shape_plans import NO_BODY, Plan, Signature
from obb_collision.node.objects.frames import FrameSource
from obb_collision.node.objects.placement import OnItems, Placement
from obb_collision.node.objects.shape_requests import Given, ShapeRequests
from obb_collision.node.objects.table import NEVER, ObjectTable, Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.process import Limits
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.overrides import Overrides
from obb_collision.shapes import Box, Shape
from obb_collision.typing import Floats

DEFAULT_LIMIT = 1000
MAX_UNPLACEABLE = 1000
"""Refused newcomers remembered, the latest ones: senders can't make the node grow."""
OLDER = "older stamp"
"""Reason: a state came after one with a newer stamp."""
FAR = "quaternion far from unit length"
"""Doubt: its length is more than 0.1 off 1; it is normalised."""
AHEAD = "stamp from the future"
"""Doubt: a state's stamp is ahead of the node's clock by more than the tolerance."""
ANEW = "stamps began anew"
"""Doubt: a state is older than the one before, which came so long ago that its sender must have
started again."""

PLACEHOLDER = Box((1.0, 1.0, 1.0))
"""What an object is while its first shape is being built: it takes part in nothing till then."""
NO_SIGNATURE: Signature = ()


@dataclass(frozen=True)
class State:
    """Where poses come from: their frame, stamp (ns, 0: none), time of receipt (ns) and topic.

    Stamp and time of receipt are those of all poses, or arrays with one for each.
    """

    frame: str
    stamp: int | Slots
    received: int | Slots
    topic: str = "objects"


class Objects:
    """Bookkeeping from keys to the scene.

    ``on_refused`` hears of poses that could not be placed at a cycle, and of shapes that could not
    be built, ``on_doubted`` of poses that are used, but not trusted.
    """

    def __init__(
        self,
        fixed_frame: str,
        frames: FrameSource,
        on_refused: OnItems,
        on_doubted: OnItems,
        guard: Guard,
    ) -> None:
        self.scene = Scene()
        self.table = ObjectTable()
        self.overrides = Overrides()
        self.unplaceable: dict[Key, str] = {}
        self.max_objects = DEFAULT_LIMIT
        self.ignore_stale = False
        self.stamp_tolerance = NANOSECONDS // 2
        """Stamps further than this ahead of the node's clock (ns) are not believed."""
        self.order_timeout = NANOSECONDS
        """For how long after a state (ns) an older one is taken for late, not for a new start."""
        self._on_doubted = on_doubted
        self._unplaceable_until: dict[Key, int] = {}
        self._signatures: dict[int, Signature] = {}
        self._on_refused = on_refused
        self.builder = Builder()
        """Of shapes; built in another process."""
        self._tree_builder = Builder()
        self.trees = self.scene.build_outside(self._tree_builder)
        """What is built of shapes for an accuracy above obb."""
        self._requests = ShapeRequests(self.builder)
        self.placement = Placement(
            self.scene, self.table, frames, fixed_frame, on_refused, self.enable_many, guard
        )

    def signature(self, key: Key) -> Signature | None:
        """Signature of the shape that an object has, None for an unknown object."""
        return self._signatures.get(self.table.slots.get(key, -1))

    def signatures(self, slots: Slots) -> list[Signature | None]:
        """Signatures of shapes by slot, None where there is no object."""
        return [self._signatures.get(slot) for slot in slots.tolist()]

    def note_signatures(self, slots: Slots, signatures: Iterable[Signature]) -> None:
        """Take note of the shapes that objects have now."""
        self._signatures.update(zip(slots.tolist(), signatures, strict=True))
        self.table.shaped[slots] = True
        self.want_no_other(slots)

    def want_no_other(self, slots: Slots) -> None:
        """Let objects go on with the shapes they have: what is built for them is not wanted."""
        for slot in slots[self.table.shape_pending[slots]].tolist():
            self._requests.cancel(self.table.key(slot))
        self.table.shape_pending[slots] = False

    def find_late(
        self, slots: Slots, stamps: Slots | int, received: Slots | int
    ) -> npt.NDArray[np.bool_]:
        """Return which states (n,) come too late: soon after newer ones of their objects.

        Their objects are marked, and doubtful if nothing newer comes. Slot -1: a new object.
        """
        table = self.table
        late = (slots >= 0) & (stamps < table.order[slots]) & (np.asarray(stamps) > 0)
        late &= received - table.received[slots] <= self.order_timeout
        table.outdated[slots[late]] = True
        return late

    def take_shape(self, key: Key, plan: Plan, expiry: int | None) -> int:
        """Add an object by the plan of its shape, or give it that; returns its slot.

        A shape that takes time is built elsewhere. Till it is there a new object takes part in
        nothing and is unplaceable, one with a shape keeps that and is doubtful. ``expiry`` as in
        ``put``. Raises RefusedError with the reason where there is no such shape.
        """
        slot = self.table.slots.get(key)
        if self.signature(key) == plan.signature:
            self._requests.check_file(plan)
            return self.put(key, None, plan.signature, expiry)
        shape = plan.shape or self._requests.built(plan)
        if shape is not None:
            return self.put(key, shape, plan.signature, expiry)
        if slot is None:
            self._admit(key, slot)
        self._requests.request(key, plan)
        if slot is None:
            slot = self._give(key, PLACEHOLDER, NO_SIGNATURE, None)
            self.table.shaped[slot] = False
            self._enable(slot)
        self.table.shape_pending[slot] = True
        self._renew(key, slot, expiry)
        return slot

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
        slot = self.table.slots.get(key)
        self._admit(key, slot)
        if shape is not None:
            slot = self._give(key, shape, signature, padding)
        assert slot is not None
        self._requests.cancel(key)
        self.table.shape_pending[slot] = False
        self._renew(key, slot, expiry)
        return slot

    def _admit(self, key: Key, slot: int | None) -> None:
        if slot is None and len(self.table) >= self.max_objects:
            raise RefusedError("too many objects", f"{self.max_objects} is the limit")
        if slot is None:
            self.table.namespaces.admit(key[0])

    def _give(self, key: Key, shape: Shape, signature: Signature, padding: float | None) -> int:
        table, name = self.table, name_from_key(key)
        slot = table.slots.get(key)
        try:
            pose = table.world[slot] if slot is not None and table.placed[slot] else None
            level = self.overrides.level(name)
            index = self.scene.add(name, shape, pose, padding=padding, accuracy=level)
        except ValueError as error:
            raise RefusedError("bad shape", str(error)) from error
        if slot is None:
            table.claim(index, key, name)
            self.placement.begin(index)
        self._signatures[index] = signature
        table.shaped[index] = True
        self._enable(index)
        return index

    def _renew(self, key: Key, slot: int, expiry: int | None) -> None:
        self.table.expiry[slot] = NEVER if expiry is None else expiry
        self.table.shape_refused[slot] = self.table.seen[slot] = False
        self.forget_unplaceable(key)

    def _take_built(self) -> None:
        """Give objects the shapes that were built since the last cycle."""
        for given in self._requests.poll(self._users):
            if given.key not in self.table.slots:
                continue
            error = given.error
            if given.shape is not None:
                try:
                    self._give(given.key, given.shape, given.signature, None)
                except RefusedError as refused:
                    error = refused
            slot = self.table.slots[given.key]
            if given.newest:
                self.table.shape_pending[slot] = False
                if error is not None:
                    self._refuse_built(given, error, slot)

    def _refuse_built(self, given: Given, error: RefusedError, slot: int) -> None:
        self._on_refused("objects", error.reason, name_from_key(given.key), error.detail, 1)
        expiry = int(self.table.expiry[slot])
        if not self.table.shaped[slot]:
            self.remove(given.key)
        self.refuse(given.key, error.reason, True, expiry)

    def _users(self, signature: Signature) -> list[Key]:
        """Return the objects that have a shape."""
        slots = [slot for slot, known in self._signatures.items() if known == signature]
        return [self.table.key(slot) for slot in slots]

    def set_limits(self, limits: Limits, largest_file: int) -> None:
        """Limit what shapes may take to build, and the bytes of a mesh file."""
        self.builder.limits = self._tree_builder.limits = limits
        self._requests.largest_file = largest_file

    def close(self) -> None:
        """End the processes that build."""
        self.builder.close()
        self._tree_builder.close()

    def remove(self, key: Key) -> None:
        """Take an object out, if there is one."""
        slot = self.table.slots.get(key)
        if slot is None:
            self.forget_unplaceable(key)
        else:
            self.remove_slots(np.array([slot]))

    def remove_slots(self, slots: Slots) -> None:
        """Take out the objects at slots (n,), all in use and distinct."""
        for slot in slots[self.table.shape_pending[slots]].tolist():
            self._requests.cancel(self.table.key(slot))
        self.table.release_many(slots)
        for slot in slots.tolist():
            self._signatures.pop(slot, None)
        self.scene.remove_indices(slots)

    def remove_all(self, namespace: str | None = None) -> int:
        """Take out all objects, of one namespace if given; returns how many there were."""
        known = self.table.slots
        slots = [slot for key, slot in known.items() if namespace in (None, key[0])]
        self.remove_slots(np.array(slots, np.int64))
        self.forget_unplaceables(namespace)
        return len(slots)

    def forget_unplaceable(self, key: Key) -> None:
        """Forget that an object could not be added."""
        key = shortened(key[0]), key[1]
        self.unplaceable.pop(key, None)
        self._unplaceable_until.pop(key, None)

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
        self, slots: Slots, poses: Floats, state: State, twists: Floats | float = 0.0
    ) -> npt.NDArray[np.bool_]:
        """Store poses (n, 7) of slots (n,) for the next cycle; returns which were too old (n,).

        The poses are finite with quaternions that are not zero, the twists (n, 6) finite. Of rows
        for the same object the last one stays. Raises RefusedError ("unknown frame").
        """
        table, frame = self.table, self.placement.frame_index(state.frame)
        twists = np.broadcast_to(twists, (len(slots), 6))
        stamps = np.broadcast_to(state.stamp, len(slots))
        received = np.broadcast_to(state.received, len(slots))
        old = self._find_old(slots, stamps, received, state.topic)
        if old.any():
            slots, poses, twists = slots[~old], poses[~old], twists[~old]
            stamps, received = stamps[~old], received[~old]
        if len(slots) == 0:
            return old
        far = far_from_unit(poses)
        if far.any():
            self._doubt(FAR, slots[far], state.topic, "taken as normalised")
            poses = np.where(far[:, None], unit_poses(poses), poses)
        self.placement.supersede(slots, frame)
        table.given[slots] = poses
        table.twist[slots] = twists
        table.frame[slots] = frame
        table.stamp[slots] = stamps
        table.topic[slots] = self.placement.topic_index(state.topic)
        ahead = stamps - received
        doubted = ahead > self.stamp_tolerance
        if doubted.any():
            most = f"{ahead.max() / NANOSECONDS:.1f} s ahead of the node's clock"
            self._doubt(AHEAD, slots[doubted], state.topic, most)
        orders = ~doubted & (stamps != 0)
        table.order[slots[orders]] = stamps[orders]
        table.received[slots] = received
        table.outdated[slots] = False
        table.pending[slots] = True
        table.pose_refused[slots] = False
        table.locked[slots] = False
        return old

    def _find_old(
        self, slots: Slots, stamps: Slots, received: Slots, topic: str
    ) -> npt.NDArray[np.bool_]:
        """Return which states come too late (n,), and see which senders began anew."""
        old = self.find_late(slots, stamps, received)
        before = self.table.order[slots] - stamps
        anew = ~old & (before > 0) & (stamps != 0)
        if anew.any():
            most = f"{before[anew].max() / NANOSECONDS:.1f} s before the last one"
            self._doubt(ANEW, slots[anew], topic, most)
        return old

    def _doubt(self, reason: str, slots: Slots, topic: str, detail: str) -> None:
        name = name_from_key(self.table.key(int(slots[0])))
        self._on_doubted(topic, reason, name, detail, len(slots))

    def lock(self, slots: Slots) -> None:
        """Place the stored poses anew every cycle, where their frames are then."""
        self.table.locked[slots] = self.table.frame[slots] != 0
        self.table.stamp[slots] = 0

    def refuse(self, key: Key, reason: str, shape: bool, expiry: int = NEVER) -> None:
        """Mark that the latest state (shape or pose) of an object could not be used.

        ``expiry`` is when the lifetime of a new object would end (ns).
        """
        slot = self.table.slots.get(key)
        if slot is None:
            self.forget_unplaceable(key)
            if reason == NO_BODY:
                return
            key = shortened(key[0]), key[1]
            self.unplaceable[key] = reason
            if expiry != NEVER:
                self._unplaceable_until[key] = expiry
            if len(self.unplaceable) > MAX_UNPLACEABLE:
                self.forget_unplaceable(next(iter(self.unplaceable)))
        elif shape:
            self.table.shape_refused[slot] = True
        else:
            self.table.pose_refused[slot] = True

    def refuse_poses(self, slots: Slots) -> None:
        """Mark that the latest poses of slots could not be used."""
        self.table.pose_refused[slots] = True

    def clock_jumped(self, shift: int) -> None:
        """Take over a jump of the clock by ``shift`` (ns): ages and what is left of lifetimes stay.

        Stamps of before it mean nothing any more.
        """
        table = self.table
        table.received += shift
        table.world_received += shift
        table.expiry[table.expiry != NEVER] += shift
        for key in self._unplaceable_until:
            self._unplaceable_until[key] += shift
        table.order[:] = table.world_stamp[:] = 0
        self.placement.clock_jumped(shift)

    def update(self, now: int, timeout: float) -> None:
        """Bring the scene up to date at time ``now`` (ns): expire, place, mark stale.

        ``timeout`` (s) is the age at which a state is stale, 0 for never.
        """
        table = self.table
        self._expire(now)
        self._take_built()
        self.placement.place(now)
        stale = table.live & table.placed & (timeout > 0)
        stale &= now - table.world_received > int(timeout * NANOSECONDS)
        changed = np.flatnonzero(table.live & (stale != table.stale))
        table.stale[:] = stale
        gone = changed[stale[changed]]
        table.order[gone] = 0  # a restarted sender may begin anew
        self.placement.stop(gone)  # nobody knows by now
        self.enable_many(changed)
        table.seen[:] = table.live  # whose lifetime is over has taken part once, at least
        table.ahead[:] = table.placed & (table.world_stamp > now + self.stamp_tolerance)
        since = now - table.received
        table.outdated &= since <= self.order_timeout
        table.held_back[:] = table.outdated & (since > self.order_timeout // 2)

    def _expire(self, now: int) -> None:
        table = self.table
        self.remove_slots(np.flatnonzero(table.live & table.seen & (table.expiry <= now)))
        if self._unplaceable_until:
            gone = [key for key, expiry in self._unplaceable_until.items() if expiry <= now]
            for key in gone:
                self.forget_unplaceable(key)

    def _enable(self, slot: int) -> None:
        self.enable_many(np.array([slot]))

    def enable_many(self, slots: Slots) -> None:
        """Let objects take part in collisions, or not."""
        table = self.table
        shown = table.placed[slots] & table.shaped[slots]
        shown &= ~(self.ignore_stale & table.stale[slots])
        self.scene.set_enabled_indices(slots, shown)

    def set_ignore_stale(self, ignore: bool) -> None:
        """Whether stale objects take no part in collisions (they are still reported)."""
        self.ignore_stale = ignore
        self.enable_many(np.flatnonzero(self.table.live))

    def set_overrides(self, overrides: Overrides) -> None:
        """Give objects, those to come too, an accuracy of their own by their names."""
        self.overrides = overrides
        for name in self.table.by_name:
            self.scene.set_accuracy(name, overrides.level(name))

    def newest_stamp(self, now: int) -> int:
        """Stamp (ns) of the newest state evaluated; time of receipt where none has one to believe.

        ``now``, where there is no object.
        """
        table = self.table
        rows = self.visible
        if not rows.any():
            return now
        stamps = table.world_stamp[rows]
        newest = int(stamps.max(initial=0, where=stamps <= now + self.stamp_tolerance))
        return newest or int(table.world_received[rows].max())

    @property
    def visible(self) -> npt.NDArray[np.bool_]:
        """(rows,) objects with a box: their shape is known, and where they are."""
        return self.table.live & self.table.placed & self.table.shaped

    @property
    def doubtful(self) -> npt.NDArray[np.bool_]:
        """(rows,) objects whose box is not known to be where it should be: shown grey."""
        table = self.table
        refused = table.shape_refused | table.pose_refused | table.frame_refused
        doubts = table.stale | refused | table.ahead | table.held_back | table.shape_pending
        return table.live & doubts

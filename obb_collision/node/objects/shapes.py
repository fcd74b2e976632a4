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

"""The shapes of objects: set, changed, and awaited while they are built; of many by arrays."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import IDENTITY_POSE
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import ShapePlan, Signature
from obb_collision.node.objects.conditions import (
    ASIDE,
    FIRST_SHAPE_ASKED,
    LIVE,
    POSE_REFUSED,
    RENEWED,
    RESHAPED,
    SHAPE_ASKED,
    SHAPE_CONFIRMED,
    SHAPE_GIVEN,
    SHAPE_REFUSED,
    SHAPE_SETTLED,
    STALE,
    UNPLACED,
    UNSHAPED,
)
from obb_collision.node.objects.placement import Placement
from obb_collision.node.objects.refusals import Unplaceable
from obb_collision.node.objects.shape_requests import BuiltShape, ShapeRequests
from obb_collision.node.objects.table import COLUMNS, NO_TIME, ObjectTable, Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.jobs import BuildError
from obb_collision.scene.objects import local_boxes
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import Overrides
from obb_collision.scene.store.placing import placed
from obb_collision.scene.store.store import NO_ROWS
from obb_collision.shapes import Box, Cylinder, Ellipsoid, Shape
from obb_collision.typing import Floats, Mask
from obb_collision.words import MAX_OBJECT_NAME, check_names

DEFAULT_LIMIT = 1000
PLACEHOLDER = Box((1.0, 1.0, 1.0))
"""Stands for an object whose first shape is being built; it is not checked until then."""
NO_SIGNATURE: Signature = ()
KEPT = ("condition", "ns", "id", "serial", "kind", "size", "expiry")
"""Columns that are unchanged if an object is removed and added again with the same shape."""


class ObjectShapes:
    """Adds objects to scene and table, and takes them out."""

    def __init__(
        self,
        scene: Scene,
        table: ObjectTable,
        placement: Placement,
        guard: Guard,
        monitor: InputMonitor,
    ) -> None:
        self.scene, self.table, self.placement = scene, table, placement
        self._guard, self._monitor = guard, monitor
        self.unplaceable = Unplaceable()
        self.overrides: Overrides[Accuracy] = Overrides()
        self.max_objects = DEFAULT_LIMIT
        self.builder = Builder()
        """Builds in another process."""
        self.requests = ShapeRequests(self.builder)

    def put_planned(self, key: Key, plan: ShapePlan, expiry: int = NO_TIME) -> int:
        """Add an object, or change its shape, by the plan of the shape; returns its slot.

        A shape that takes time is built elsewhere. Till it is there a new object takes part in
        nothing and is unplaceable, one with a shape retains it and is doubtful. ``expiry`` as in
        ``put``. Raises RefusedError with the reason where there is no such shape.
        """
        slot = self.table.slots.get(key)
        if slot is not None and self.table.signature(key) == plan.signature:
            self.requests.check_file(plan)
            self.touch(np.array([slot]), expiry)
            return slot
        shape = plan.shape or self.requests.built(plan)
        if shape is not None:
            return self.put(key, shape, plan.signature, expiry)
        if slot is None:
            self._admit(key)
        self.requests.request(key, plan)
        if slot is None:
            slot = self._give(key, PLACEHOLDER, NO_SIGNATURE)
            self.table.mark(slot, FIRST_SHAPE_ASKED)
            self.placement.enable(np.array([slot]))
        else:
            self.table.mark(slot, SHAPE_ASKED)
        self._renew(np.array([slot]), expiry)
        return slot

    def put(
        self, key: Key, shape: Shape, signature: Signature = NO_SIGNATURE, expiry: int = NO_TIME
    ) -> int:
        """Add an object, or change its shape; returns its slot.

        ``expiry`` is when its lifetime ends (ns). A new object takes part once it has a pose.
        Raises RefusedError ("too many objects", "too many namespaces", "namespace number taken",
        "bad name", "bad shape").
        """
        if key not in self.table.slots:
            self._admit(key)
        slot = self._give(key, shape, signature)
        self.touch(np.array([slot]), expiry)
        return slot

    def put_new(self, keys: Sequence[Key], shapes: Sequence[Shape]) -> Slots:
        """Add objects of new keys, distinct; all or, on a RefusedError as of ``put``, none."""
        table, spaces = self.table, self.table.namespaces
        if not keys:
            return NO_ROWS
        if len(table) + len(keys) > self.max_objects:
            raise self._full
        numbers: dict[str, int] = {}
        try:
            for space in dict.fromkeys(space for space, _ in keys):
                number = spaces.admit(space)
                spaces.use(number)  # so that it stays till its objects are there
                numbers[space] = number
            slots = self._add_shapes([*map(name_from_key, keys)], shapes)
            rows = np.array([(numbers[space], ident) for space, ident in keys], np.int64)
            table.claim_many(slots, rows[:, 0], rows[:, 1])
        finally:
            for number in numbers.values():
                spaces.leave(number)
        self.placement.begin(slots)
        for slot in slots.tolist():
            table.note_signature(slot, NO_SIGNATURE)
        table.mark(slots, SHAPE_GIVEN)
        self.placement.enable(slots)
        self.touch(slots, NO_TIME)
        return slots

    def _add_shapes(self, names: list[str], shapes: Sequence[Shape]) -> Slots:
        """Add shapes to the scene, and return their slots."""
        center, rotation, halves = map(np.concatenate, zip(*map(local_boxes, shapes), strict=True))
        poses = np.tile(IDENTITY_POSE, (len(names), 1))
        try:
            check_names(names, "name", MAX_OBJECT_NAME)
            self.table.reach(len(self.scene) + len(names))
            levels = [self.overrides.value(name) for name in names]
            columns = placed((center, rotation, halves), poses)
            return self.scene.objects.put(names, halves, columns, levels, shapes)
        except ValueError as error:
            raise RefusedError("bad shape", str(error)) from error

    def _admit(self, key: Key) -> None:
        """Make room for a new object, or refuse it."""
        if len(self.table) >= self.max_objects:
            raise self._full
        self.table.namespaces.admit(key[0])

    @property
    def _full(self) -> RefusedError:
        return RefusedError("too many objects", f"{self.max_objects} is the limit")

    @contextmanager
    def room(
        self,
        new: Mask,
        groups: Slots,
        admit: Callable[[int], int],
        refuse: Callable[[Mask, RefusedError], None],
    ) -> Iterator[Mask]:
        """Make room for the new objects among (n,), and yield which objects have room.

        groups (n,): namespaces; admit: takes one and returns its number, or raises RefusedError;
        refuse: takes those (n,) that are refused for a reason.
        """
        names, admitted, numbers = self.table.namespaces, np.ones(len(new), np.bool_), []
        refused: dict[str, tuple[RefusedError, list[int]]] = {}
        for group in np.unique(groups[new]).tolist():
            try:
                numbers.append(admit(group))
                names.use(numbers[-1])  # so that it stays till its objects are there
            except RefusedError as error:
                refused.setdefault(error.reason, (error, []))[1].append(group)
        for fault, several in refused.values():
            bad = new & np.isin(groups, several)
            refuse(bad, fault)
            admitted &= ~bad
        surplus = np.flatnonzero(new & admitted)[max(0, self.max_objects - len(self.table)) :]
        if len(surplus):
            admitted[surplus] = False
            refuse(np.isin(np.arange(len(new)), surplus), self._full)
        try:
            yield admitted
        finally:
            for number in numbers:
                names.leave(number)

    def _give(self, key: Key, shape: Shape, signature: Signature) -> int:
        table, name = self.table, name_from_key(key)
        slot = table.slots.get(key)
        pose = None
        if slot is not None and not table.has(UNPLACED, slot):
            pose = self.scene.objects.poses_of([slot])[0]
        try:
            level = self.overrides.value(name)
            table.reach(len(self.scene) + 1)
            index = self.scene.add(name, shape, pose, accuracy=level)
        except ValueError as error:
            raise RefusedError("bad shape", str(error)) from error
        if slot is None:
            table.claim(index, key)
            self.placement.begin(index)
        table.note_signature(index, signature)
        table.mark(index, SHAPE_GIVEN)
        self.placement.enable(np.array([index]))
        return index

    def touch(self, slots: Slots, expiry: Slots | int) -> None:
        """Extend objects to their new expiry (n,) with the shapes that they have."""
        self.cancel_pending(slots)
        self._renew(slots, expiry)

    def _renew(self, slots: Slots, expiry: Slots | int) -> None:
        self.table.expiry[slots], self.table.seen[slots] = expiry, False
        self.table.mark(slots, SHAPE_CONFIRMED)
        for key in self.table.keys(slots) if self.unplaceable else ():
            self.unplaceable.delete(key)

    def cancel_pending(self, slots: Slots) -> None:
        """Continue with the present shapes of objects: cancel those being built for them."""
        waiting = slots[self.table.has(RESHAPED, slots)]
        for slot in waiting.tolist():
            self.builder.cancel(self.table.key(slot))
        self.table.mark(waiting, SHAPE_SETTLED)

    def refuse(self, key: Key, reason: str, shape: bool, expiry: int = NO_TIME) -> None:
        """Mark that the latest state (shape or pose) of an object could not be used.

        ``expiry`` is when the lifetime of that state would end (ns): until then it is there.
        """
        slot = self.table.slots.get(key)
        if slot is None:
            self.unplaceable.add(key, reason, expiry)
            return
        self.table.expiry[slot] = max(int(self.table.expiry[slot]), expiry)
        self.table.mark(slot, SHAPE_REFUSED if shape else POSE_REFUSED)

    def remove(self, slots: Slots) -> None:
        """Remove the objects at slots (n,), all in use and distinct."""
        if len(slots):
            self.release(slots)
            self.scene.objects.remove(slots)

    def strangers(self) -> Slots:
        """Return the slots of objects that the scene has and the table has not.

        They are about to be removed, or are left by a change that failed halfway: the scene gets
        objects first, and loses them last.
        """
        if len(self.scene) == len(self.table):
            return NO_ROWS
        indices = self.scene.indices
        return indices[~self.table.has(LIVE, indices)]

    def release(self, slots: Slots) -> None:
        """Remove the objects at slots (n,), all in use and distinct, but not from the scene.

        What the table has no object for must be removed there, or replaced, before a check.
        """
        self.cancel_pending(slots)
        self.table.release_many(slots)

    def readd(self, slots: Slots) -> None:
        """Take objects out and put them in again where they are, with the shapes they have."""
        if len(slots) == 0:
            return
        table = self.table
        self.cancel_pending(slots)
        left_out = slots[table.has(STALE | ASIDE, slots)]
        for column in COLUMNS:
            if column not in KEPT:
                getattr(table, column)[slots] = 0
        table.mark(slots, RENEWED)
        table.repeated[slots] = True  # this message is not the first one about them
        self.placement.begin(slots)
        self.scene.objects.renew(slots)
        self.placement.enable(left_out)

    def put_primitives(
        self,
        keys: tuple[Slots, Slots],
        kinds: Slots,
        sizes: Floats,
        poses: Floats,
        expiry: Slots | int = NO_TIME,
        instead: Slots = NO_ROWS,
    ) -> Slots:
        """Add CUBE, SPHERE and CYLINDER of edge lengths (n, 3), or give objects those shapes.

        keys: numbers of namespaces and ids (n,), all distinct; the namespaces are admitted, and
        there is room for new objects. kinds (n,): types of markers; poses (n, 7), finite, of which
        new objects get theirs; expiry (n,) as in the table; instead: slots of the scene that the
        table has released, for boxes that come. Returns their slots; all or, on a RefusedError
        ("bad shape"), none.
        """
        table, scene = self.table, self.scene
        slots = table.find(*keys)
        new = slots < 0
        table.reach(len(scene) + len(slots))  # so that the table can take what the scene gets
        cubes, were_cubes = kinds == Marker.CUBE, ~new & (table.kind[slots] == Marker.CUBE)
        here, fresh = np.flatnonzero(cubes & were_cubes), np.flatnonzero(cubes & new)
        other = np.flatnonzero(~(cubes & (new | were_cubes)))
        if len(other):
            names, levels = self._names(keys, other)
            bodies = slots[other], kinds[other], sizes[other]
            slots[other] = self._put_bodies(names, levels, bodies)
        if len(here):
            scene.objects.resize_boxes(slots[here], sizes[here])
        if len(fresh):
            names, levels = self._names(keys, fresh)
            boxes = names, sizes[fresh], poses[fresh]
            slots[fresh] = scene.objects.begin_boxes(*boxes, levels, instead)
        table.claim_many(slots[new], *(numbers[new] for numbers in keys))
        self.placement.begin(slots[new])
        table.note_primitives(slots, kinds, sizes)
        table.mark(slots, SHAPE_GIVEN)
        self.placement.enable(slots)
        self.touch(slots, expiry)
        return slots

    def _put_bodies(
        self,
        names: list[str],
        levels: list[Accuracy | None] | None,
        columns: tuple[Slots, Slots, Floats],
    ) -> Slots:
        """Add objects that are not boxes, or change them; return their slots.

        columns: slots, -1 for new objects, kinds and sizes.
        """
        slots, kinds, sizes = columns
        poses = np.zeros((len(slots), 7))
        poses[:, 6] = 1.0
        placed = slots >= 0
        placed[placed] = ~self.table.has(UNPLACED, slots[placed])
        poses[placed] = self.scene.objects.poses_of(slots[placed])
        try:
            kinds_and_sizes = zip(kinds.tolist(), sizes.tolist(), strict=True)
            bodies = [_body(kind, size) for kind, size in kinds_and_sizes]
            return self.scene.add_boxes(names, sizes, poses, levels, bodies)
        except ValueError as error:
            raise RefusedError("bad shape", str(error)) from error

    def _names(
        self, keys: tuple[Slots, Slots], rows: Slots
    ) -> tuple[list[str], list[Accuracy | None] | None]:
        """Return the names of objects by their keys, and their accuracies if any has its own."""
        texts, namespaces, ids = self.table.namespaces.names, keys[0][rows], keys[1][rows]
        if (namespaces == namespaces[0]).all():  # as most senders have it: half the time
            text = texts[int(namespaces[0])]
            names = [f"{text}/{ident}" for ident in ids.tolist()]
        else:
            pairs = zip(namespaces.tolist(), ids.tolist(), strict=True)
            names = [f"{texts[number]}/{ident}" for number, ident in pairs]
        return names, [self.overrides.value(name) for name in names] if self.overrides else None

    def use_built(self) -> None:
        """Give objects the shapes that were built since the last cycle."""
        for built in self.requests.poll():
            for key in self._waiting_for(built):
                self._use_built(key, built)

    def _waiting_for(self, built: BuiltShape) -> list[Key]:
        if built.keys is not None:
            return [key for key in built.keys if key in self.table.slots]
        signatures = self.table.signatures.items()
        keys = [
            self.table.key(slot) for slot, signature in signatures if signature == built.signature
        ]
        return [key for key in keys if not self.builder.wants(key)]

    def _use_built(self, key: Key, built: BuiltShape) -> None:
        error: BuildError | RefusedError | None = built.error
        if built.shape is not None:
            try:
                self._give(key, built.shape, built.signature)
            except Exception as failure:  # of this object: others get theirs
                error = self._guard.refusal("shapes", failure, name_from_key(key))
        slot = self.table.slots[key]
        if self.builder.wants(key):  # for a newer shape
            return
        self.table.mark(slot, SHAPE_SETTLED)
        if error is not None:
            self._monitor.refuse(error.reason, name_from_key(key), error.detail)
            expiry = int(self.table.expiry[slot])
            if self.table.has(UNSHAPED, slot):
                self.remove(np.array([slot]))
            self.refuse(key, error.reason, True, expiry)


def _body(kind: int, size: list[float]) -> Shape | None:
    """Return the shape of a marker, None for a box: that of ``plan_shape``, but unchecked."""
    x, y, z = size
    if kind == Marker.SPHERE:
        return Ellipsoid.trusted(radii=(0.5 * x, 0.5 * y, 0.5 * z))
    if kind == Marker.CYLINDER:
        return Cylinder.trusted(radius=0.5, length=1.0, scale=(x, y, z))
    return None

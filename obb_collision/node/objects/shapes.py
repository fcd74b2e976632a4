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

"""The shapes of objects: set, changed, and awaited while they are built."""

from __future__ import annotations

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.shape_plans import Plan, Signature
from obb_collision.node.objects.conditions import (
    FIRST_SHAPE_ASKED,
    LIVE,
    POSE_REFUSED,
    RESHAPED,
    SHAPE_ASKED,
    SHAPE_CONFIRMED,
    SHAPE_GIVEN,
    SHAPE_REFUSED,
    SHAPE_SETTLED,
    UNPLACED,
    UNSHAPED,
)
from obb_collision.node.objects.notes import Notes
from obb_collision.node.objects.placement import Placement
from obb_collision.node.objects.shape_requests import Given, ShapeRequests
from obb_collision.node.objects.table import NEVER, ObjectTable, Slots
from obb_collision.node.objects.unplaceable import Unplaceable
from obb_collision.node.runtime.guard import INTERNAL_ERROR
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.overrides import Overrides
from obb_collision.scene.store.store import NO_ROWS
from obb_collision.shapes import Box, Shape

DEFAULT_LIMIT = 1000
PLACEHOLDER = Box((1.0, 1.0, 1.0))
"""Stands for an object whose first shape is being built; it is not checked until then."""
NO_SIGNATURE: Signature = ()


class ObjectShapes:
    """Adds objects to scene and table, and takes them out."""

    def __init__(
        self,
        scene: Scene,
        table: ObjectTable,
        placement: Placement,
        notes: Notes,
    ) -> None:
        self.scene, self.table, self.placement, self._notes = scene, table, placement, notes
        self.unplaceable = Unplaceable()
        self.overrides: Overrides[Accuracy] = Overrides()
        self.max_objects = DEFAULT_LIMIT
        self.builder = Builder()
        """Builds in another process."""
        self.requests = ShapeRequests(self.builder)

    def take(self, key: Key, plan: Plan, expiry: int | None) -> int:
        """Add an object by the plan of its shape, or give it that; returns its slot.

        A shape that takes time is built elsewhere. Till it is there a new object takes part in
        nothing and is unplaceable, one with a shape retains it and is doubtful. ``expiry`` as in
        ``put``. Raises RefusedError with the reason where there is no such shape.
        """
        slot = self.table.slots.get(key)
        if self.table.signature(key) == plan.signature:
            self.requests.check_file(plan)
            return self.put(key, None, plan.signature, expiry)
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
        self._renew(key, slot, expiry)
        return slot

    def put(
        self,
        key: Key,
        shape: Shape | None,
        signature: Signature,
        expiry: int | None,
    ) -> int:
        """Add an object, or change its shape (None: unchanged); returns its slot.

        ``expiry`` is when its lifetime ends (ns), None for never. A new object takes part once it
        has a pose. Raises RefusedError ("too many objects", "too many namespaces", "namespace
        number taken", "bad name", "bad shape").
        """
        slot = self.table.slots.get(key)
        if slot is None:
            self._admit(key)
        if shape is not None:
            slot = self._give(key, shape, signature)
        assert slot is not None
        self.requests.cancel(key)
        self.table.mark(slot, SHAPE_SETTLED)
        self._renew(key, slot, expiry)
        return slot

    def _admit(self, key: Key) -> None:
        """Make room for a new object, or refuse it."""
        if len(self.table) >= self.max_objects:
            raise RefusedError("too many objects", f"{self.max_objects} is the limit")
        self.table.namespaces.admit(key[0])

    def _give(self, key: Key, shape: Shape, signature: Signature) -> int:
        table, name = self.table, name_from_key(key)
        slot = table.slots.get(key)
        pose = None
        if slot is not None and not table.has(UNPLACED, slot):
            pose = self.scene.poses_of([slot])[0]
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

    def _renew(self, key: Key, slot: int, expiry: int | None) -> None:
        self.table.expiry[slot] = NEVER if expiry is None else expiry
        self.table.mark(slot, SHAPE_CONFIRMED)
        self.table.seen[slot] = False
        self.unplaceable.forget(key)

    def cancel_pending(self, slots: Slots) -> None:
        """Continue with the present shapes of objects: cancel what is being built for them."""
        waiting = slots[self.table.has(RESHAPED, slots)]
        for slot in waiting.tolist():
            self.requests.cancel(self.table.key(slot))
        self.table.mark(waiting, SHAPE_SETTLED)

    def refuse(self, key: Key, reason: str, shape: bool, expiry: int = NEVER) -> None:
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
            self.scene.remove_indices(slots)

    def strangers(self) -> Slots:
        """Return the slots of the scene that the table has no object for.

        They are to be removed, or a change has left them that broke off: the scene gets objects
        first, and loses them last.
        """
        if len(self.scene) == len(self.table):
            return NO_ROWS
        there = self.scene.indices
        return there[~self.table.has(LIVE, there)]

    def release(self, slots: Slots) -> None:
        """Remove the objects at slots (n,), all in use and distinct, but not from the scene.

        What the table has no object for must be removed there, or replaced, before a check.
        """
        self.cancel_pending(slots)
        self.table.release_many(slots)

    def take_built(self) -> None:
        """Give objects the shapes that were built since the last cycle."""
        for given in self.requests.poll():
            for key in self._waiting_for(given):
                self._take_built(key, given)

    def _waiting_for(self, given: Given) -> list[Key]:
        if given.keys is not None:
            return [key for key in given.keys if key in self.table.slots]
        signatures = self.table.signatures.items()
        keys = [self.table.key(slot) for slot, known in signatures if known == given.signature]
        return [key for key in keys if not self.requests.is_waiting(key)]

    def _take_built(self, key: Key, given: Given) -> None:
        error = given.error
        if given.shape is not None:
            try:
                self._give(key, given.shape, given.signature)
            except RefusedError as refused:
                error = refused
            except Exception as failure:  # of this object: others get theirs
                self.placement.guard.caught("shapes", failure, name_from_key(key))
                error = RefusedError(INTERNAL_ERROR, str(failure))
        slot = self.table.slots[key]
        if self.requests.is_waiting(key):  # for a newer shape
            return
        self.table.mark(slot, SHAPE_SETTLED)
        if error is not None:
            self._notes.refuse("objects", error.reason, name_from_key(key), error.detail)
            expiry = int(self.table.expiry[slot])
            if self.table.has(UNSHAPED, slot):
                self.remove(np.array([slot]))
            self.refuse(key, error.reason, True, expiry)

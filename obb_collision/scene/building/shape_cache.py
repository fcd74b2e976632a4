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

"""Trees and hulls of a scene's shapes: built once per shape, when first needed.

One thread requests and drops them; another may add to the pools meanwhile (see ``outside``).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any, Generic, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.shapes.primitives import Box, Capsule, Shape, Sphere
from obb_collision.geometry.trees.clouds import Cloud
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import (
    Body,
    HullPool,
    Hulls,
    HullTreePool,
    Item,
    Pool,
    TreePool,
)
from obb_collision.obb import OBB
from obb_collision.queries.convex.support import NO_HULLS, core_of
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Mask, Rows

#: Kinds of shapes: decided by their boxes only, boxes, spheres and capsules, other convex shapes,
#: triangles, clouds.
BOXED, BOX, ROUND, CONVEX, TRIANGLES, CLOUD = range(6)


def kind_of(shape: Shape | OBB) -> int:
    """Return the kind of a shape; a Mesh without faces has no triangles."""
    if isinstance(shape, (Box, OBB)):
        return BOX
    if isinstance(shape, Mesh):
        return TRIANGLES if len(shape.faces) else BOXED
    if isinstance(shape, Cloud):
        return CLOUD
    is_round = isinstance(shape, (Sphere, Capsule)) and len(set(shape.scale)) == 1
    return ROUND if is_round else CONVEX


class TimeLeft(Protocol):
    """A budget, or another limit of time."""

    def left(self) -> float:
        """Return the seconds that are left."""


#: Queried bodies whose trees and hulls are retained.
RETAINED = 16


@dataclass(eq=False)
class Entry(Generic[Item]):
    """The tree or hull (item) of a shape, shared by slots, and its row in the pool.

    row: -1 until the item is built.
    """

    key: Hashable
    slots: set[int] = field(default_factory=set)
    item: Item | None = None
    row: int = -1


class PerShape(Generic[Item]):
    """Trees, or hulls, in one pool: slots with equal shapes share an entry."""

    def __init__(self, kind: type[Pool[Item]]) -> None:
        self.pool = kind()
        self.ready: dict[Hashable, Item] = {}  # by key, from another cache
        self._entries: dict[Hashable, Entry[Item]] = {}
        self.by_slot: dict[int, Entry[Item]] = {}
        self._rows = np.full(0, -1)  # by slot
        self._retained: deque[Entry[Item]] = deque()

    def __len__(self) -> int:
        return len(self._entries)

    def rows(self, slots: Rows) -> Rows:
        """Return the row (k,) of each slot's item in the pool, -1 until it is built."""
        result = np.full(len(slots), -1)
        inside = slots < len(self._rows)
        result[inside] = self._rows[slots[inside]]
        return result

    def entry(self, slot: int, key: Hashable) -> Entry[Item]:
        """Return the entry of a slot, which it shares with all slots of the same key."""
        short = max(0, slot + 1 - len(self._rows))
        if short:
            self._rows = np.append(self._rows, np.full(max(short, len(self._rows)), -1))
        entry = self.by_slot.get(slot) or self._entries.setdefault(key, Entry(key))
        self.by_slot[slot] = entry  # first, so that the slot can be dropped
        entry.slots.add(slot)
        self._rows[slot] = entry.row
        return entry

    def drop(self, slot: int) -> Entry[Item] | None:
        """Drop the item of a slot; return its entry, which has no slots if no other shares it."""
        entry = self.by_slot.get(slot)
        if entry is not None:
            self._rows[slot] = -1
            entry.slots.discard(slot)
            self._forget(entry)
            del self.by_slot[slot]
        return entry

    def retain(self, slot: int) -> None:
        """Retain the item of a slot after it is dropped, as one of the last ``RETAINED``."""
        entry = self.by_slot.get(slot)
        if entry is not None and entry not in self._retained:
            self._retained.append(entry)
            if len(self._retained) > RETAINED:
                self._forget(self._retained.popleft())

    def clear(self, pool: Pool[Item]) -> None:
        """Start with an empty pool, once no slot has an entry; drop the retained ones."""
        self._retained.clear()
        self._entries.clear()
        self.pool = pool

    def _forget(self, entry: Entry[Item]) -> None:
        if not entry.slots and entry not in self._retained:
            self._entries.pop(entry.key, None)

    def put(self, entry: Entry[Item], item: Item, row: int) -> None:
        """Set the item of an entry, and its row in the pool for all slots of the entry."""
        entry.item, entry.row = item, row
        self._rows[list(entry.slots)] = row

    def build(self, slots: Rows, body_of: Callable[[int], Body], timer: TimeLeft | None) -> bool:
        """Build missing items of slots, while there is time; return whether any were missing.

        With a timer nothing is built while another thread adds an item.
        """
        missing = slots[self.rows(slots) < 0]
        if len(missing) == 0 or (timer is not None and self.pool.lock.locked()):
            return False
        with self.pool.lock:
            for slot in np.unique(missing).tolist():
                if timer is not None and timer.left() <= 0.0:
                    break
                body = body_of(slot)
                entry = self.entry(slot, body.tobytes() if isinstance(body, np.ndarray) else body)
                if entry.row < 0:
                    item = self.ready.get(entry.key) or self.pool.built(body)
                    self.put(entry, item, self.pool.append(item))
        return True

    @property
    def built(self) -> dict[Entry[Item], Item]:
        """The items in use, by entry."""
        entries = self._entries.values()
        return {entry: entry.item for entry in entries if entry.item is not None}

    @property
    def size(self) -> int:
        """Number of triangles of trees in use, or of blocks of corners of hulls."""
        return sum(map(self.pool.size_of, self.built.values()))

    @property
    def is_wasteful(self) -> bool:
        """Whether more than half of the pool is unused."""
        return 2 * self.size < self.pool.size

    def packed(self, built: dict[Entry[Item], Item]) -> Packed[Item]:
        """Return a new pool of items; from any thread."""
        pool = type(self.pool)()
        return pool, {entry: pool.append(item) for entry, item in built.items()}

    def lacks(self, packed: Packed[Item]) -> int:
        """Return the ``size`` of the items in use that a new pool lacks."""
        return sum(self.pool.size_of(item) for e, item in self.built.items() if e not in packed[1])

    def exchange(self, packed: Packed[Item] | None = None) -> None:
        """Take a packed pool, by default a new one, and add the items that it lacks."""
        built = self.built
        pool, rows = self.packed({}) if packed is None or not built else packed
        rows = {e: rows[e] if e in rows else pool.append(item) for e, item in built.items()}
        table = self._rows.copy()
        for entry, row in rows.items():
            table[list(entry.slots)] = row
        self.pool, self._rows = pool, table
        for entry, row in rows.items():
            entry.row = row


class SlotShape(NamedTuple):
    """The shape of a slot, its kind, and the numbers (6,) that ``core_of`` returns for it."""

    slot: int
    shape: Shape | OBB
    kind: int
    numbers: NDArray[np.float64]


Packed = tuple[Pool[Item], dict[Entry[Item], int]]
Lent = tuple[dict[int, Any], NDArray[np.float64]]


class Outside(Protocol):
    """Builds trees and hulls in a child process."""

    def build(
        self, per_shape: PerShape[Any], slots: Rows, shapes: Mapping[int, Shape],
        body_of: Callable[[int], Body], budget: TimeLeft | None,
    ) -> None:  # fmt: skip
        """Request trees and hulls of large shapes; build the others while there is time."""

    def drop(self, entry: Entry[Any]) -> None:
        """Handle that a slot has left an entry."""

    def take(self, caches: Iterable[PerShape[Any]]) -> None:
        """Take the trees and hulls built since the last call."""


class ShapeCache:
    """Shapes by slot, with trees and hulls where these were needed.

    Equal shapes share one tree and one hull; the key is the shape, of a box its half extents.
    """

    def __init__(self) -> None:
        self._shapes: dict[int, Any] = {}  # a Shape; None: reserved for one
        self._lent = False  # whether the shapes are copied before they change
        self._numbers = np.zeros((0, 6))  # by slot, see ``SlotShape``
        self.version = 0  # changes with shapes, and with the sizes of boxes
        self._trees, self._hulls = PerShape(TreePool), PerShape(HullPool)
        self._hull_trees = PerShape(HullTreePool)
        self._per_shape: tuple[PerShape[Any], ...] = (self._trees, self._hulls, self._hull_trees)
        self.outside: Outside | None = None
        """Builds the trees and hulls of large shapes, so that a check does not wait."""

    def at_once(self) -> ShapeCache:
        """Return a cache that shares all with this one, but builds everything itself."""
        here = copy(self)
        here.lend_shapes()
        here.outside = None
        return here

    def __len__(self) -> int:
        return len(self._trees) + len(self._hulls) + len(self._hull_trees)

    def shape_for(self, slot: int, shape: Shape | OBB) -> SlotShape:
        """Prepare a shape of a slot for ``put``, which then needs no memory."""
        if isinstance(shape, (Box, OBB)):
            return SlotShape(slot, shape, kind_of(shape), np.zeros(6))
        body = SlotShape(slot, shape, kind_of(shape), np.array(core_of(shape)))
        short = max(0, slot + 1 - len(self._numbers))
        if short:
            room = np.zeros((max(short, len(self._numbers)), 6))
            self._numbers = np.concatenate([self._numbers, room])
        self._own_shapes().setdefault(slot, None)
        return body

    def put(self, body: SlotShape) -> None:
        """Keep the shape of a slot unless it is a box."""
        self.leave(body.slot)
        self.version += 1
        if not isinstance(body.shape, (Box, OBB)):
            self._own_shapes()[body.slot], self._numbers[body.slot] = body.shape, body.numbers
        elif body.slot in self._shapes:
            del self._own_shapes()[body.slot]

    def shape(self, slot: int) -> Shape | None:
        """Return the shape of a slot, None for a box."""
        return self._shapes.get(slot)

    def drop(self, slot: int) -> None:
        """Drop the shape of a slot."""
        self.leave(slot)
        if slot in self._shapes:
            del self._own_shapes()[slot]

    def lend_shapes(self) -> Lent:
        """Return shapes and numbers of ``SlotShape`` by slot; a change copies them first."""
        self._lent = True
        return self._shapes, self._numbers

    def own(self, slots: Sequence[int]) -> None:
        """Copy lent shapes now, so that dropping those of slots does not fail later."""
        if self._shapes and not self._shapes.keys().isdisjoint(slots):
            self._own_shapes()

    def _own_shapes(self) -> dict[int, Any]:
        """Return the shapes by slot for a change."""
        if self._lent:
            self._shapes, self._numbers = dict(self._shapes), self._numbers.copy()
            self._lent = False
        return self._shapes

    def with_shapes(self, lent: Lent) -> ShapeCache:
        """Return another cache, of lent shapes, that reuses trees and hulls of equal shapes."""
        other = ShapeCache()
        (other._shapes, other._numbers), other._lent = lent, True
        other._trees.ready = {entry.key: item for entry, item in self._trees.built.items()}
        other._hulls.ready = {entry.key: item for entry, item in self._hulls.built.items()}
        return other

    def leave(self, slot: int) -> None:
        """Drop the trees and hulls of a slot."""
        for per_shape in self._per_shape:
            entry = per_shape.drop(slot)
            if entry is not None and self.outside is not None:
                self.outside.drop(entry)

    def drop_many(self, slots: Sequence[int]) -> None:
        """Drop the shapes of slots; those of boxes typically have none here."""
        self.version += 1
        for by_slot in (self._shapes, *(per_shape.by_slot for per_shape in self._per_shape)):
            for slot in slots if by_slot else ():
                if slot in by_slot:
                    self.drop(slot)

    def clear(self) -> None:
        """Drop all shapes."""
        slots = [
            *self._shapes,
            *(slot for per_shape in self._per_shape for slot in per_shape.by_slot),
        ]
        pools = [type(per_shape.pool)() for per_shape in self._per_shape]
        self.own(slots)
        self.drop_many(slots)
        for per_shape, pool in zip(self._per_shape, pools, strict=True):
            per_shape.clear(pool)

    def retain(self, slot: int) -> None:
        """Retain the tree and hull of a slot for later shapes that are equal."""
        self._trees.retain(slot)
        self._hulls.retain(slot)

    def trees(self, slots: Rows) -> tuple[MeshTrees, Rows]:
        """Return all trees, and the row (k,) of each slot's tree, -1 until it is built."""
        return self._trees.pool.all, self._trees.rows(slots)

    def hulls(self, slots: Rows) -> tuple[Hulls, Rows]:
        """Return all hulls, and the row (k,) of each slot's hull, -1 until it is built."""
        pool = self._hulls.pool
        return pool.all if pool.size else NO_HULLS, self._hulls.rows(slots)

    def cores(self, slots: Rows) -> NDArray[np.float64]:
        """Return the numbers (k, 6) of ``core_of`` for the shapes of slots, which are not boxes."""
        return self._numbers[slots]

    def build(self, store: ObjectStore, slots: Rows, hull: bool, budget: TimeLeft | None) -> Mask:
        """Build missing hulls or trees, while there is time; return which slots (k,) have one."""
        per_shape: PerShape[Any] = self._hulls if hull else self._trees

        def body_of(slot: int) -> Body:
            shape = self._shapes.get(slot)
            return store.local_half_extents[slot] if shape is None else shape

        if self.outside is not None:
            self.outside.build(per_shape, slots, self._shapes, body_of, budget)
        elif per_shape.build(slots, body_of, budget) and per_shape.is_wasteful:
            per_shape.exchange()
        return per_shape.rows(slots) >= 0

    def surfaces(self, slots: Rows, hull: bool) -> tuple[MeshTrees, Rows]:
        """Build trees of triangles, or of hulls; return all trees, and each slot's row (k,).

        Not for slots of boxes.
        """
        per_shape = self._hull_trees if hull else self._trees
        if per_shape.build(slots, self._shapes.__getitem__, None) and per_shape.is_wasteful:
            per_shape.exchange()
        return per_shape.pool.all, per_shape.rows(slots)

    def take_built(self) -> None:
        """Take the trees and hulls built outside since the last call."""
        if self.outside is not None:
            self.outside.take((self._trees, self._hulls))

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

"""The table of objects: key, states on their way to the scene, stamps, lifetime, faults.

Boxes and the poses they have are in the scene. One row per object, at the object's index there, so
that a message of thousands of poses is stored and a cycle evaluated without a Python loop. All
times are whole nanoseconds of the node's clock.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import Signature
from obb_collision.node.messages.names import NamespaceTable, whole_from_text
from obb_collision.node.objects.conditions import (
    ABSENT,
    DOUBTS,
    LIVE,
    UNPLACED,
    UNSHAPED,
    Conditions,
    Event,
    begin,
    end,
    happen,
    judge,
)
from obb_collision.scene.store.placing import as_slice, doubled
from obb_collision.typing import Floats, Mask, Rows

Slots = Rows
"""Rows of the table, which are the indices of the objects in the scene."""

NO_TIME = np.iinfo(np.int64).max
"""In place of a time (ns) that never comes, such as the end of an unlimited lifetime."""
FIRST_ROWS = 64
"""Rows of a new table; it doubles when full."""
ID_BITS = 32
"""Marker ids are int32: a key in one int64 is the namespace number above, the id below."""
ID_OFFSET = 1 << (ID_BITS - 1)
"""Makes ids positive, so that the order of the keys is the order of (ns, id)."""
PRIMITIVES = (Marker.CUBE, Marker.SPHERE, Marker.CYLINDER)
"""Types of markers whose shape is the type and the scale, and nothing more."""

POLICIES = UNKNOWN, COLLIDE, KEEP, IGNORE = ("unknown", "collide", "keep", "ignore")
"""Treatments of a stale object: place unknown; grown; as if it stood still; in no pair."""

OF_SOURCE = 100
"""The number in ``of_set`` of the objects of sources, which no other input changes."""

NO_SEARCH = (np.empty(0, np.int64),) * 3
EVERY = slice(None)

DTYPES = {"Slots": np.int64, "Mask": np.bool_, "Floats": np.float64, "Conditions": np.uint16}
WIDTHS = {"size": (3,), "pose": (7,), "twist": (6,), "last_twist": (6,)}


class ObjectTable:
    """The columns, and the rows of keys and names."""

    condition: Conditions  # see conditions.py, which alone writes it
    ns: Slots  # number of the namespace
    id: Slots
    serial: Slots  # no two objects ever share one
    of_set: Slots  # number of the input of complete sets by which it came; 0: none
    of_robot: Mask  # belongs to a link of a robot
    kind: Slots  # of its shape, if that is one of PRIMITIVES, else 0
    size: Floats  # of such a shape: the scale
    pose: Floats  # the latest one, in ``frame``
    twist: Floats  # of ``pose``: linear, angular; zero without one
    last_twist: Floats  # of the last state that had one; zero without any
    moving: Mask  # the scene has a twist
    frame: Slots  # index into the table of frames, 0 is the fixed frame
    stamp: Slots  # of ``pose``; 0: none
    order: Slots  # states with an older stamp are dropped
    received: Slots
    number: Slots  # of the latest state: the later it came, the higher
    topic: Slots  # by which it came
    sender: Slots  # which publisher sent it
    maker: Slots  # which one sent its last marker
    world_stamp: Slots  # stamp of the state that is in the scene; 0: none
    world_received: Slots  # when it came
    world_number: Slots  # its number
    carried: Slots  # when the transform that placed it was true, if it was the latest; 0: none
    expiry: Slots
    seen: Mask  # a cycle has looked at it since its last marker
    locked: Mask  # frame_locked: placed anew every cycle
    repeated: Mask  # more than one message has been about it
    limited: Mask  # the next two columns are those of its name
    limit: Slots  # age (ns) from which on it is stale; 0: none, -1: that of all
    policy: Slots  # for then, the index in POLICIES
    speed: Floats  # of a stale one: the most of any of its points, by ``last_twist``

    def __init__(self) -> None:
        self.namespaces = NamespaceTable()
        self.slots = KeySlots(self)
        self.signatures: dict[int, Signature] = {}
        """Of the shapes that are none of PRIMITIVES, by slot."""
        self._count = self._serial = 0
        self._sorted: tuple[Slots, Slots] | None = None
        self._last = NO_SEARCH  # namespaces and ids that were looked for, and slots found
        self._ranks: Slots | None = None
        self._index: dict[int, int] | None = None
        for name, kind in COLUMNS.items():
            shape = FIRST_ROWS, *WIDTHS.get(name, ())
            setattr(self, name, np.zeros(shape, DTYPES[kind]))

    def __len__(self) -> int:
        return self._count

    def claim(self, slot: int, key: Key) -> None:
        """Begin a new object at ``slot``, all columns at zero.

        Raises RefusedError for a namespace that can't be admitted.
        """
        index = self._index
        self.claim_many(
            np.array([slot]), np.array([self.namespaces.admit(key[0])]), np.array([key[1]])
        )
        if index is not None:  # one more is no reason to make it anew
            index[pack(int(self.ns[slot]), key[1])] = slot
            self._index = index

    def claim_many(self, slots: Slots, namespaces: Slots, ids: Slots) -> None:
        """Begin new objects at slots (n,); the numbers of namespaces are admitted."""
        if len(slots) == 0:
            return
        self.reach(int(slots.max()) + 1)
        rows, counts = as_slice(slots), _counts(namespaces)
        serials = self._serial + np.arange(len(slots))
        for column in COLUMNS:  # from here on nothing needs memory
            getattr(self, column)[rows] = 0
        for number, count in counts:
            self.namespaces.use(number, count)
        self.ns[rows], self.id[rows] = namespaces, ids
        self.expiry[rows] = NO_TIME
        self.serial[rows] = serials
        begin(self.condition, rows)
        self._serial += len(slots)
        self._count += len(slots)
        self._sorted = self._index = None

    def reach(self, rows: int) -> None:
        """Grow until there are so many rows: all columns are there before one is exchanged."""
        while rows > len(self.condition):
            vars(self).update(doubled({column: getattr(self, column) for column in COLUMNS}))

    def release_many(self, slots: Slots) -> None:
        """End the objects at slots (n,), all in use and distinct."""
        if len(slots) == 0:
            return
        rows, counts = as_slice(slots), _counts(self.ns[slots])
        signed = slots[self.kind[slots] == 0].tolist() if self.signatures else ()
        for slot in signed:  # from here on nothing needs memory
            self.signatures.pop(slot, None)
        for number, count in counts:
            self.namespaces.leave(number, count)
        end(self.condition, rows)
        self.of_robot[rows], self.of_set[rows] = False, 0
        self._count -= len(slots)
        self._sorted = self._index = None

    def signature(self, key: Key) -> Signature | None:
        """Return the signature of an object's shape, None for an unknown object."""
        slot = self.slots.get(key, -1)
        if slot >= 0 and self.kind[slot]:
            return (int(self.kind[slot]), *self.size[slot].tolist())
        return self.signatures.get(slot)

    def note_signature(self, slot: int, signature: Signature) -> None:
        """Take note of the shape that an object has."""
        if len(signature) == 4 and signature[0] in PRIMITIVES:
            self.note_primitives(
                np.array([slot]), np.array(signature[:1]), np.array([signature[1:]])
            )
        else:
            self.kind[slot], self.signatures[slot] = 0, signature

    def have_shapes(self, slots: Slots, kinds: Slots, sizes: Floats) -> Mask:
        """Return which objects (n,), -1 for none, have the shapes of markers of PRIMITIVES."""
        same = (slots >= 0) & (kinds != 0) & (self.kind[slots] == kinds)
        result: Mask = same & (self.size[slots] == sizes).all(axis=1)
        return result

    def note_primitives(self, slots: Slots, kinds: Slots, sizes: Floats) -> None:
        """Store the kinds (n,) and sizes (n, 3), metres, of objects whose shapes are primitives."""
        if self.signatures:
            for slot in slots[self.kind[slots] == 0].tolist():
                self.signatures.pop(slot, None)
        self.kind[slots], self.size[slots] = kinds, sizes

    @property
    def index(self) -> dict[int, int]:
        """Slots by key in one number, see ``pack``; rebuilt after many changes."""
        if self._index is None:
            keys, slots = self._sort()
            self._index = dict(zip(keys.tolist(), slots.tolist(), strict=True))
        return self._index

    def find_named(self, names: list[str]) -> Slots:
        """Return the slots (n,) of objects by name, ``ns/id``, -1 where there is no such object.

        A slash in front may be missing: ``5`` means ``/5``, the object of an empty namespace, where
        there is no object of just that name.
        """
        index = self.index
        starts: dict[str, tuple[int, ...]] = {}
        slot_of = {}
        for name in set(names):
            namespace, slash, digits = name.rpartition("/")
            start = namespace + slash
            keys = starts.get(start)
            if keys is None:
                texts = (text[:-1] for text in (start, "/" + start) if text)
                numbers = [self.namespaces.find(text) for text in texts]
                keys = starts[start] = tuple([pack(n, 0) for n in numbers if n is not None])
            number = whole_from_text(digits) if keys else None
            slot = -1
            if number is not None and -ID_OFFSET <= number < ID_OFFSET:
                for key in reversed(keys):  # the first one that has the id is the last one here
                    slot = index.get(key + number, slot)
            slot_of[name] = slot
        return np.array([slot_of[name] for name in names], np.int64)

    def has(self, facts: int, slots: Slots | slice | int = EVERY) -> Mask:
        """Return for which objects, (n,) or all (rows,), at least one of the facts holds."""
        return (self.condition[slots] & facts) != 0

    @property
    def facts(self) -> int:
        """The facts that hold for at least one object."""
        return int(np.bitwise_or.reduce(self.condition))

    def mark(self, slots: Slots | slice | int, event: Event) -> None:
        """Let an event happen to objects (n,)."""
        happen(self.condition, slots, event)

    def judge(self, fact: int, holds: Mask) -> None:
        """Let a fact that goes by the clock hold for some objects (rows,), and for no others."""
        judge(self.condition, fact, holds)

    def have_serials(self, slots: Slots, serials: Slots) -> Mask:
        """Return which slots (any shape) still have the objects with these serial numbers."""
        same: Mask = self.has(LIVE, slots) & (self.serial[slots] == serials)
        return same

    @property
    def live(self) -> Mask:
        """(rows,) rows of objects."""
        return self.has(LIVE)

    @property
    def visible(self) -> Mask:
        """(rows,) objects with a box: their shape is known, and where they are."""
        return (self.condition & (LIVE | UNPLACED | UNSHAPED)) == LIVE

    @property
    def unplaceable(self) -> Mask:
        """(rows,) objects that take part in no check: without a box, or set aside."""
        return self.has(ABSENT)

    @property
    def doubtful(self) -> Mask:
        """(rows,) objects whose box is not known to be where it should be: shown grey."""
        return self.has(DOUBTS)

    def keys(self, slots: Slots) -> list[Key]:
        """Return the keys of the objects at slots (n,)."""
        names = self.namespaces.names
        pairs = zip(self.ns[slots].tolist(), self.id[slots].tolist(), strict=True)
        return [(names[number], ident) for number, ident in pairs]

    def key(self, slot: int) -> Key:
        """Return the key of the object at a slot."""
        return self.namespaces.names[int(self.ns[slot])], int(self.id[slot])

    def name(self, slot: int) -> str:
        """Return the name of the object at a slot."""
        return name_from_key(self.key(slot))

    @property
    def ranks(self) -> Slots:
        """(rows,) places of the objects in the order of their keys; of other rows anything."""
        keys, slots = self._sort()
        if self._ranks is None or len(self._ranks) != len(self.condition):
            self._ranks = np.zeros(len(self.condition), np.int64)
            self._ranks[slots] = np.arange(len(keys))
        return self._ranks

    def renamed(self) -> None:
        """Note that objects have other names: their ranks are computed anew."""
        self._ranks = None

    def order_keys(self, slots: Slots) -> Slots:
        """Return one int64 per slot that sorts as (ns, id) does."""
        return (self.ns[slots] << ID_BITS) + self.id[slots] + ID_OFFSET

    def _sort(self) -> tuple[Slots, Slots]:
        """Return the keys, rising, and the slots they are at."""
        if self._sorted is None:
            self._last, self._ranks = NO_SEARCH, None
            slots = np.flatnonzero(self.live)
            keys = self.order_keys(slots)
            order = np.argsort(keys)
            self._sorted = (keys[order], slots[order])
        return self._sorted

    def find(self, namespaces: Slots | None, ids: Slots) -> Slots:
        """Return the slots (n,) of objects by namespace number and id, -1 for no such object.

        Numbers are int32; the same bits as uint32 will do. Without them all objects must share
        one namespace: RefusedError otherwise.
        """
        keys, slots = self._sort()
        if len(keys) == 0 or len(ids) == 0:
            return np.full(len(ids), -1, np.int64)
        last_namespaces, last_ids, last_slots = self._last
        if (
            namespaces is not None  # most senders repeat the keys of their last message
            and np.array_equal(ids, last_ids)
            and np.array_equal(namespaces, last_namespaces)
        ):
            return last_slots.copy()
        named = namespaces
        if namespaces is None:
            first, last = keys[0] >> ID_BITS, keys[-1] >> ID_BITS
            if first != last:
                raise RefusedError("field layout", "several namespaces: field 'ns' is needed")
            namespaces = np.broadcast_to(first, ids.shape)
        legal = (ids >= -ID_OFFSET) & (ids < ID_OFFSET) & are_numbers(namespaces)
        wanted = (signed(namespaces) << ID_BITS) + np.where(legal, ids, 0) + ID_OFFSET
        at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        result = np.where(legal & (keys[at] == wanted), slots[at], -1)
        if named is not None:
            self._last = named.copy(), ids.copy(), result.copy()
        return result

    def has_namespaces(self, namespaces: Slots) -> Mask:
        """Return which numbers (n,) belong to namespaces in the table."""
        admitted = np.fromiter(self.namespaces.names, np.int64, len(self.namespaces))
        return are_numbers(namespaces) & np.isin(signed(namespaces), admitted)


COLUMNS: dict[str, str] = dict(ObjectTable.__annotations__)
"""Names of the columns, and their types."""


class KeySlots(Mapping[Key, int]):
    """The slots of the objects of a table, by key."""

    def __init__(self, table: ObjectTable) -> None:
        self._table = table

    def __getitem__(self, key: Key) -> int:
        number = self._table.namespaces.find(key[0])
        if number is None:
            raise KeyError(key)
        return self._table.index[pack(number, key[1])]

    def __iter__(self) -> Iterator[Key]:
        return iter(self._table.keys(np.flatnonzero(self._table.live)))

    def __len__(self) -> int:
        return len(self._table)


def pack(namespace: int, number: int) -> int:
    """Return the key of a namespace's number and an id in one number, in the order of keys."""
    return (namespace << ID_BITS) + number + ID_OFFSET


def _counts(numbers: Slots) -> list[tuple[int, int]]:
    """Return the distinct values of numbers (n,), n > 0, and how often each occurs."""
    if (numbers == numbers[0]).all():  # most senders have one namespace
        return [(int(numbers[0]), len(numbers))]
    different, counts = np.unique(numbers, return_counts=True)
    return list(zip(different.tolist(), counts.tolist(), strict=True))


def are_numbers(namespaces: Slots) -> Mask:
    """Return which of (n,) can be numbers of namespaces: int32, or the same bits as uint32."""
    return (namespaces >= -ID_OFFSET) & (namespaces < 2 * ID_OFFSET)


def signed(namespaces: Slots) -> Slots:
    """Return namespace numbers, int32 or their bits as uint32, as int32; others: any number."""
    return namespaces.astype(np.uint32).astype(np.int32).astype(np.int64)

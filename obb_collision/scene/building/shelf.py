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

"""What is built once a shape and shared by all objects that have it, in one pool of arrays.

One thread looks at items and says which are needed. Another may add items meanwhile (``add``); they
are seen once the first has taken note of them (``note``).
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from threading import Lock
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.typing import Rows

Item = TypeVar("Item")
Joined = TypeVar("Joined")
ItemIn = TypeVar("ItemIn", contravariant=True)
JoinedOut = TypeVar("JoinedOut", covariant=True)


class Pool(Protocol[ItemIn, JoinedOut]):
    """Items one after another in arrays."""

    @property
    def size(self) -> int:
        """How much all items take, in no matter which unit."""

    @property
    def all(self) -> JoinedOut:
        """The arrays."""

    def size_of(self, item: ItemIn) -> int:
        """Return how much an item takes."""

    def append(self, item: ItemIn) -> int:
        """Add an item; return its row."""


class Timer(Protocol):
    """Says how much time there is."""

    def left(self) -> float:
        """Return the seconds that are left."""


@dataclass(frozen=True, eq=False)
class Added(Generic[Item, Joined]):
    """Items that were added to a pool, by key, their rows, and the arrays as they are then.

    count: the rows in the arrays.
    """

    pool: Pool[Item, Joined]
    items: dict[Hashable, Item]
    rows: dict[Hashable, int]
    all: Joined
    count: int


class Shelf(Generic[Item, Joined]):
    """Items by slot; slots with the same key have one in common.

    make(): an empty pool. Items that no slot needs any more leave when they are half of it.
    """

    def __init__(self, make: Callable[[], Pool[Item, Joined]]) -> None:
        self._make = make
        self._pool = make()
        self._adding = Lock()  # of the pool
        self._all: Joined | None = None
        self._count = 0  # rows in ``all``, at least
        self._items: dict[Hashable, Item] = {}
        self._users: dict[Hashable, set[int]] = {}
        self._keys: dict[int, Hashable] = {}
        self._rows = np.full(0, -1)  # by slot

    def __len__(self) -> int:
        return len(self._items)

    @property
    def pool(self) -> Pool[Item, Joined]:
        """The pool of now."""
        return self._pool

    @property
    def all(self) -> Joined:
        """The items that ``rows`` speaks of, of which there must be one; they stay as they are."""
        assert self._all is not None
        return self._all

    def rows(self, slots: Rows) -> NDArray[np.int64]:
        """Return the row (k,) of each slot's item, -1 for none yet."""
        result = np.full(len(slots), -1)
        known = slots < len(self._rows)
        result[known] = self._rows[slots[known]]
        return result

    def build(
        self, slots: Rows, key_of: Callable[[int], Hashable], make: Callable[[int], Item],
        timer: Timer | None, compact: bool = True,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Make what slots lack, while there is time; return (k,) which have theirs.

        With a timer nothing is made while another thread adds an item. compact: drop what is of no
        use any more.
        """
        missing = np.unique(slots[self.rows(slots) < 0])
        if len(missing) and self._adding.acquire(blocking=timer is None):
            try:
                for slot in missing.tolist():
                    if timer is not None and timer.left() <= 0.0:
                        break
                    self._put(slot, key_of(slot), make)
            finally:
                self._all = self._pool.all if self._items else None
                self._adding.release()
            if compact and self.wasteful:
                self.compact()
        return self.rows(slots) >= 0

    def _put(self, slot: int, key: Hashable, make: Callable[[int], Item]) -> None:
        if not self.share(slot, key):
            item = make(slot)
            row = self._pool.append(item)
            self._items[key], self._users[key] = item, set()
            self._use(slot, key, row)
            self._count = row + 1

    def share(self, slot: int, key: Hashable) -> bool:
        """Give a slot the item of a key, if there is one; return whether there is."""
        users = self._users.get(key)
        if not users:
            return False
        self._use(slot, key, int(self._rows[next(iter(users))]))
        return True

    def _use(self, slot: int, key: Hashable, row: int) -> None:
        short = max(0, slot + 1 - len(self._rows))
        if short:
            self._rows = np.append(self._rows, np.full(max(short, len(self._rows)), -1))
        self._keys[slot] = key
        self._users[key].add(slot)
        self._rows[slot] = row

    def drop(self, slot: int) -> None:
        """Let the item of a slot go."""
        if slot in self._keys:
            key = self._keys.pop(slot)
            self._rows[slot] = -1
            self._users[key].discard(slot)
            if not self._users[key]:
                del self._users[key], self._items[key]

    def add(self, key: Hashable, item: Item) -> Added[Item, Joined]:
        """Add an item, in a thread of its own."""
        with self._adding:
            pool = self._pool
            row = pool.append(item)
            return Added(pool, {key: item}, {key: row}, pool.all, row + 1)

    def note(self, added: Added[Item, Joined], slots: Rows) -> bool:
        """Take note of an item that was added, for slots; return whether that can be."""
        if added.pool is not self._pool:
            return False
        ((key, item),) = added.items.items()
        if len(slots) and key not in self._items:
            self._items[key], self._users[key] = item, set()
            if added.count > self._count:  # else what was added here since then is in ``all``, too
                self._all, self._count = added.all, added.count
            for slot in slots.tolist():
                self._use(slot, key, added.rows[key])
        return True

    @property
    def wasteful(self) -> bool:
        """Whether half of the pool is of no use any more."""
        return 2 * self.size < self._pool.size

    @property
    def size(self) -> int:
        """How much the items in use take."""
        return sum(self._pool.size_of(item) for item in self._items.values())

    def items(self) -> dict[Hashable, Item]:
        """Return the items in use."""
        return dict(self._items)

    def compacted(self, items: dict[Hashable, Item]) -> Added[Item, Joined]:
        """Return a pool of items, made in a thread of its own."""
        pool = self._make()
        rows = {key: pool.append(item) for key, item in items.items()}
        return Added(pool, items, rows, pool.all, len(rows))

    def size_beyond(self, added: Added[Item, Joined]) -> int:
        """Return how much the items in use take that a new pool lacks."""
        missing = (item for key, item in self._items.items() if added.items.get(key) is not item)
        return sum(self._pool.size_of(item) for item in missing)

    def compact(self, added: Added[Item, Joined] | None = None) -> None:
        """Take a new pool, as made before or made now; what it lacks is added to it."""
        if not self._items:
            self._pool, self._all, self._count = self._make(), None, 0
            return
        if added is None:
            added = self.compacted(self.items())
        rows, count = dict(added.rows), added.count
        for key, item in self._items.items():
            if added.items.get(key) is not item:
                rows[key] = added.pool.append(item)
                count += 1
        self._pool, self._all, self._count = added.pool, added.pool.all, count
        for key, users in self._users.items():
            self._rows[list(users)] = rows[key]

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

"""What is built once a shape and shared by all objects that have it, in one pool of arrays."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.scene.budget import Budget
from obb_collision.scene.store import Rows

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


class Shelf(Generic[Item, Joined]):
    """Items by slot; slots with the same key have one in common.

    make(): an empty pool. Items that no slot needs any more leave when they are half of it.
    """

    def __init__(self, make: Callable[[], Pool[Item, Joined]]) -> None:
        self._make = make
        self._pool = make()
        self._items: dict[Hashable, Item] = {}
        self._users: dict[Hashable, set[int]] = {}
        self._keys: dict[int, Hashable] = {}
        self._rows = np.full(0, -1)  # by slot

    def __len__(self) -> int:
        return len(self._items)

    @property
    def all(self) -> Joined:
        """The items that ``rows`` speaks of, of which there must be one; they stay as they are."""
        return self._pool.all

    def rows(self, slots: Rows) -> NDArray[np.int64]:
        """Return the row (k,) of each slot's item, -1 for none yet."""
        result = np.full(len(slots), -1)
        known = slots < len(self._rows)
        result[known] = self._rows[slots[known]]
        return result

    def build(
        self, slots: Rows, key_of: Callable[[int], Hashable], make: Callable[[int], Item],
        budget: Budget | None,
    ) -> NDArray[np.bool_]:  # fmt: skip
        """Make what slots lack, while there is time; return (k,) which have theirs."""
        missing = np.unique(slots[self.rows(slots) < 0])
        if len(missing):
            short = max(0, int(missing[-1]) + 1 - len(self._rows))
            self._rows = np.append(self._rows, np.full(short, -1))
            for slot in missing.tolist():
                if budget is not None and budget.left() <= 0.0:
                    break
                self._put(slot, key_of(slot), make)
            self._compact()
        return self.rows(slots) >= 0

    def _put(self, slot: int, key: Hashable, make: Callable[[int], Item]) -> None:
        if key in self._items:
            row = int(self._rows[next(iter(self._users[key]))])
        else:
            self._items[key], self._users[key] = make(slot), set()
            row = self._pool.append(self._items[key])
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

    def _compact(self) -> None:
        """Fill a new pool where half of this one is of no use any more."""
        if 2 * sum(self._pool.size_of(item) for item in self._items.values()) >= self._pool.size:
            return
        self._pool = self._make()
        for key, item in self._items.items():
            self._rows[list(self._users[key])] = self._pool.append(item)

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

"""Trees and hulls of large shapes: built in another process, so that no check waits for them.

Until they are there their pairs stay on "obb", which misses nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from time import perf_counter
from typing import Any, Protocol

import numpy as np

from obb_collision.geometry.trees.pool import HullPool
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.errors import BuildError
from obb_collision.scene.building.shelf import Added, Shelf
from obb_collision.scene.building.tree_jobs import CompactJob, HullJob, TreeJob
from obb_collision.shapes import Hull, Mesh, Shape
from obb_collision.typing import Rows

#: Triangles of a mesh, or points of a hull, that are built at once: 2 ms for a tree.
FEW = 100
#: Seconds of a check for building small ones; the rest of them is built at the next ones.
AT_ONCE = 0.01
#: How much a pool may hold to be made anew at once: triangles or corners, 10 ms.
SMALL_POOL = 10_000

#: A shelf, and the shape that needs something on it.
Wanted = tuple[Shelf[Any, Any], Shape]


class TimeLeft(Protocol):
    """What knows how much time is left, such as a budget."""

    def left(self) -> float:
        """Return the seconds that are left."""


class Allowance:
    """The time of a check for what is built at once."""

    def __init__(self, budget: TimeLeft | None) -> None:
        self._budget, self._end = budget, perf_counter() + AT_ONCE

    def left(self) -> float:
        """Return the seconds that are left."""
        left = self._end - perf_counter()
        return left if self._budget is None else min(left, self._budget.left())


def is_large(shape: Shape | None) -> bool:
    """Return whether the tree of a shape takes long to build."""
    if isinstance(shape, Mesh):
        return len(shape.faces) > FEW
    return isinstance(shape, Hull) and len(shape.points) > FEW


class OutsideTrees:
    """What is being built for the shapes of a scene, by a builder of its own."""

    def __init__(self, builder: Builder) -> None:
        self._builder = builder
        self._wanted: dict[Wanted, set[int]] = {}
        self._failed: dict[Wanted, BuildError] = {}
        self._compacting: set[Shelf[Any, Any]] = set()
        self._shelves: set[Shelf[Any, Any]] = set()
        self._dropped = False

    @property
    def waiting(self) -> int:
        """How many trees and hulls are being built."""
        return len(self._wanted)

    @property
    def failed(self) -> Counter[str]:
        """How many can't be built, by reason; their pairs stay on "obb"."""
        return Counter(error.reason for error in self._failed.values())

    def timer(self, budget: TimeLeft | None) -> Allowance:
        """Return the time for what is built at once."""
        return Allowance(budget)

    def order(self, shelf: Shelf[Any, Any], slots: Rows, shapes: Mapping[int, Shape]) -> Rows:
        """See to it that what is large will be built; return the slots of the rest."""
        rest = []
        for slot in slots[shelf.rows(slots) < 0].tolist():
            shape = shapes.get(slot)
            if shape is None or not is_large(shape):
                rest.append(slot)
            elif not shelf.share(slot, shape):
                self._request((shelf, shape), slot)
        return np.array(rest, np.int64)

    def _request(self, wanted: Wanted, slot: int) -> None:
        if wanted in self._failed:
            return
        if wanted not in self._wanted:
            shelf, shape = wanted
            self._shelves.add(shelf)
            assert isinstance(shape, (Mesh, Hull))
            make = HullJob if isinstance(shelf.pool, HullPool) else TreeJob
            try:
                self._builder.request(wanted, wanted, make(shape, shelf))
            except BuildError as error:
                self._failed[wanted] = error
                return
            self._wanted[wanted] = set()
        self._wanted[wanted].add(slot)

    def drop(self, slot: int, shape: Shape) -> None:
        """Forget what a slot needs that has this shape no longer."""
        self._dropped = True
        for shelf in self._shelves:
            wanted = shelf, shape
            self._failed.pop(wanted, None)  # who has it still asks again
            if wanted not in self._wanted:
                continue
            self._wanted[wanted].discard(slot)
            if not self._wanted[wanted]:
                del self._wanted[wanted]
                self._builder.cancel(wanted)

    def take(self, shelves: Iterable[Shelf[Any, Any]]) -> None:
        """Take what was built since the last time."""
        for outcome in self._builder.poll():
            if isinstance(outcome.job, CompactJob):
                self._compacting.discard(outcome.job.shelf)
                if outcome.error is None:
                    self._exchange(outcome.job.shelf, outcome.result)
                continue
            wanted: Any = outcome.signature
            slots = self._wanted.pop(wanted, set())
            if outcome.error is not None:
                self._failed[wanted] = outcome.error
            else:
                # if it is on another pool by now it is built again when it is asked for
                wanted[0].note(outcome.result, np.array(sorted(slots), np.int64))
        if self._dropped:
            self._dropped = False
            for shelf in shelves:
                self._compact(shelf)

    def _exchange(self, shelf: Shelf[Any, Any], added: Added[Any, Any]) -> None:
        if shelf.size_beyond(added) <= SMALL_POOL:
            shelf.compact(added)
        else:
            self._dropped = True  # it is made anew

    def _compact(self, shelf: Shelf[Any, Any]) -> None:
        """Let go what is of no use any more: at once, if little is left."""
        if shelf in self._compacting or not shelf.wasteful:
            return
        if shelf.size <= SMALL_POOL:
            shelf.compact()
            return
        job = CompactJob(shelf.items(), shelf)
        try:
            self._builder.request(shelf, job, job)
        except BuildError:
            self._dropped = True
        else:
            self._compacting.add(shelf)

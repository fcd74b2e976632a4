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

"""Trees and hulls of large shapes, built in a child process so that no check waits for them.

Meanwhile their pairs stay on "obb", which misses nothing.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.shapes.meshes import Hull, Mesh
from obb_collision.geometry.shapes.primitives import Shape
from obb_collision.geometry.trees.pool import Body, Pool
from obb_collision.scene.building.builder import Builder
from obb_collision.scene.building.jobs import BuildError, Job, Task, arrays_of
from obb_collision.scene.building.shape_cache import Entry, Packed, PerShape, TimeLeft
from obb_collision.typing import Rows

#: Triangles of a mesh, or points of a hull, up to which it is built at once: 2 ms for a tree.
MOST_AT_ONCE = 100
#: Seconds of a check for building small shapes; the next checks build the rest.
AT_ONCE = 0.01
#: Size of a pool that is packed at once, triangles or corners: 10 ms.
SMALL_POOL = 10_000


class BuildTime:
    """The seconds that a check has for building small trees and hulls."""

    def __init__(self, budget: TimeLeft | None) -> None:
        self._budget, self._end = budget, perf_counter() + AT_ONCE

    def left(self) -> float:
        """Return the seconds that are left."""
        left = self._end - perf_counter()
        return left if self._budget is None else min(left, self._budget.left())


def is_large(shape: Shape | None) -> TypeGuard[Mesh | Hull]:
    """Return whether the tree of a shape takes long to build."""
    if isinstance(shape, Mesh):
        return len(shape.faces) > MOST_AT_ONCE
    return isinstance(shape, Hull) and len(shape.points) > MOST_AT_ONCE


@dataclass(frozen=True, eq=False)
class BuildJob(Job):
    """Builds the tree or hull of a shape; the job holds no memory of its own."""

    shape: Shape
    per_shape: PerShape[Any]

    def task(self) -> Task:
        """Return the task that builds the tree or hull."""
        return arrays_of, (type(self.per_shape.pool), self.shape)

    def finish(self, result: Sequence[NDArray[Any]]) -> tuple[Pool[Any], Any, int]:
        """Return the pool, the new item, and its row in the pool."""
        pool = self.per_shape.pool
        item = pool.received(result)
        with pool.lock:
            return pool, item, pool.append(item)


@dataclass(frozen=True, eq=False)
class PackJob(Job):
    """Copies the items in use to a new pool; the job holds no memory of its own."""

    built: dict[Entry[Any], Any]
    per_shape: PerShape[Any]

    def finish(self, result: Any) -> Packed[Any]:
        """Return the new pool."""
        return self.per_shape.packed(self.built)


class OutsideTrees:
    """The trees and hulls being built for a scene, by a builder of its own."""

    def __init__(self, builder: Builder) -> None:
        self._builder = builder
        self._waiting: set[Entry[Any]] = set()
        self._failed: dict[Entry[Any], BuildError] = {}
        self._packing: set[PerShape[Any]] = set()
        self._is_wasteful = False  # perhaps

    @property
    def waiting(self) -> int:
        """Number of trees and hulls being built."""
        return len(self._waiting)

    @property
    def slots_waiting(self) -> list[int]:
        """The slots whose trees or hulls are being built."""
        return [slot for entry in self._waiting for slot in entry.slots]

    @property
    def failed(self) -> Counter[str]:
        """Numbers of trees and hulls that can't be built, by reason; pairs stay on "obb"."""
        return Counter(error.reason for error in self._failed.values())

    def build(
        self,
        per_shape: PerShape[Any],
        slots: Rows,
        shapes: Mapping[int, Shape],
        body_of: Callable[[int], Body],
        budget: TimeLeft | None,
    ) -> None:
        """Request trees and hulls of large shapes; build the others while there is time."""
        rest = []
        for slot in slots[per_shape.rows(slots) < 0].tolist():
            shape = shapes.get(slot)
            if is_large(shape):
                entry = per_shape.entry(slot, shape)
                if entry.row < 0 and entry not in self._waiting and entry not in self._failed:
                    try:
                        self._builder.request(entry, entry, BuildJob(shape, per_shape))
                        self._waiting.add(entry)
                    except BuildError as error:
                        self._failed[entry] = error
            else:
                rest.append(slot)
        per_shape.build(np.array(rest, np.int64), body_of, BuildTime(budget))

    def drop(self, entry: Entry[Any]) -> None:
        """Handle that a slot has left an entry."""
        self._is_wasteful = True
        self._failed.pop(entry, None)  # other slots request it again
        if not entry.slots and entry in self._waiting:
            self._waiting.discard(entry)
            self._builder.cancel(entry)

    def take(self, caches: Iterable[PerShape[Any]]) -> None:
        """Take trees and hulls built since the last call; pack pools that are half empty."""
        for outcome in self._builder.poll():
            job: Any = outcome.job
            if isinstance(job, PackJob):
                self._packing.discard(job.per_shape)
                self._is_wasteful = True  # items may have been dropped meanwhile
                if outcome.error is None and job.per_shape.lacks(outcome.result) <= SMALL_POOL:
                    job.per_shape.exchange(outcome.result)
                continue
            entry: Any = outcome.signature
            self._waiting.discard(entry)
            if outcome.error is not None:
                self._failed[entry] = outcome.error
                continue
            pool, item, row = outcome.result
            if pool is job.per_shape.pool:  # else it is built again when needed
                job.per_shape.put(entry, item, row)
        if self._is_wasteful:
            self._is_wasteful = False
            for per_shape in caches:
                self._pack(per_shape)

    def _pack(self, per_shape: PerShape[Any]) -> None:
        """Drop items that no slot needs: at once, if little is left."""
        if per_shape in self._packing or not per_shape.is_wasteful:
            return
        if per_shape.size <= SMALL_POOL:
            per_shape.exchange()
            return
        job = PackJob(per_shape.built, per_shape)
        try:
            self._builder.request(per_shape, job, job)
        except BuildError:
            self._is_wasteful = True
        else:
            self._packing.add(per_shape)

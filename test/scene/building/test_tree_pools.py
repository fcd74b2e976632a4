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

"""Trees of shapes that two threads add to, and that run out of memory."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest
from builders import PATIENCE

from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import TreePool, mesh_tree
from obb_collision.scene.building.shape_cache import PerShape
from obb_collision.scene.building.tree_jobs import BuildJob, perform_build
from obb_collision.shapes import Mesh


def per_shape_of(kind: type[TreePool] = TreePool) -> PerShape[MeshTrees]:
    made: PerShape[MeshTrees] = PerShape(TreePool)
    made.pool = kind()
    return made


def triangle(number: int) -> Mesh:
    return Mesh(np.eye(3) * (1.0 + number), [[0, 1, 2]])


def add_outside(trees: PerShape[MeshTrees], number: int) -> tuple[Any, MeshTrees, int]:
    """Build a triangle, and add its tree as another thread does."""
    job = BuildJob(triangle(number), trees)
    pool, item, row = job.finish(perform_build(job.message()))
    return pool, item, row


def first_corners(trees: PerShape[MeshTrees], slots: list[int]) -> list[float]:
    """Return what the trees of slots say, read as a kernel does: by row."""
    rows, arrays = trees.rows(np.array(slots)), trees.pool.all
    assert (rows < len(arrays.roots)).all(), "a row beyond the arrays"
    return [float(arrays.triangles[arrays.starts[arrays.roots[row], 0]].max()) for row in rows]


def test_what_two_threads_add_is_all_there() -> None:
    trees = per_shape_of()
    entries = {number: trees.entry(number, f"shape {number}") for number in (0, 2)}
    pool, item, row = add_outside(trees, 0)
    trees.build(np.array([1]), triangle, None)
    later = add_outside(trees, 2)
    assert trees.rows(np.array([0, 1, 2])).tolist() == [-1, 1, -1]
    assert first_corners(trees, [1]) == [2.0]
    trees.put(entries[0], item, row)
    assert first_corners(trees, [0, 1]) == [1.0, 2.0]
    assert later[0] is pool is trees.pool
    trees.put(entries[2], *later[1:])
    assert first_corners(trees, [0, 1, 2]) == [1.0, 2.0, 3.0]
    packed = trees.packed(trees.built)
    trees.build(np.array([3]), triangle, None)
    trees.drop(0)
    trees.exchange(packed)
    assert first_corners(trees, [1, 2, 3]) == [2.0, 3.0, 4.0]
    assert trees.pool is not pool


def test_a_pool_in_use_by_another_thread_is_not_waited_for() -> None:
    class Timer:
        def left(self) -> float:
            return 1.0

    begun, go = threading.Event(), threading.Event()

    class Slow(TreePool):
        def append(self, item: Any) -> int:
            begun.set()
            assert go.wait(PATIENCE)
            return super().append(item)

    trees = per_shape_of(Slow)
    thread = threading.Thread(target=add_outside, args=(trees, 0))
    thread.start()
    assert begun.wait(PATIENCE)
    trees.build(np.array([1]), triangle, Timer())
    assert trees.rows(np.array([1])).tolist() == [-1]
    go.set()
    thread.join(PATIENCE)
    trees.build(np.array([1]), triangle, Timer())
    assert first_corners(trees, [1]) == [2.0]


def test_a_pool_without_memory_stays_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    pool = TreePool()
    pool.append(mesh_tree(triangle(0)))
    reserve, calls = pool._reserve, []

    def fails(name: str, values: Any) -> None:
        calls.append(name)
        if len(calls) == 5:
            raise MemoryError
        reserve(name, values)

    monkeypatch.setattr(pool, "_reserve", fails)
    with pytest.raises(MemoryError):
        pool.append(mesh_tree(triangle(1)))
    monkeypatch.undo()
    assert pool.size == 1
    assert pool.append(mesh_tree(triangle(2))) == 1
    assert [len(getattr(pool.all, name)) for name in ("roots", "solid", "radii")] == [2, 2, 2]
    assert pool.all.triangles[pool.all.starts[pool.all.roots[1], 0]].max() == 3.0

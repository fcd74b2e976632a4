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

"""Trees built beside a check: pairs stay on "obb" until they are there, and lose nothing."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from each import each
from scenes import PATIENCE, wait_built

import obb_collision as oc
from obb_collision import _kernel_cache
from obb_collision.geometry.trees import TreePool, mesh_tree
from obb_collision.geometry.trees import pool as pools
from obb_collision.scene.building import outside, shape_cache
from obb_collision.scene.building.builder import Builder, Limits
from obb_collision.scene.building.jobs import BuildError, Task, perform
from obb_collision.shapes import Box, Hull, Mesh, Shape


@pytest.fixture(scope="module")
def builder() -> Iterator[Builder]:
    with closing(Builder()) as made:
        yield made


def ball(seed: int = 0, faces: int = 320) -> Mesh:
    part = trimesh.creation.icosphere(2 if faces == 320 else 3)
    stretch = 0.5 + np.random.default_rng(seed).uniform(size=3)
    return Mesh(part.vertices * stretch, part.faces)


def hull(seed: int = 0) -> Hull:
    return Hull(np.random.default_rng(seed).normal(size=(300, 3)))


def add_balls(scene: oc.Scene, first: Mesh, second: Mesh) -> None:
    """Add two meshes that collide."""
    scene.add("a", first)
    scene.add("b", second, (0.5, 0, 0, 0, 0, 0, 1))


def checked_on(scene: oc.Scene) -> list[oc.Accuracy]:
    return [oc.Accuracy(level) for level in scene.check().accuracies]


def settled(scene: oc.Scene, trees: outside.OutsideTrees, builder: Builder) -> oc.Report:
    """Check until nothing is being built, and a check finds nothing to do; return its report."""
    for _ in range(100):  # one is enough for what is built at once
        report = scene.check()
        if not trees.waiting and scene.check() is report:
            return report
        wait_built(builder)
    raise AssertionError("trees are built in vain")


def results(report: oc.Report) -> list[tuple[str, str, int, int]]:
    names = report.names()
    rows = zip(names, report.verdicts.tolist(), report.accuracies.tolist(), strict=True)
    return sorted((str(a), str(b), verdict, level) for (a, b), verdict, level in rows)


@each("level", ["hull", "mesh"])
def test_pairs_wait_on_obb(builder: Builder, level: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scenes = [oc.Scene(accuracy=level), oc.Scene(accuracy=level)]
    trees = scenes[0].objects.build_outside(builder)
    for scene in scenes:
        shapes: list[Shape] = [ball(1), ball(2), hull(3), hull(4), Box((1.0, 2.0, 0.5))]
        for number, shape in enumerate(shapes):
            scene.add(str(number), shape, (0.9 * number, 0.2 * number, 0, 0, 0, 0.6, 0.8))
    expected = results(scenes[1].check())
    for name in ("mesh_tree", "hull_tree", "hull_mesh"):
        monkeypatch.setattr(pools, name, None)  # not in this process
    first = scenes[0].check()
    assert len(first) >= len(expected), "a check that does not wait loses nothing"
    assert set(first.accuracies.tolist()) == {oc.Accuracy.OBB}
    assert trees.waiting
    assert results(settled(scenes[0], trees, builder)) == expected
    assert trees.waiting == len(builder) == 0


def test_the_accuracy_may_rise_while_meshes_are_there(builder: Builder) -> None:
    scene = oc.Scene()
    trees = scene.objects.build_outside(builder)
    add_balls(scene, ball(), ball(1))
    assert checked_on(scene) == [oc.Accuracy.OBB]
    assert trees.waiting == 0, "nothing is built before it is asked for"
    scene.accuracy = "mesh"
    assert checked_on(scene) == [oc.Accuracy.OBB]
    assert trees.waiting == 2
    assert settled(scene, trees, builder).accuracies.tolist() == [oc.Accuracy.MESH]


def test_small_shapes_are_built_at_once(builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = oc.Scene(accuracy="mesh")
    trees = scene.objects.build_outside(builder)
    scene.add("a", Mesh(np.eye(3), [[0, 1, 2]]))
    scene.add("b", Box((1.0, 1.0, 1.0)))
    for seconds, level in ((0.0, oc.Accuracy.OBB), (PATIENCE, oc.Accuracy.MESH)):
        monkeypatch.setattr(outside, "AT_ONCE", seconds)
        assert checked_on(scene) == [level]
    assert trees.waiting == 0


def test_what_fails_is_on_obb_and_told(builder: Builder, monkeypatch: pytest.MonkeyPatch) -> None:
    run = builder.process.run

    def fails(task: Task, limits: Limits) -> None:
        raise BuildError("not enough memory")

    monkeypatch.setattr(builder.process, "run", fails)
    scene = oc.Scene(accuracy="mesh")
    trees = scene.objects.build_outside(builder)
    shape = ball()
    add_balls(scene, shape, shape)
    assert checked_on(scene) == [oc.Accuracy.OBB]
    wait_built(builder)
    assert checked_on(scene) == [oc.Accuracy.OBB]
    assert trees.failed == {"not enough memory": 1}
    assert checked_on(scene) == [oc.Accuracy.OBB]
    assert trees.waiting == 0, "it is not tried again at each check"
    scene.clear()
    assert not trees.failed
    add_balls(scene, shape, shape)
    scene.check()
    wait_built(builder)
    scene.check()
    assert trees.failed == {"not enough memory": 1}
    monkeypatch.setattr(builder.process, "run", run)
    add_balls(scene, ball(1), ball(1))
    assert not trees.failed
    assert settled(scene, trees, builder).accuracies.tolist() == [oc.Accuracy.MESH]


def test_what_is_taken_out_is_not_built(builder: Builder) -> None:
    scene = oc.Scene(accuracy="mesh")
    trees = scene.objects.build_outside(builder)
    add_balls(scene, ball(), ball(1))
    scene.check()
    scene.remove("a")
    assert trees.waiting == 1
    scene.clear()
    assert trees.waiting == 0
    scene.add("c", ball())
    scene.add("d", ball(1), (0.5, 0, 0, 0, 0, 0, 1))
    assert settled(scene, trees, builder).accuracies.tolist() == [oc.Accuracy.MESH]


def test_kernels_are_looked_for_in_the_folders_that_this_process_has(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    mesh_tree(ball())  # its kernels are in the cache now
    (tmp_path / "file").write_text("")  # where no kernel can be kept
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "file"))
    places = [tmp_path / "file", *_kernel_cache.places]
    monkeypatch.setattr(_kernel_cache, "places", places)
    scene = oc.Scene(accuracy="mesh")
    with closing(Builder()) as own:
        trees = scene.objects.build_outside(own)
        add_balls(scene, ball(), ball(1))
        assert settled(scene, trees, own).accuracies.tolist() == [oc.Accuracy.MESH]
    assert "compiling kernels" not in capfd.readouterr().err


@each("small_pool", [0, 500, 10**9])
def test_objects_come_and_go_and_the_verdicts_are_those_of_a_scene_that_waits(
    builder: Builder, monkeypatch: pytest.MonkeyPatch, small_pool: int
) -> None:
    monkeypatch.setattr(outside, "SMALL_POOL", small_pool)
    rng = np.random.default_rng(small_pool % 1000)
    kinds = [ball(k) for k in range(4)] + [ball(9, 1280), hull(1), Box((1.0, 1.0, 2.0))]
    kinds.append(Mesh(np.eye(3), [[0, 1, 2]]))
    scenes = oc.Scene(accuracy="mesh"), oc.Scene(accuracy="mesh")
    trees = scenes[0].objects.build_outside(builder)
    for step in range(60):
        name, shape = str(rng.integers(8)), kinds[rng.integers(len(kinds))]
        pose = (*rng.uniform(-1.5, 1.5, 3), *rng.normal(size=4) + 1e-9)
        remove = rng.uniform() < 0.4
        for scene in scenes:
            if remove and name in scene:
                scene.remove(name)
            elif not remove:
                scene.add(name, shape, np.array(pose) / [1, 1, 1, *[np.linalg.norm(pose[3:])] * 4])
        found = results(scenes[0].check())
        expected = results(scenes[1].check())
        assert {row[:2] for row in expected} <= {row[:2] for row in found}, "nothing is missed"
        if step % 6 == 5:
            assert results(settled(scenes[0], trees, builder)) == expected


def per_shape_of(kind: type[TreePool] = TreePool) -> shape_cache.PerShape[oc.MeshTrees]:
    made: shape_cache.PerShape[oc.MeshTrees] = shape_cache.PerShape(TreePool)
    made.pool = kind()
    return made


def triangle(number: int) -> Mesh:
    return Mesh(np.eye(3) * (1.0 + number), [[0, 1, 2]])


def add_outside(trees: shape_cache.PerShape[oc.MeshTrees], number: int) -> tuple[Any, Any, int]:
    """Build a triangle, and add its tree as another thread does."""
    job = outside.BuildJob(triangle(number), trees)
    pool, item, row = job.finish(perform(job.task()))
    return pool, item, row


def first_corners(trees: shape_cache.PerShape[oc.MeshTrees], slots: list[int]) -> list[float]:
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
        """Has all the time."""

        def left(self) -> float:
            return 1.0

    begun, go = threading.Event(), threading.Event()

    class Slow(TreePool):
        """Waits for the test."""

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
    pool, item, empty = TreePool(), mesh_tree(triangle(1)), np.empty
    pool.append(mesh_tree(triangle(0)))
    calls: list[Any] = []

    def fails(*given: Any) -> Any:
        calls.append(given)
        if len(calls) == 5:
            raise MemoryError
        return empty(*given)

    monkeypatch.setattr(np, "empty", fails)
    with pytest.raises(MemoryError):
        pool.append(item)
    monkeypatch.undo()
    assert pool.size == 1
    assert pool.append(mesh_tree(triangle(2))) == 1
    assert [len(getattr(pool.all, name)) for name in ("roots", "solid", "radii")] == [2, 2, 2]
    assert pool.all.triangles[pool.all.starts[pool.all.roots[1], 0]].max() == 3.0

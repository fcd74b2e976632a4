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

"""Arrays of every kind are read as what they hold, and no index changes once it is checked."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from itertools import count
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import pytest
from each import each

import obb_collision as oc
from obb_collision.shapes import Box, Mesh

TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
IDENTITY = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
FAR = 2**40


class Subclass(np.ndarray):
    """An array whose comparisons and copies lie."""

    def __lt__(self, other: Any) -> Any:
        return np.zeros(self.shape, bool)

    __ge__ = __gt__ = __lt__

    def copy(self, *_: Any) -> Any:
        return np.full(self.shape, FAR)

    def __len__(self) -> int:
        return 0


class Wrapped:
    """Anything that becomes an array."""

    def __init__(self, array: np.ndarray) -> None:
        self.array = array

    def __array__(self, dtype: Any = None, copy: Any = None) -> np.ndarray:
        return self.array


def mapped(array: np.ndarray, folder: Path) -> np.memmap:
    file = np.memmap(folder / "array", array.dtype, "w+", shape=array.shape)
    file[...] = array
    return np.memmap(folder / "array", array.dtype, "r", shape=array.shape)


def read_only(array: np.ndarray) -> np.ndarray:
    array = array.copy()
    array.setflags(write=False)
    return array


def spread(array: np.ndarray) -> np.ndarray:
    """Return an array whose rows and columns are apart in memory, and backwards."""
    wide = np.zeros((2 * len(array), *(3 * size for size in array.shape[1:])), array.dtype)
    view = wide[::-2][(slice(None), *(slice(None, None, 3) for _ in array.shape[1:]))]
    view[...] = array
    return view


def unaligned(array: np.ndarray) -> np.ndarray:
    data = b"\0" + array.tobytes()
    return np.frombuffer(data, np.uint8)[1:].view(array.dtype).reshape(array.shape)


def big_endian(array: np.ndarray) -> np.ndarray:
    return array.astype(array.dtype.newbyteorder(">"))


KINDS: dict[str, Callable[[np.ndarray, Path], Any]] = {
    "a list": lambda a, _: a.tolist(),
    "in Fortran's order": lambda a, _: np.asfortranarray(a),
    "apart in memory": lambda a, _: spread(a),
    "read-only": lambda a, _: read_only(a),
    "big-endian": lambda a, _: big_endian(a),
    "unaligned": lambda a, _: unaligned(a),
    "of objects": lambda a, _: a.astype(object) if a.dtype.kind == "f" else a.astype(">i4"),
    "memory-mapped": mapped,
    "a subclass that lies": lambda a, _: a.view(Subclass),
    "masked": lambda a, _: np.ma.array(a),
    "wrapped": lambda a, _: Wrapped(a),
    "of another size": lambda a, _: a.astype("f4") if a.dtype.kind == "f" else a.astype("u2"),
}


def boxes() -> oc.Boxes:
    return oc.Boxes(TETRAHEDRON, [np.eye(3)] * 4, np.full((4, 3), 0.75))


def moved(indices: Any = (1, 0), poses: Any = ([1.0, *IDENTITY[1:]], [5.0, *IDENTITY[1:]])) -> Any:
    scene = oc.Scene()
    for name in "abc":
        scene.add(name, Box([1.0, 1.0, 1.0]))
    scene.move_indices(indices, poses)
    return scene.objects.poses_of([0, 1, 2])


PAIRS = np.array([[0, 1], [2, 3], [0, 0]])
CALLS: dict[str, tuple[Callable[[Any], Any], np.ndarray]] = {
    "verdicts pairs": (lambda v: oc.verdicts(boxes(), boxes(), v), PAIRS),
    "separations pairs": (lambda v: oc.separations(boxes(), boxes(), v).verdicts, PAIRS),
    "verdicts of meshes pairs": (lambda v: oc.verdicts(bodies(), bodies(), v), PAIRS[:1]),
    "PlacedMeshes meshes": (lambda v: oc.verdicts(bodies(v), bodies(), [[0, 1]]), FACES[0, :2]),
    "Mesh vertices": (lambda v: Mesh(v, FACES).local_box, TETRAHEDRON),
    "Mesh faces": (lambda v: Mesh(TETRAHEDRON, v).faces, FACES),
    "MeshTrees faces": (lambda v: oc.MeshTrees.build(TETRAHEDRON, v).triangles, FACES),
    "Boxes": (lambda v: oc.find_pairs(oc.Boxes(v, [np.eye(3)] * 4, np.ones((4, 3)))), TETRAHEDRON),
    "Boxes.from_points": (
        lambda v: oc.Boxes.from_points(TETRAHEDRON, v).half_extents,
        np.array([0, 2, 4]),
    ),
    "Boxes[rows]": (lambda v: boxes()[v].centers, np.array([3, 0])),
    "points_inside": (lambda v: oc.points_inside(boxes(), v).counts, TETRAHEDRON * 0.5),
    "cast_rays": (lambda v: oc.cast_rays(boxes(), v, np.ones((4, 3))).distances, TETRAHEDRON),
    "move_indices": (moved, np.array([1, 0])),
    "move_indices poses": (lambda v: moved(poses=v), np.array([IDENTITY, [3.0, *IDENTITY[1:]]])),
    "poses_of": (lambda v: one_scene().objects.poses_of(v), np.array([0, 0])),
}


def one_scene() -> oc.Scene:
    scene = oc.Scene()
    scene.add("a", Box([1.0, 1.0, 1.0]))
    return scene


def bodies(meshes: Any = (0, 1)) -> oc.PlacedMeshes:
    tree = oc.MeshTrees.build(TETRAHEDRON, FACES)
    trees = oc.MeshTrees.join([tree] * 4)
    return oc.PlacedMeshes(trees, meshes, np.zeros((2, 3)), [np.eye(3)] * 2)


def same(a: Any, b: Any) -> bool:
    if isinstance(a, tuple):
        return all(map(same, a, b))
    return np.array_equal(a, b)


@each("kind", KINDS)
@pytest.mark.parametrize("name", CALLS)
def test_arrays_of_every_kind_are_read_as_what_they_hold(
    name: str, kind: str, tmp_path: Path
) -> None:
    call, good = CALLS[name]
    if kind in ("a list", "wrapped") and name == "Boxes[rows]":
        pytest.skip("numpy's own rules of indexing")
    assert same(call(KINDS[kind](good.copy(), tmp_path)), call(good))


@each("name", CALLS)
def test_what_is_given_is_not_kept(name: str) -> None:
    """What was given can be written afterwards: nothing refers to it."""
    call, good = CALLS[name]
    given = good.copy()
    expected, found = call(good), call(given)
    given[...] = FAR
    assert same(found, expected)


def test_indices_that_kernels_follow_cannot_be_written() -> None:
    placed = bodies()
    given = vars(oc.MeshTrees.build(TETRAHEDRON, FACES))
    names = [name for name, value in given.items() if isinstance(value, np.ndarray)]
    copies = {name: given[name].copy() for name in names}
    trees = oc.MeshTrees(**copies)
    for name in names:
        with pytest.raises(ValueError, match="read-only"):
            getattr(trees, name)[...] = 0
        before = getattr(trees, name).copy()
        copies[name][...] = 0
        assert np.array_equal(getattr(trees, name), before)
    for array in (placed.meshes, placed.trees.children, placed.trees.starts):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = FAR


RACES: dict[str, tuple[Callable[[np.ndarray], Any], np.ndarray]] = {
    "pairs": (lambda v: oc.verdicts(boxes(), boxes(), v), np.zeros((5000, 2), np.int64)),
    "contacts": (lambda v: oc.contacts(boxes(), boxes(), v), np.zeros((500, 2), np.int64)),
    "meshes": (lambda v: oc.verdicts(bodies(), bodies(), v), np.zeros((50, 2), np.int64)),
    "faces": (lambda v: Mesh(TETRAHEDRON, v).local_box, np.zeros((5000, 3), np.int64)),
    "offsets": (lambda v: oc.Boxes.from_points(TETRAHEDRON, v, fit="aabb"), np.array([0, 2, 4])),
    "indices": (moved, np.array([1, 0])),
}


@each("name", RACES)
def test_indices_may_be_written_by_another_thread_meanwhile(name: str) -> None:
    """They are refused, or those of before or after are used; nothing outside is touched."""
    call, good = RACES[name]
    given, ended, switched = good.copy(), Event(), count()

    def write() -> None:
        while not ended.is_set():
            given.reshape(-1)[-1] = FAR
            given[...] = good
            next(switched)

    writer = Thread(target=write)
    writer.start()
    try:
        answers = 0
        while answers < 20 or next(switched) < 20:
            with suppress(ValueError, KeyError):
                call(given)
            answers += 1
    finally:
        ended.set()
        writer.join()


NUMBERS = (np.nan, np.inf, -np.inf, 1e308, -1e308)


@each("number", NUMBERS)
@each("name", ["centers", "rotations", "half_extents"])
def test_boxes_that_are_written_afterwards_lead_nowhere(name: str, number: float) -> None:
    """The answers mean nothing, but no kernel reads or writes outside of its arrays.

    With numba's checks of bounds, an access outside raises IndexError.
    """
    rng = np.random.default_rng(5)
    poses = np.column_stack([rng.normal(size=(100, 3)), np.tile([0.0, 0.0, 0.6, 0.8], (100, 1))])
    written = oc.Boxes.from_poses(poses, np.full((100, 3), 0.2))
    getattr(written, name).reshape(100, -1)[rng.integers(0, 100, 30), 0] = number
    with np.errstate(all="ignore"):
        for rows in (oc.find_pairs(written), oc.find_pairs(written, written)):
            assert ((rows >= 0) & (rows < 100)).all()
        oc.any_collision(written)
        found = oc.points_inside(written, rng.normal(size=(1000, 3)))
        assert ((found.nearest >= -1) & (found.nearest < 1000)).all()

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

"""Pools of trees and hulls: arrays that grow by doubling, so an append costs the new item only."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from threading import Lock
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.shapes.primitives import Shape
from obb_collision.geometry.trees.convex_proxy import box_corners, hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees, TreeArrays, shifted
from obb_collision.geometry.validation import as_array
from obb_collision.numerics.intrinsics import LANES, in_blocks
from obb_collision.typing import Floats, Integers, Rows


def mesh_tree(mesh: Mesh) -> MeshTrees:
    """Return the tree of a mesh's triangles, scaled; its first node has the mesh's local box.

    ValueError for a mesh without faces.
    """
    used, faces = np.unique(mesh.faces, return_inverse=True)  # unused vertices do not count
    vertices = mesh.vertices[used] * np.array(mesh.scale)
    root = mesh.local_box if len(used) else None
    return MeshTrees.of(vertices, faces.reshape(-1, 3), root=root)


def box_tree(half_extents: Floats) -> MeshTrees:
    """Return the tree of a box about the origin; half_extents (3,), metres."""
    return MeshTrees.from_half_extents(half_extents)


@lru_cache(maxsize=256)
def segment_tree(half: float) -> MeshTrees:
    """Return the tree of a segment from -half to half (m) along z, or of a point, as a triangle."""
    ends = np.array([[0.0, 0.0, -half], [0.0, 0.0, half], [0.0, 0.0, half]])
    return MeshTrees.of(ends, np.array([[0, 1, 2]]))


def segment_trees(halves: Floats) -> tuple[MeshTrees, Rows]:
    """Return a tree per distinct half length, and the row of the tree of each segment (n,)."""
    lengths, rows = np.unique(halves, return_inverse=True)
    return MeshTrees.join([segment_tree(half) for half in lengths.tolist()]), rows.ravel()


def hull_tree(shape: Shape) -> MeshTrees:
    """Return the tree of a convex mesh that certainly contains a shape (see ``hull_mesh``).

    It may exceed the largest coordinate accepted for a shape.
    """
    return MeshTrees.of(*hull_mesh(shape))


Item = TypeVar("Item")
Arrays = dict[str, NDArray[Any]]
#: A shape, or the half extents (3,) of a box about the origin.
Body = Shape | Floats


class Hulls(NamedTuple):
    """k hulls: corners in ``blocks[starts[i]:starts[i + 1]]``, and radii (k,) about the origin.

    blocks: (m, 3, LANES), see ``numerics.intrinsics``; corners may be repeated.
    """

    blocks: Floats
    starts: Integers
    radii: Floats

    @classmethod
    def of(cls, corners: Floats) -> Hulls:
        """Return the hull of corners (n, 3)."""
        radius = np.abs(corners).sum(axis=1).max()
        blocks = in_blocks(corners)
        return cls(blocks, np.array([0, len(blocks)]), np.array([radius]))


class Pool(Generic[Item]):
    """Items in arrays, one after another: trees, or hulls.

    Threads append under ``lock``. ``all`` may be read at any time: it contains every item whose
    ``append`` has returned, and later ones do not change it.
    """

    names: ClassVar[tuple[str, ...]]
    """Names of the arrays of an item."""
    measure: ClassVar[str]
    """Name of the array whose length is the size of an item."""
    made: ClassVar[Callable[..., Any]]
    """Makes an item from its arrays by name."""

    def __init__(self) -> None:
        self.lock = Lock()
        self._arrays: Arrays = {}
        self._used = dict.fromkeys(self.names, 0)
        self._all: Item | None = None

    @property
    def all(self) -> Item:
        """All items; there must be at least one."""
        assert self._all is not None
        return self._all

    @property
    def size(self) -> int:
        """Number of triangles of all trees, or of blocks of corners of all hulls."""
        return self._used[self.measure]

    @classmethod
    def size_of(cls, item: Item) -> int:
        """Return the number of triangles of a tree, or of blocks of corners of a hull."""
        return len(getattr(item, cls.measure))

    @classmethod
    def arrays(cls, item: Item) -> Arrays:
        """Return the arrays of an item by name."""
        return {name: getattr(item, name) for name in cls.names}

    @classmethod
    def received(cls, arrays: Sequence[NDArray[Any]]) -> Item:
        """Return an item from arrays of another process; ValueError for invalid arrays."""
        raise NotImplementedError

    def append(self, item: Item) -> int:
        """Add an item; return its row. If memory runs out, nothing changes."""
        row = self._used["radii"]
        rows = self.arrays(item)
        rows |= self._moved(rows)
        for name, values in rows.items():
            self._reserve(name, values)
        used = {name: self._used[name] + len(values) for name, values in rows.items()}
        for name, values in rows.items():
            self._arrays[name][self._used[name] : used[name]] = values
        items = self.made(**{name: self._arrays[name][: used[name]] for name in self.names})
        self._used, self._all = used, items
        return row

    def _reserve(self, name: str, values: NDArray[Any]) -> None:
        used, needed = self._used[name], self._used[name] + len(values)
        array = self._arrays.get(name)
        if array is None or len(array) < needed:
            larger = np.empty((max(needed, 2 * used), *values.shape[1:]), values.dtype)
            if array is not None:
                larger[:used] = array[:used]
            self._arrays[name] = larger

    @staticmethod
    def built(body: Body) -> Item:
        """Return the item of a body."""
        raise NotImplementedError

    def _moved(self, arrays: Arrays) -> Arrays:
        """Return the arrays that refer to rows, shifted past the items present."""
        raise NotImplementedError


class TreePool(Pool[MeshTrees]):
    """Trees, appended one by one as ``MeshTrees.join`` joins them.

    A mesh has the tree of its triangles, another shape the tree of its hull.
    """

    names = TreeArrays._fields
    measure = "triangles"
    made = MeshTrees.trusted

    @staticmethod
    def built(body: Body) -> MeshTrees:
        """Return the tree of a body."""
        if isinstance(body, np.ndarray):
            return box_tree(body)
        return mesh_tree(body) if isinstance(body, Mesh) else hull_tree(body)

    @classmethod
    def received(cls, arrays: Sequence[NDArray[Any]]) -> MeshTrees:
        """Return a checked tree."""
        return MeshTrees(**dict(zip(cls.names, arrays, strict=True)))

    def _moved(self, arrays: Arrays) -> Arrays:
        return shifted(arrays, *(self._used[name] for name in ("nodes", "triangles", "pieces")))


class HullTreePool(TreePool):
    """Trees of the hulls of shapes, for questions on ``HULL`` that need surfaces."""

    @staticmethod
    def built(body: Body) -> MeshTrees:
        """Return the tree of a hull."""
        return box_tree(body) if isinstance(body, np.ndarray) else hull_tree(body)


class HullPool(Pool[Hulls]):
    """Hulls, one after another."""

    names = Hulls._fields
    measure = "blocks"
    made = Hulls

    @staticmethod
    def built(body: Body) -> Hulls:
        """Return the hull of a body."""
        corners = box_corners(body) if isinstance(body, np.ndarray) else hull_mesh(body)[0]
        return Hulls.of(corners)

    @classmethod
    def received(cls, arrays: Sequence[NDArray[Any]]) -> Hulls:
        """Return a checked hull."""
        sent = Hulls(*arrays)
        blocks = as_array(sent.blocks, "blocks", (None, 3, LANES))
        radii, starts = as_array(sent.radii, "radii", (1,)), np.array([0, len(blocks)])
        if len(blocks) == 0 or not np.array_equal(sent.starts, starts):
            raise ValueError("starts must be those of one hull")
        return Hulls(blocks, starts, radii)

    def _moved(self, arrays: Arrays) -> Arrays:
        return {"starts": arrays["starts"][1 if self.size else 0 :] + self.size}

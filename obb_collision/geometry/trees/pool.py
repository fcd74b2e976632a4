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

"""Trees and hulls one after another in arrays that grow by doubling: each costs its own size."""

from __future__ import annotations

from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.typing import Floats, Integers

TREE_ARRAYS = tuple(item.name for item in fields(MeshTrees))


class Hulls(NamedTuple):
    """Corners (v, 3) of k hulls, ``corners[starts[i]:starts[i + 1]]``, and radii (k,) about 0."""

    corners: Floats
    starts: Integers
    radii: Floats

    @classmethod
    def of(cls, corners: Floats) -> Hulls:
        """Return one hull."""
        radius = np.abs(corners).sum(axis=1).max()
        return cls(corners, np.array([0, len(corners)]), np.array([radius]))


class _Buffers:
    """Named arrays to which rows are added; what was handed out stays as it was."""

    def __init__(self) -> None:
        self._arrays: dict[str, NDArray[Any]] = {}
        self._used: dict[str, int] = {}

    def used(self, name: str) -> int:
        return self._used.get(name, 0)

    def part(self, name: str) -> NDArray[Any]:
        return self._arrays[name][: self._used[name]]

    def extend(self, rows: dict[str, NDArray[Any]]) -> None:
        """Add rows to all arrays or, where there is no memory for that, to none."""
        for name, values in rows.items():
            self._reserve(name, values)
        for name, values in rows.items():
            used = self.used(name)
            self._arrays[name][used : used + len(values)] = values
            self._used[name] = used + len(values)

    def _reserve(self, name: str, values: NDArray[Any]) -> None:
        used, needed = self.used(name), self.used(name) + len(values)
        array = self._arrays.get(name)
        if array is None or len(array) < needed:
            larger = np.empty((max(needed, 2 * used), *values.shape[1:]), values.dtype)
            if array is not None:
                larger[:used] = array[:used]
            self._arrays[name] = larger


class TreePool:
    """What ``MeshTrees.join`` makes, tree by tree."""

    def __init__(self) -> None:
        self._buffers = _Buffers()
        self._all: MeshTrees | None = None

    @property
    def size(self) -> int:
        """The number of triangles of all trees."""
        return self._buffers.used("triangles")

    @property
    def all(self) -> MeshTrees:
        """All trees, of which there must be one."""
        if self._all is None:
            self._all = MeshTrees.trusted(
                **{name: self._buffers.part(name) for name in TREE_ARRAYS}
            )
        return self._all

    @staticmethod
    def size_of(tree: MeshTrees) -> int:
        """Return the number of triangles of a tree."""
        return len(tree.triangles)

    def append(self, tree: MeshTrees) -> int:
        """Add a tree; return its row."""
        used = self._buffers.used
        row, nodes = used("roots"), used("nodes")
        shifted = {
            "children": np.where(tree.children < 0, -1, tree.children + nodes),
            "starts": tree.starts + used("triangles"),
            "roots": tree.roots + nodes,
            "piece_starts": tree.piece_starts[1 if row else 0 :] + used("pieces"),
        }
        rows = {name: shifted.get(name, getattr(tree, name)) for name in TREE_ARRAYS}
        self._buffers.extend(rows)
        self._all = None
        return row


class HullPool:
    """Hulls, one after another."""

    def __init__(self) -> None:
        self._buffers = _Buffers()

    @property
    def size(self) -> int:
        """The number of corners of all hulls."""
        return self._buffers.used("corners")

    @property
    def all(self) -> Hulls:
        """All hulls, of which there must be one."""
        return Hulls(*(self._buffers.part(name) for name in Hulls._fields))

    @staticmethod
    def size_of(hull: Hulls) -> int:
        """Return the number of corners of a hull."""
        return len(hull.corners)

    def append(self, hull: Hulls) -> int:
        """Add a hull; return its row."""
        row, corners = self._buffers.used("radii"), self.size
        self._buffers.extend(
            {
                "corners": hull.corners,
                "starts": hull.starts[1 if row else 0 :] + corners,
                "radii": hull.radii,
            }
        )
        return row

"""Trees one after another in arrays that grow by doubling, so that a new one costs its own size."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.mesh_tree import MeshTrees

NAMES = tuple(item.name for item in fields(MeshTrees))


class TreePool:
    """What ``MeshTrees.join`` makes, tree by tree."""

    def __init__(self) -> None:
        self._buffers: dict[str, NDArray[Any]] = {}
        self._used = dict.fromkeys(NAMES, 0)
        self._trees: MeshTrees | None = None

    def __len__(self) -> int:
        return self._used["roots"]

    @property
    def triangles(self) -> int:
        """The number of triangles of all trees."""
        return self._used["triangles"]

    @property
    def trees(self) -> MeshTrees:
        """All trees, as views that stay as they are. There must be one."""
        if self._trees is None:
            parts = {name: self._buffers[name][: self._used[name]] for name in NAMES}
            self._trees = MeshTrees(**parts)
        return self._trees

    def append(self, tree: MeshTrees) -> int:
        """Add a tree (or several); return the row of the first."""
        row = len(self)
        nodes, triangles, pieces = (self._used[k] for k in ("nodes", "triangles", "pieces"))
        shifted = {
            "children": np.where(tree.children < 0, -1, tree.children + nodes),
            "starts": tree.starts + triangles,
            "roots": tree.roots + nodes,
            "piece_starts": tree.piece_starts[1 if row else 0 :] + pieces,
        }
        for name in NAMES:
            self._extend(name, shifted.get(name, getattr(tree, name)))
        self._trees = None
        return row

    def _extend(self, name: str, values: NDArray[Any]) -> None:
        used, needed = self._used[name], self._used[name] + len(values)
        buffer = self._buffers.get(name)
        if buffer is None or len(buffer) < needed:
            larger = np.empty((max(needed, 2 * used), *values.shape[1:]), values.dtype)
            if buffer is not None:
                larger[:used] = buffer[:used]
            self._buffers[name] = buffer = larger
        buffer[used:needed] = values
        self._used[name] = needed

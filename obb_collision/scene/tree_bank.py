"""The trees of a scene's shapes: built when a rung above OBB first asks, once a shape."""

from __future__ import annotations

from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.geometry.meshes import Hull, Mesh
from obb_collision.geometry.shape_trees import box_tree, hull_tree, mesh_tree
from obb_collision.geometry.shapes import Box, Shape
from obb_collision.obb import OBB
from obb_collision.scene.store import ObjectStore, Rows

#: Kinds of shapes: without a mesh (decided by their boxes), boxes, triangles, hulls.
BOXED, BOX, TRIANGLES, CONVEX = range(4)

#: Whether it is the tree of a hull, and of what: a shape, or the bytes of half extents.
Key = tuple[bool, Hashable]


def kind_of(shape: Shape | OBB) -> int:
    """Return what a shape is to the rungs above OBB; a Mesh without faces has no triangles."""
    if isinstance(shape, (Box, OBB)):
        return BOX
    if isinstance(shape, Hull):
        return CONVEX
    return TRIANGLES if isinstance(shape, Mesh) and len(shape.faces) else BOXED


class TreeBank:
    """Shapes by slot, and the trees of those that were asked for, joined into one.

    Meshes and hulls count as the same if they are the same object, boxes if their half extents
    are equal. Trees that no slot needs any more go when the next one is built.
    """

    def __init__(self) -> None:
        self.shapes: dict[int, Mesh | Hull] = {}
        self._trees: dict[Key, MeshTrees] = {}
        self._rows: dict[Key, int] = {}
        self._joined: MeshTrees | None = None

    def put(self, slot: int, shape: Shape | OBB) -> int:
        """Keep the shape of a slot if a tree may be asked of it; return its kind."""
        self.shapes.pop(slot, None)
        if isinstance(shape, (Mesh, Hull)):
            self.shapes[slot] = shape
        return kind_of(shape)

    def __len__(self) -> int:
        return len(self._trees)

    def rows(
        self, store: ObjectStore, slots: Rows, hull: bool
    ) -> tuple[MeshTrees, NDArray[np.int64]]:
        """Return the joined trees and the row of each slot in them; hull: those of the hulls."""
        makers = [self._maker(store, slot, hull) for slot in slots.tolist()]
        missing = {key: make for key, make in makers if key not in self._trees}
        if missing or self._joined is None:
            live: set[Hashable] = set(self.shapes.values())
            live |= {row.tobytes() for row in store.local_half_extents[store.used]}
            self._trees = {key: tree for key, tree in self._trees.items() if key[1] in live}
            self._trees.update({key: make() for key, make in missing.items()})
            self._rows = {key: row for row, key in enumerate(self._trees)}
            self._joined = MeshTrees.join(list(self._trees.values()))
        return self._joined, np.array([self._rows[key] for key, _ in makers], np.int64)

    def _maker(
        self, store: ObjectStore, slot: int, hull: bool
    ) -> tuple[Key, Callable[[], MeshTrees]]:
        """Return the key of a slot's tree and how to build it."""
        shape = self.shapes.get(slot)
        if shape is None:
            extents = store.local_half_extents[slot].copy()
            return (hull, extents.tobytes()), lambda: box_tree(extents, hull)
        if isinstance(shape, Hull):
            return (True, shape), lambda: hull_tree(shape)
        return (hull, shape), lambda: hull_tree(shape) if hull else mesh_tree(shape)

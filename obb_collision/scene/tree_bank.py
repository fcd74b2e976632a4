"""The trees of a scene's shapes: built when a rung above OBB first asks, once a shape."""

from __future__ import annotations

from collections.abc import Hashable

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.mesh_tree import MeshTrees
from obb_collision.geometry.meshes import Hull, Mesh
from obb_collision.geometry.shape_trees import box_tree, hull_tree, mesh_tree
from obb_collision.geometry.shapes import Box, Shape
from obb_collision.geometry.tree_pool import TreePool
from obb_collision.obb import OBB
from obb_collision.scene.budget import Budget
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
    """Shapes by slot, and the trees of those that were asked for, in one pool.

    Meshes and hulls count as the same if they are the same object, boxes if their half extents
    are equal. Trees that no slot needs any more leave the pool when they are half of it.
    """

    def __init__(self) -> None:
        self._shapes: dict[int, Mesh | Hull] = {}
        self._trees: dict[Key, MeshTrees] = {}
        self._users: dict[Key, set[tuple[bool, int]]] = {}
        self._keys: dict[tuple[bool, int], Key] = {}
        self._rows = [np.full(0, -1), np.full(0, -1)]  # by slot: of triangles, of hulls
        self._pool = TreePool()

    def put(self, slot: int, shape: Shape | OBB) -> int:
        """Keep the shape of a slot if a tree may be asked of it; return its kind."""
        self.drop(slot)
        if isinstance(shape, (Mesh, Hull)):
            self._shapes[slot] = shape
        return kind_of(shape)

    def drop(self, slot: int) -> None:
        """Let the shape of a slot go."""
        self._shapes.pop(slot, None)
        for hull in (False, True):
            key = self._keys.pop((hull, slot), None)
            if key is not None:
                self._rows[hull][slot] = -1
                self._users[key].discard((hull, slot))
                if not self._users[key]:
                    del self._users[key], self._trees[key]

    def __len__(self) -> int:
        return len(self._trees)

    @property
    def trees(self) -> MeshTrees:
        """The trees that ``rows`` speaks of; building others leaves these as they are."""
        return self._pool.trees

    def rows(self, slots: Rows, hull: bool) -> NDArray[np.int64]:
        """Return the row (k,) of each slot's tree, -1 for none yet; hull: that of its hull."""
        known = slots < len(self._rows[hull])
        result = np.full(len(slots), -1)
        result[known] = self._rows[hull][slots[known]]
        return result

    def build(
        self, store: ObjectStore, slots: Rows, hull: bool, budget: Budget | None
    ) -> NDArray[np.bool_]:
        """Build trees that slots lack, while there is time; return (k,) which have theirs."""
        missing = np.unique(slots[self.rows(slots, hull) < 0])
        if len(missing):
            short = len(store.names) - len(self._rows[hull])
            self._rows[hull] = np.append(self._rows[hull], np.full(max(0, short), -1))
            for slot in missing.tolist():
                if budget is not None and budget.left() <= 0.0:
                    break
                self._build(store, slot, hull)
            self._compact()
        return self.rows(slots, hull) >= 0

    def _build(self, store: ObjectStore, slot: int, hull: bool) -> None:
        shape = self._shapes.get(slot)
        extents = store.local_half_extents[slot]
        what: Hashable = extents.tobytes() if shape is None else shape
        key = hull or isinstance(shape, Hull), what
        if key in self._trees:
            other_hull, other = next(iter(self._users[key]))
            row = int(self._rows[other_hull][other])
        else:
            if shape is None:
                tree = box_tree(extents, hull)
            elif hull or isinstance(shape, Hull):
                tree = hull_tree(shape)
            else:
                tree = mesh_tree(shape)
            self._trees[key], self._users[key] = tree, set()
            row = self._pool.append(tree)
        self._keys[hull, slot] = key
        self._users[key].add((hull, slot))
        self._rows[hull][slot] = row

    def _compact(self) -> None:
        """Make the pool anew where half of it is of no use any more."""
        used = sum(len(tree.triangles) for tree in self._trees.values())
        if 2 * used >= self._pool.triangles:
            return
        self._pool = TreePool()
        for key, tree in self._trees.items():
            row = self._pool.append(tree)
            for hull, slot in self._users[key]:
                self._rows[hull][slot] = row

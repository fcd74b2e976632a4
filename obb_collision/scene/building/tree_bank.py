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

"""The trees and hulls of a scene's shapes: built once per shape, when first asked for."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterable
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.fitting.enclosing import round_up
from obb_collision.geometry.shapes.meshes import Mesh
from obb_collision.geometry.trees.convex_proxy import box_corners, hull_mesh
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import HullPool, Hulls, TreePool
from obb_collision.geometry.trees.shape_trees import box_tree, hull_tree, mesh_tree
from obb_collision.obb import OBB
from obb_collision.scene.building.shelf import Item, Shelf
from obb_collision.scene.store.store import ObjectStore
from obb_collision.shapes import Box, Capsule, Shape, Sphere
from obb_collision.typing import Rows

if TYPE_CHECKING:
    from obb_collision.scene.building.outside import OutsideTrees, TimeLeft

#: Kinds of shapes: decided by their boxes only, boxes, spheres and capsules, other convex ones,
#: triangles.
BOXED, BOX, ROUND, CONVEX, TRIANGLES = range(5)


def kind_of(shape: Shape | OBB) -> int:
    """Return what a shape is to the levels above OBB; a Mesh without faces has no triangles."""
    if isinstance(shape, (Box, OBB)):
        return BOX
    if isinstance(shape, Mesh):
        return TRIANGLES if len(shape.faces) else BOXED
    round_one = isinstance(shape, (Sphere, Capsule)) and len(set(shape.scale)) == 1
    return ROUND if round_one else CONVEX


class TreeBank:
    """Shapes by slot, and the trees and hulls of those that were asked for.

    Shapes count as the same if they are the same object, boxes if their half extents are equal.
    """

    def __init__(self) -> None:
        self._shapes: dict[int, Shape] = {}
        self._trees: Shelf[MeshTrees, MeshTrees] = Shelf(TreePool)
        self._hulls: Shelf[Hulls, Hulls] = Shelf(HullPool)
        self._round: dict[int, tuple[float, float]] = {}
        self.outside: OutsideTrees | None = None
        """What builds the trees and hulls of large shapes, so that a check does not wait."""

    def put(self, slot: int, shape: Shape | OBB) -> int:
        """Keep the shape of a slot if more than its box may be asked of it; return its kind."""
        self.drop(slot)
        if not isinstance(shape, (Box, OBB)):
            self._shapes[slot] = shape
        if kind_of(shape) == ROUND:
            self._round[slot] = round_sizes(shape)
        return kind_of(shape)

    def drop(self, slot: int) -> None:
        """Let the shape of a slot go."""
        shape = self._shapes.pop(slot, None)
        self._round.pop(slot, None)
        self._trees.drop(slot)
        self._hulls.drop(slot)
        if self.outside is not None and shape is not None:
            self.outside.drop(slot, shape)

    def drop_many(self, slots: Iterable[int]) -> None:
        """Let the shapes of slots go."""
        if self._shapes or len(self):  # boxes leave nothing here as a rule
            for slot in slots:
                self.drop(slot)

    def __len__(self) -> int:
        return len(self._trees) + len(self._hulls)

    def trees(self, slots: Rows) -> tuple[MeshTrees, NDArray[np.int64]]:
        """Return trees, and the row (k,) of each slot's among them, -1 for none yet."""
        return self._trees.all, self._trees.rows(slots)

    def hulls(self, slots: Rows) -> tuple[Hulls, NDArray[np.int64]]:
        """Return hulls, and the row (k,) of each slot's among them, -1 for none yet."""
        return self._hulls.all, self._hulls.rows(slots)

    def rounds(self, slots: Rows) -> NDArray[np.float64]:
        """Return the radius and half the length (k, 2) of spheres and capsules, metres."""
        return np.array([self._round[slot] for slot in slots.tolist()]).reshape(-1, 2)

    def build(
        self, store: ObjectStore, slots: Rows, hull: bool, budget: TimeLeft | None
    ) -> NDArray[np.bool_]:
        """Build hulls or trees that slots lack, while there is time; return (k,) which have one."""

        def key_of(slot: int) -> Hashable:
            shape = self._shapes.get(slot)
            return store.local_half_extents[slot].tobytes() if shape is None else shape

        def make_tree(slot: int) -> MeshTrees:
            shape = self._shapes.get(slot)
            if shape is None:
                return box_tree(store.local_half_extents[slot])
            return mesh_tree(shape) if isinstance(shape, Mesh) else hull_tree(shape)

        def make_hull(slot: int) -> Hulls:
            shape = self._shapes.get(slot)
            if shape is None:
                return Hulls.of(box_corners(store.local_half_extents[slot]))
            return Hulls.of(hull_mesh(shape)[0])

        if hull:
            return self._build(self._hulls, slots, key_of, make_hull, budget)
        return self._build(self._trees, slots, key_of, make_tree, budget)

    def take_built(self) -> None:
        """Take the trees and hulls that were built outside since the last time."""
        if self.outside is not None:
            self.outside.take((self._trees, self._hulls))

    def _build(
        self,
        shelf: Shelf[Item, Any],
        slots: Rows,
        key_of: Callable[[int], Hashable],
        make: Callable[[int], Item],
        budget: TimeLeft | None,
    ) -> NDArray[np.bool_]:
        if self.outside is None:
            return shelf.build(slots, key_of, make, budget)
        rest = self.outside.order(shelf, slots, self._shapes)
        shelf.build(rest, key_of, make, self.outside.timer(budget), compact=False)
        return shelf.rows(slots) >= 0


def round_sizes(shape: Shape | OBB) -> tuple[float, float]:
    """Return the radius and half the length of a sphere or capsule, scaled, not too small."""
    if not isinstance(shape, (Sphere, Capsule)):
        raise TypeError(f"a {type(shape).__name__} is not round")
    scale = Fraction(shape.scale[0])
    length = Fraction(shape.length) / 2 if isinstance(shape, Capsule) else Fraction(0)
    radius, half = Fraction(shape.radius) * scale, length * scale
    return (
        round_up(radius.numerator, radius.denominator),
        round_up(half.numerator, half.denominator),
    )

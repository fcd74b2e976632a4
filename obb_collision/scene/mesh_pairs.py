"""Pairs of one check above OBB: their trees, where they are, and their verdicts on a rung."""

from __future__ import annotations

from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.validation import Floats
from obb_collision.queries.accuracy import Accuracy
from obb_collision.queries.mesh_collision import (
    PlacedMeshes,
    mesh_collisions,
    mesh_verdicts,
    tree_collisions,
)
from obb_collision.queries.separation import SEPARATE, TOUCHING, Verdicts
from obb_collision.scene.budget import ABOVE, Budget
from obb_collision.scene.store import ObjectStore, Rows
from obb_collision.scene.tree_bank import BOX, BOXED, CONVEX, TreeBank


def prepare_trees(store: ObjectStore, bank: TreeBank) -> None:
    """Build the trees that the rungs of all objects may need, and compile what looks at them."""
    wanted = np.flatnonzero(
        store.active & (store.accuracies > Accuracy.OBB) & (store.kinds != BOXED)
    )
    if len(wanted) == 0:
        return
    for hull in (False, True):
        bank.build(store, wanted, hull, None)
    pair = MeshPairs(store, bank, wanted[:1], wanted[:1], 0, False)
    for rung in ABOVE:
        pair.prepare(rung, np.zeros(1, np.int64), None)
        pair.decide(rung, np.zeros(1, np.int64))


class MeshPairs:
    """Pairs (m,), (m,) of slots with trees; a ``refinement.Job``.

    depth: of the boxes on OBB_TREE.
    """

    def __init__(
        self, store: ObjectStore, bank: TreeBank, first: Rows, second: Rows, depth: int, exact: bool
    ) -> None:
        self._store, self._bank = store, bank
        self._depth, self._exact = depth, exact
        self._slots, ends = np.unique(np.concatenate([first, second]), return_inverse=True)
        self._ends = ends[: len(first)], ends[len(first) :]
        self._bodies: dict[bool, PlacedMeshes] = {}

    def prepare(self, rung: Accuracy, rows: Rows, budget: Budget | None) -> NDArray[np.bool_]:
        """Build the trees that pairs need while there is time; return (k,) which have theirs."""
        hull = rung == Accuracy.HULL
        i, j = self._ends[0][rows], self._ends[1][rows]
        needed = np.unique(np.concatenate([i, j]))
        ready = np.zeros(len(self._slots), np.bool_)
        ready[needed] = self._bank.build(self._store, self._slots[needed], hull, budget)
        if ready.any():
            trees = self._bank.rows(self._slots, hull)
            self._bodies[hull] = PlacedMeshes.trusted(self._bank.trees, trees, *self._places)
        return ready[i] & ready[j]

    @cached_property
    def _places(self) -> tuple[Floats, Floats]:
        """Where the shapes are: meshes at their poses, boxes where their boxes are."""
        store, slots = self._store, self._slots
        centers, rotations = as_poses(store.poses[slots])
        boxes = store.kinds[slots] == BOX
        centers[boxes], rotations[boxes] = (
            store.centers[slots[boxes]],
            store.rotations[slots[boxes]],
        )
        return centers, rotations

    def decide(self, rung: Accuracy, rows: Rows) -> Verdicts:
        """Return verdicts (k,) of prepared pairs; OVERLAP only where it holds for the shapes."""
        bodies = self._bodies[rung == Accuracy.HULL]
        i, j = self._ends[0][rows], self._ends[1][rows]
        if rung == Accuracy.OBB_TREE:
            met = tree_collisions(bodies, bodies, self._depth, i, j)
        elif rung == Accuracy.HULL:
            met = mesh_collisions(bodies, bodies, i, j)
        else:
            verdicts = mesh_verdicts(bodies, bodies, i, j, self._exact)
            convex = self._store.kinds[self._slots] == CONVEX  # grown: larger than their shape
            return np.where(convex[i] | convex[j], np.minimum(verdicts, TOUCHING), verdicts)
        return np.where(met, np.int8(TOUCHING), np.int8(SEPARATE))

"""Deciding pairs on the rungs of ``Accuracy``: which rung a pair gets, and what it says.

A pair is decided on the lower rung of its two objects' accuracies. The rungs above OBB need a
mesh or hull on one side and a mesh, hull or box on the other, and no padding, which meshes don't
model; else the pair stays on OBB. They look only at what OBB reports.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.queries.accuracy import Accuracy
from obb_collision.queries.coarse import bounds_meet
from obb_collision.queries.mesh_collision import (
    PlacedMeshes,
    mesh_collisions,
    mesh_verdicts,
    tree_collisions,
)
from obb_collision.queries.separation import SEPARATE, TOUCHING, Verdicts, pair_verdicts
from obb_collision.scene.broad_phase import Pairs
from obb_collision.scene.pairs import coarse_meet, columns
from obb_collision.scene.store import ObjectStore, Rows
from obb_collision.scene.tree_bank import BOX, BOXED, CONVEX, TreeBank

Rungs = NDArray[np.int8]
#: Pairs (m, 2) of slots, sorted, their verdicts (m,) and their rungs (m,).
Found = tuple[Pairs, Verdicts, Rungs]


def is_plain(store: ObjectStore) -> bool:
    """Return whether every pair is decided on OBB."""
    levels = store.accuracies[store.active]
    if (levels == Accuracy.OBB).all():
        return True
    meshes = (store.kinds[store.active] > BOX).any()
    return bool((levels >= Accuracy.OBB).all() and not meshes)


def needs_spheres(store: ObjectStore) -> bool:
    """Return whether the broad phase must look for spheres, too, that overlap."""
    return bool((store.accuracies[store.active] == Accuracy.SPHERE).any())


def pair_rungs(store: ObjectStore, first: Rows, second: Rows) -> Rungs:
    """Return the rung (m,) int8 that decides each pair of slots."""
    rungs: Rungs = np.minimum(store.accuracies[first], store.accuracies[second])
    kinds = np.stack([store.kinds[first], store.kinds[second]])
    padded = (store.paddings[first] > 0.0) | (store.paddings[second] > 0.0)
    boxes_only = (kinds == BOXED).any(axis=0) | (kinds == BOX).all(axis=0) | padded
    return np.where(boxes_only, np.minimum(rungs, np.int8(Accuracy.OBB)), rungs)


def decide_pairs(
    store: ObjectStore, bank: TreeBank, candidates: Pairs, depth: int, exact: bool
) -> Found:
    """Return the candidates (m, 2), pairs of slots whose bounds meet, that are not SEPARATE."""
    boxes = store.all_boxes()
    first, second = columns(candidates)
    rungs = pair_rungs(store, first, second)
    if needs_spheres(store):
        kept = (rungs == Accuracy.SPHERE) | bounds_meet(boxes, first, second)
        first, second, rungs = first[kept], second[kept], rungs[kept]
    verdicts = _box_verdicts(boxes, first, second, rungs, exact)
    for rung in (Accuracy.OBB_TREE, Accuracy.HULL, Accuracy.MESH):
        rows = np.flatnonzero((rungs == rung) & (verdicts != SEPARATE))
        if len(rows):
            ends = first[rows], second[rows]
            verdicts[rows] = _mesh_verdicts(store, bank, *ends, rung, depth, exact)
    found = np.flatnonzero(verdicts != SEPARATE)
    found = found[np.lexsort((second[found], first[found]))]
    pairs = np.stack([first[found], second[found]], axis=1)
    return pairs, verdicts[found], rungs[found]


def _box_verdicts(boxes: Boxes, first: Rows, second: Rows, rungs: Rungs, exact: bool) -> Verdicts:
    """Return verdicts (m,) on each pair's rung, at most on OBB."""
    result = np.full(len(first), SEPARATE, np.int8)
    for rung in (Accuracy.SPHERE, Accuracy.AABB, Accuracy.OBB_FACES):
        rows = np.flatnonzero(rungs == rung)
        if len(rows):
            meet = coarse_meet(boxes, first[rows], second[rows], rung)
            result[rows[meet]] = TOUCHING
    rows = np.flatnonzero(rungs >= Accuracy.OBB)
    result[rows] = pair_verdicts(boxes, first[rows], boxes, second[rows], exact)
    return result


def _mesh_verdicts(
    store: ObjectStore, bank: TreeBank, first: Rows, second: Rows,
    rung: Accuracy, depth: int, exact: bool,
) -> Verdicts:  # fmt: skip
    """Return verdicts (m,) on a rung above OBB; OVERLAP only where it holds for the shapes."""
    slots, ends = np.unique(np.concatenate([first, second]), return_inverse=True)
    bodies = _placed(store, bank, slots, rung == Accuracy.HULL)
    i, j = ends[: len(first)], ends[len(first) :]
    if rung == Accuracy.OBB_TREE:
        met = tree_collisions(bodies, bodies, depth, i, j)
    elif rung == Accuracy.HULL:
        met = mesh_collisions(bodies, bodies, i, j)
    else:
        verdicts = mesh_verdicts(bodies, bodies, i, j, exact)
        grown = (store.kinds[first] == CONVEX) | (store.kinds[second] == CONVEX)
        return np.where(grown, np.minimum(verdicts, np.int8(TOUCHING)), verdicts)
    return np.where(met, np.int8(TOUCHING), np.int8(SEPARATE))


def _placed(store: ObjectStore, bank: TreeBank, slots: Rows, hull: bool) -> PlacedMeshes:
    """Return the bodies of slots: meshes at their poses, boxes where their boxes are."""
    trees, rows = bank.rows(store, slots, hull)
    centers, rotations = as_poses(store.poses[slots])
    boxes = store.kinds[slots] == BOX
    centers[boxes], rotations[boxes] = store.centers[slots[boxes]], store.rotations[slots[boxes]]
    return PlacedMeshes(trees, rows, centers, rotations)

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

"""The bodies of objects for kernels: convex cores, trees of triangles, and where they are."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import segment_trees
from obb_collision.numerics.constants import ROUNDOFF
from obb_collision.queries.convex.support import BOX_CORE, NO_HULLS, ConvexBodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.scene.building.shape_cache import BOX, ROUND, ShapeCache
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Rows

#: Error of placing and padding a capsule or a ball, relative to its coordinates: 128 roundoffs,
#: half of them from rotations that are orthonormal to 64.
PLACING = 128 * ROUNDOFF


def places_of(store: ObjectStore, boxes: Boxes, slots: Rows) -> tuple[Floats, Floats]:
    """Return centres and rotations of slots (k,): of poses, or of ``boxes`` where a slot is a box.

    boxes: the padded boxes of all slots.
    """
    centers, rotations = boxes.centers[slots], boxes.rotations[slots]
    shaped = np.flatnonzero(store.kinds[slots] > BOX)
    centers[shaped], rotations[shaped] = as_poses(store.poses[slots[shaped]], warn=False)
    return centers, rotations


def trees_of(store: ObjectStore, cache: ShapeCache, slots: Rows) -> tuple[MeshTrees, Rows, Floats]:
    """Return trees, the row (k,) of each slot's tree, and radii (k,) with padding.

    Trees of spheres and capsules are segments; either all slots have these shapes, or none.
    """
    radii = store.paddings[slots]
    if (store.kinds[slots] == ROUND).any():
        halves, own = cache.cores(slots)[:, 4:].T
        return *segment_trees(halves), own + radii
    return *cache.trees(slots), radii


def convex_bodies(store: ObjectStore, cache: ShapeCache, boxes: Boxes, slots: Rows) -> ConvexBodies:
    """Return the bodies of slots (k,) with padding, and the hulls built so far.

    boxes: of all slots, padded.
    """
    shaped = np.flatnonzero(store.kinds[slots] > BOX)
    cores = np.zeros((len(slots), 6))
    cores[:, 0], cores[:, 1:4] = BOX_CORE, boxes.half_extents[slots]
    cores[shaped] = cache.cores(slots[shaped])
    cores[shaped, 5] += store.paddings[slots[shaped]]
    kinds, sizes, radii = cores[:, 0].astype(np.int8), cores[:, 1:5].copy(), cores[:, 5].copy()
    hulls = cache.hulls(slots)
    return ConvexBodies(kinds, sizes, radii, *hulls, *places_of(store, boxes, slots))


def box_bodies(boxes: Boxes, slots: Rows) -> ConvexBodies:
    """Return the padded boxes of slots (k,) as bodies; boxes: of all slots."""
    count = len(slots)
    kinds, sizes = np.full(count, BOX_CORE, np.int8), np.zeros((count, 4))
    sizes[:, :3] = boxes.half_extents[slots]
    hulls = NO_HULLS, np.zeros(count, np.int64)
    return ConvexBodies(
        kinds, sizes, np.zeros(count), *hulls, boxes.centers[slots], boxes.rotations[slots]
    )


def placed_meshes(
    store: ObjectStore, cache: ShapeCache, boxes: Boxes, slots: Rows
) -> tuple[PlacedMeshes, Floats]:
    """Return the placed trees of slots (k,), and radii (k,) with padding; see ``trees_of``."""
    trees, rows, radii = trees_of(store, cache, slots)
    return PlacedMeshes.trusted(trees, rows, *places_of(store, boxes, slots)), radii

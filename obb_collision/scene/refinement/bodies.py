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

"""What stands for objects above OBB, and where it is: trees of triangles, and convex bodies."""

from __future__ import annotations

import numpy as np

from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.geometry.trees.pool import segment_trees
from obb_collision.queries.convex.support import BOX as BOX_CORE
from obb_collision.queries.convex.support import ConvexBodies
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.store.kinds import BOX, ROUND
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Rows


def places_of(store: ObjectStore, boxes: Boxes, slots: Rows) -> tuple[Floats, Floats]:
    """Return centres and rotations (k,) of slots: of shapes by their poses, else of their boxes.

    boxes: of all slots, padded.
    """
    centers, rotations = boxes.centers[slots], boxes.rotations[slots]
    shaped = np.flatnonzero(store.kinds[slots] > BOX)
    centers[shaped], rotations[shaped] = as_poses(store.poses[slots[shaped]], warn=False)
    return centers, rotations


def trees_of(store: ObjectStore, cache: ShapeCache, slots: Rows) -> tuple[MeshTrees, Rows, Floats]:
    """Return trees, the row (k,) of each slot's among them, and radii (k,) with the padding.

    Of spheres and capsules they are those of their segments; either all of them are round or none.
    """
    radii = store.paddings[slots]
    if (store.kinds[slots] == ROUND).any():
        halves, own = cache.cores(slots)[:, 4:].T
        return *segment_trees(halves), own + radii
    return *cache.trees(slots), radii


def convex_bodies(store: ObjectStore, cache: ShapeCache, boxes: Boxes, slots: Rows) -> ConvexBodies:
    """Return the bodies of slots (k,) with padding, which is part of boxes as such.

    boxes: as for ``places_of``; hulls: those that there are.
    """
    shaped = np.flatnonzero(store.kinds[slots] > BOX)
    cores = np.zeros((len(slots), 6))
    cores[:, 0], cores[:, 1:4] = BOX_CORE, boxes.half_extents[slots]
    cores[shaped] = cache.cores(slots[shaped])
    cores[shaped, 5] += store.paddings[slots[shaped]]
    kinds, sizes, radii = cores[:, 0].astype(np.int8), cores[:, 1:5].copy(), cores[:, 5].copy()
    hulls = cache.hulls(slots)
    return ConvexBodies(kinds, sizes, radii, *hulls, *places_of(store, boxes, slots))

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

"""What rays hit in a scene: each object at its accuracy, as a box, a hull or its triangles.

Round shapes are what they are, and padding is a ball about any shape, above OBB.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.poses import as_poses
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.rays.rays import (
    RayHits,
    as_rays,
    cast_at_bodies,
    cast_at_padded,
    cast_rays,
)
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.refinement.ladder import NONE
from obb_collision.scene.refinement.placed_shapes import AS_PAIRS, PlacedShapes
from obb_collision.scene.store.kinds import TRIANGLES
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Rows


def cast_at_objects(
    store: ObjectStore, cache: ShapeCache, slots: Rows, level: Accuracy | None,
    origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike,
) -> RayHits:  # fmt: skip
    """Return what rays hit first of objects; ``boxes`` are slots.

    level: of all of them, None for theirs.
    """
    rays = as_rays(origins, directions, max_distance)
    levels = np.full(len(slots), Accuracy.OBB, np.int8)
    shapes = None
    if (store.accuracies[slots] if level is None else np.int8(level)).max(initial=0) > Accuracy.OBB:
        shapes = PlacedShapes(store, cache, NONE[0], NONE[2], None)
        choice = AS_PAIRS if level is None else max(level, Accuracy.OBB).name.lower()
        levels = shapes.object_levels(slots, choice)
    plain = slots[levels == Accuracy.OBB]
    best = _nearer(None, cast_rays(store.boxes(plain), origins, directions, max_distance), plain)
    if shapes is None:
        return best
    meshes, thick = store.kinds[slots] == TRIANGLES, store.paddings[slots] > 0.0
    for one in (Accuracy.HULL, Accuracy.MESH):
        some = slots[meshes & ~thick & (levels == one)]
        if len(some):
            targets = _surfaces(store, cache, some, one)
            best = _nearer(best, cast_rays(targets, origins, directions, max_distance), some)
    some = slots[meshes & thick & (levels == Accuracy.MESH)]
    if len(some):
        targets, radii = _surfaces(store, cache, some, Accuracy.MESH), store.paddings[some]
        best = _nearer(best, cast_at_padded(targets, radii, rays), some)
    some = slots[(~meshes | thick) & (levels == Accuracy.HULL)]
    if len(some):
        bodies = shapes.convex_bodies(store.all_boxes(), some)
        best = _nearer(best, cast_at_bodies(bodies, store.boxes(some), rays), some)
    return best


def _surfaces(store: ObjectStore, cache: ShapeCache, slots: Rows, level: Accuracy) -> PlacedMeshes:
    """Return the hulls or meshes of slots (k,) where they are."""
    trees = cache.surfaces(slots, level == Accuracy.HULL)
    return PlacedMeshes.trusted(*trees, *as_poses(store.poses[slots], warn=False))


def _nearer(best: RayHits | None, found: RayHits, slots: Rows) -> RayHits:
    """Return the nearer hits of both; found: rows of slots."""
    rows = np.append(slots, -1)[found.boxes]
    faces = np.full(len(rows), -1) if found.faces is None else found.faces
    named = RayHits(rows, found.distances, found.positions, found.normals, faces)
    if best is None:
        return named
    nearer = (named.distances < best.distances) | (
        (named.distances == best.distances) & (named.boxes >= 0) & (named.boxes < best.boxes)
    )
    columns = [
        np.where(nearer if one.ndim == 1 else nearer[:, None], one, other)
        for one, other in zip(vars(named).values(), vars(best).values(), strict=True)
    ]
    return RayHits(*columns)

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

"""What rays hit in a scene: each object at its accuracy, as a box, a hull or its triangles."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.queries.meshes.meshes import PlacedMeshes
from obb_collision.queries.rays.rays import RayHits, cast_rays
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.store.kinds import BOX
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Rows


def cast_at_objects(
    store: ObjectStore, cache: ShapeCache, level: Accuracy | None,
    origins: ArrayLike, directions: ArrayLike, max_distance: ArrayLike,
) -> RayHits:  # fmt: skip
    """Return what rays hit first; ``boxes`` are slots. level: of all objects, None for theirs.

    Padded objects are their boxes.
    """
    best = None
    for slots, targets in _targets(store, cache, level):
        found = cast_rays(targets, origins, directions, max_distance)
        best = _nearer(best, found, slots)
    assert best is not None
    return best


def _targets(
    store: ObjectStore, cache: ShapeCache, level: Accuracy | None
) -> Iterator[tuple[Rows, Boxes | PlacedMeshes]]:
    """Yield slots and what stands for them: boxes, hulls, triangles."""
    slots = np.flatnonzero(store.active)
    levels = store.accuracies[slots] if level is None else np.full(len(slots), level, np.int8)
    levels = np.where(store.paddings[slots] > 0.0, np.int8(Accuracy.OBB), levels)
    shaped = (levels >= Accuracy.HULL) & (store.kinds[slots] > BOX)
    yield slots[~shaped], store.boxes(slots[~shaped])
    for one in (Accuracy.HULL, Accuracy.MESH):
        some = slots[shaped & (levels == one)]
        if len(some):
            trees = cache.surfaces(some, one == Accuracy.HULL)
            places = as_poses(store.poses[some], warn=False)
            yield some, PlacedMeshes.trusted(*trees, *places)


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

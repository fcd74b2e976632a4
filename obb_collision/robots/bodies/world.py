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

"""The objects of a scene as convex bodies that do not move, and a tree over their bounds."""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

import numpy as np

from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.circumscribed import excess
from obb_collision.geometry.trees.convex_proxy import HULL_MARGIN
from obb_collision.geometry.trees.obb_tree import BOX_CORNERS
from obb_collision.numerics.intrinsics import LANES
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.robots.bodies.bodies import RADIUS_GROWTH, Body, joined, merged, placed_body
from obb_collision.robots.bodies.state_arrays import Bodies
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.building.shape_cache import ShapeCache
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Rows


class WorldState:
    """What a scene was at one time, to see whether it has changed since.

    left_out: names of objects that do not count.
    """

    def __init__(self, scene: Scene, left_out: Collection[str] = ()) -> None:
        self._left_out = left_out
        self._note(scene)
        self._world = self._others(scene)

    def _note(self, scene: Scene) -> None:
        self._key, self._snapshot = _key(scene), scene._store.snapshot()
        self._active = scene._store.active.copy()

    def _others(self, scene: Scene) -> tuple[Floats | Rows, ...]:
        """Return the slots of what counts, and the boxes there."""
        slots = world_slots(scene._store, self._left_out)
        boxes = scene._store.boxes(slots)
        return slots, boxes.centers, boxes.rotations, boxes.half_extents

    def is_current(self, scene: Scene) -> bool:
        """Return whether nothing has changed since that bodies depend on."""
        if _key(scene) != self._key:
            return False
        if self._snapshot.is_current and np.array_equal(scene._store.active, self._active):
            return True
        others = self._others(scene)
        if not all(np.array_equal(a, b) for a, b in zip(others, self._world, strict=True)):
            return False
        self._note(scene)  # something else has moved
        return True


def _key(scene: Scene) -> tuple[object, ...]:
    """Return what changes with the names, shapes and rules of a scene."""
    store = scene._store
    return store, store.version, store.revision, scene._allowed.version


def world_slots(store: ObjectStore, left_out: Collection[str]) -> Rows:
    """Return the slots that count, ascending."""
    counted = store.active.copy()
    counted[[store.slots[name] for name in left_out if name in store.slots]] = False
    return np.flatnonzero(counted)


Kept = dict[int, tuple[object, Body]]
"""By slot: a body, and all that it depends on."""


class World(NamedTuple):
    """The objects of a scene: slots (w,), bodies (w,) in the same order, the tree over them."""

    slots: Rows
    bodies: Bodies
    tree: BoundsTree


def world_of(
    store: ObjectStore, cache: ShapeCache, frame: int, origin: Floats, left_out: Collection[str],
    kept: Kept,
) -> World:  # fmt: skip
    """Return what a scene holds, relative to an origin (3,); frame: the number of the world's.

    left_out: names of objects that do not count; kept: those that need not be made anew.
    """
    active = world_slots(store, left_out)
    boxed = np.isin(store.kinds[active], (BOX, BOXED))
    plain, others = active[boxed], active[~boxed]
    slots = np.concatenate([plain, others])
    bodies = merged(
        _boxes(store, plain, frame, origin),
        joined(_others(store, cache, others, frame, origin, kept)),
    )
    boxes = store.boxes(slots)
    minimum, maximum = meeting_bounds(boxes)
    return World(slots, bodies, BoundsTree.build(minimum - origin, maximum - origin))


def _boxes(store: ObjectStore, slots: Rows, frame: int, origin: Floats) -> Bodies:
    """Return boxes as bodies, all at once."""
    count = len(slots)
    centers, rotations = store.centers[slots] - origin, store.rotations[slots]
    half_extents = store.half_extents[slots]
    grown = half_extents + HULL_MARGIN * half_extents.max(axis=1, keepdims=True, initial=0.0)
    corners = centers[:, None] + np.einsum("nij,nkj->nki", rotations, BOX_CORNERS * grown[:, None])
    radii = np.abs(corners).sum(axis=2).max(axis=1, initial=0.0)
    return Bodies(
        np.full(count, frame), centers, rotations, half_extents,
        np.linalg.norm(grown, axis=1) * RADIUS_GROWTH, half_extents.min(axis=1, initial=np.inf),
        np.ones(count, np.bool_), np.zeros(count), radii, radii, np.zeros(count),
        np.ascontiguousarray(corners.transpose(0, 2, 1)), np.arange(count + 1),
    )  # fmt: skip


def _others(
    store: ObjectStore, cache: ShapeCache, slots: Rows, frame: int, origin: Floats, kept: Kept
) -> list[Body]:
    """Return objects that are no boxes, and keep them for the next time."""
    state = store, store.version, store.revision, frame, origin.tobytes()
    keys = [(state, pose.tobytes()) for pose in store.poses[slots]]
    known = [kept.get(slot, (None, None))[0] for slot in slots.tolist()]
    new = slots[[one != other for one, other in zip(keys, known, strict=True)]]
    made = dict(zip(new.tolist(), _made(store, cache, new, frame, origin), strict=True))
    bodies = [made[slot] if slot in made else kept[slot][1] for slot in slots.tolist()]
    kept.clear()
    kept.update(zip(slots.tolist(), zip(keys, bodies, strict=True), strict=True))
    return bodies


def _made(
    store: ObjectStore, cache: ShapeCache, slots: Rows, frame: int, origin: Floats
) -> list[Body]:
    if len(slots) == 0:
        return []
    centers, rotations = as_poses(store.poses[slots], warn=False)
    boxes = store.boxes(slots)
    hulls = None
    if (store.kinds[slots] != ROUND).any():
        cache.at_once().build(store, slots[store.kinds[slots] != ROUND], True, None)
        hulls, rows = cache.hulls(slots)
    result = []
    for n, slot in enumerate(slots.tolist()):
        radius = float(store.paddings[slot])
        if store.kinds[slot] == ROUND:
            ((own, half),) = cache.rounds(slots[n : n + 1])
            corners, radius = np.array([(0.0, 0.0, -half), (0.0, 0.0, half)]), radius + own
        else:
            assert hulls is not None
            blocks = hulls.blocks[hulls.starts[rows[n]] : hulls.starts[rows[n] + 1]]
            corners = blocks.transpose(0, 2, 1).reshape(len(blocks) * LANES, 3)
        beyond = excess(cache.shape(slot), corners)
        corners = corners @ rotations[n].T + (centers[n] - origin)
        box = boxes.centers[n] - origin, boxes.rotations[n], boxes.half_extents[n]
        result.append(placed_body(corners, radius, frame, 0.0, box, beyond=beyond))
    return result

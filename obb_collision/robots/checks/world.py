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

"""The objects of a scene for robots: convex bodies that do not move, and meshes.

All that robots take from the inside of a scene is taken here.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import NamedTuple

import numpy as np

from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.circumscribed import excess
from obb_collision.geometry.trees.pool import segment_trees
from obb_collision.numerics.intrinsics import LANES
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.verdict.coarse import meeting_bounds
from obb_collision.robots.checks.arrays import LinkBodies
from obb_collision.robots.checks.bodies import box_bodies, joined, placed_body
from obb_collision.scene.broad_phase.bounds_tree import BoundsTree
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.allowed import AllowedPairs
from obb_collision.scene.store.kinds import BOX, BOXED, ROUND
from obb_collision.scene.store.pair_table import PairFilter
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
        slots = _counted(scene._store, self._left_out)
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


def _counted(store: ObjectStore, left_out: Collection[str]) -> Rows:
    """Return the slots that count, ascending."""
    counted = store.active.copy()
    counted[[store.slots[name] for name in left_out if name in store.slots]] = False
    return np.flatnonzero(counted)


def padding_of(scene: Scene, name: str) -> float:
    """Return the padding of an object; KeyError for an unknown one."""
    return float(scene._store.paddings[scene._store.slot(name)])


def largest_padding(scene: Scene, names: Iterable[str]) -> float:
    """Return the largest padding that objects have themselves; some may be unknown."""
    slots = [scene._store.slots[name] for name in names if name in scene._store.slots]
    return float(scene._store.own_paddings[slots].max(initial=0.0))


def pair_rules(scene: Scene, names: list[str]) -> PairFilter | None:
    """Return which pairs of names count by the rules of a scene, None for all."""
    rules = AllowedPairs()
    rules.replace(AllowedPairs.of(scene.allowed))
    rules.only, rules.within = scene.check_only, scene.allowed_within
    return rules.pair_filter(names, 0)


Kept = dict[int, tuple[object, LinkBodies]]
"""By slot: a body, and all that it depends on."""


class World(NamedTuple):
    """The objects of a scene, relative to an origin (3,), and the tree over their bounds."""

    scene: Scene
    origin: Floats
    slots: Rows  #: (w,)
    kinds: Rows  #: (w,) as in ``scene.store.kinds``
    names: list[str]
    bodies: LinkBodies
    tree: BoundsTree

    def placed(self, rows: Rows, segments: bool) -> tuple[PlacedMeshes, Floats]:
        """Return objects (k,) as meshes, and their radii; segments: all of them are."""
        store, slots = self.scene._store, self.slots[rows]
        centers, rotations = as_poses(store.poses[slots], warn=False)
        boxes = store.kinds[slots] == BOX
        centers[boxes] = store.centers[slots[boxes]]
        rotations[boxes] = store.rotations[slots[boxes]]
        radii = store.paddings[slots].copy()
        cache = self.scene._cache
        if segments:
            sizes = cache.rounds(slots)
            trees, numbers = segment_trees(sizes[:, 1])
            radii += sizes[:, 0]
        else:
            cache = cache.at_once()
            cache.build(store, np.unique(slots), False, None)
            trees, numbers = cache.trees(slots)
        return PlacedMeshes.trusted(trees, numbers, centers - self.origin, rotations), radii


def world_of(
    scene: Scene, frame: int, origin: Floats, left_out: Collection[str], kept: Kept
) -> World:
    """Return what a scene holds; frame: the number of the world's.

    left_out: names of objects that do not count; kept: bodies that need not be made anew.
    """
    store = scene._store
    active = _counted(store, left_out)
    boxed = np.isin(store.kinds[active], (BOX, BOXED))
    plain, others = active[boxed], active[~boxed]
    slots = np.concatenate([plain, others])
    state = store, store.version, store.revision, frame, origin.tobytes()
    keys = {slot: (state, store.poses[slot].tobytes()) for slot in others.tolist()}
    new = [slot for slot, key in keys.items() if slot not in kept or kept[slot][0] != key]
    made = dict(zip(new, _made(scene, np.array(new, np.int64), frame, origin), strict=True))
    bodies = {slot: made[slot] if slot in made else kept[slot][1] for slot in keys}
    kept.clear()
    kept.update({slot: (keys[slot], body) for slot, body in bodies.items()})
    boxes = store.centers[plain] - origin, store.rotations[plain], store.half_extents[plain]
    minimum, maximum = meeting_bounds(store.boxes(slots))
    return World(
        scene,
        origin,
        slots,
        store.kinds[slots],
        [str(store.names[slot]) for slot in slots],
        joined([box_bodies(*boxes, frame), *bodies.values()]),
        BoundsTree.build(minimum - origin, maximum - origin),
    )


def _made(scene: Scene, slots: Rows, frame: int, origin: Floats) -> list[LinkBodies]:
    """Return the bodies of objects that are no boxes."""
    if len(slots) == 0:
        return []
    store, cache = scene._store, scene._cache
    centers, rotations = as_poses(store.poses[slots], warn=False)
    boxes, radii = store.boxes(slots), store.paddings[slots].copy()
    solid = store.kinds[slots] != ROUND
    if solid.any():
        cache = cache.at_once()
        cache.build(store, slots[solid], True, None)
        hulls, rows = cache.hulls(slots)
    result = []
    for n, slot in enumerate(slots.tolist()):
        if solid[n]:
            blocks = hulls.blocks[hulls.starts[rows[n]] : hulls.starts[rows[n] + 1]]
            corners = blocks.transpose(0, 2, 1).reshape(len(blocks) * LANES, 3)
        else:
            ((own, half),) = cache.rounds(slots[n : n + 1])
            corners, radii[n] = np.array([(0.0, 0.0, -half), (0.0, 0.0, half)]), radii[n] + own
        beyond = excess(cache.shape(slot), corners)
        corners = corners @ rotations[n].T + (centers[n] - origin)
        box = boxes.centers[n] - origin, boxes.rotations[n], boxes.half_extents[n]
        result.append(placed_body(corners, float(radii[n]), frame, box, beyond))
    return result

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

"""Pairs of a cloud and another object: verdicts, distances and sweeps by the balls near the object.

A ball is a point with a radius, so what holds for spheres holds for it. The balls near the box of
the other object are compared with that box (on OBB), its hull, or its triangles. The nearest ball
of a pair counts, or the deepest ones.

Radii are grown by as much as rounding may have moved a ball, so that nothing is missed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import BoxArrays, Boxes
from obb_collision.geometry.poses import as_poses
from obb_collision.geometry.trees.clouds import Cloud
from obb_collision.geometry.trees.obb_tree import MeshTrees
from obb_collision.queries.convex.distances import (
    ConvexDistances,
    convex_distances,
    convex_may_collide,
    mesh_body_distances,
)
from obb_collision.queries.convex.support import NO_HULLS, SEGMENT_CORE, ConvexBodies
from obb_collision.queries.mesh_contacts.mesh_convex import within_bodies
from obb_collision.queries.meshes.placed import PlacedMeshes
from obb_collision.queries.points.near_points import near_points
from obb_collision.queries.verdict.verdict import (
    OVERLAP,
    SEPARATE,
    TOUCHING,
    Separations,
    Verdicts,
)
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.building.shape_cache import CLOUD, ShapeCache
from obb_collision.scene.refinement.bodies import (
    PLACING,
    box_bodies,
    convex_bodies,
    placed_meshes,
)
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.store.store import ObjectStore
from obb_collision.typing import Floats, Mask, Rows

ASIDE = 1e-6 * np.array([0.48, 0.6, 0.64])
"""By what share of a mesh's size a centre is moved to find the direction of its surface.

In a direction that seldom is one of faces.
"""


class Balls(NamedTuple):
    """Balls of clouds near the other objects of pairs, ascending by pair."""

    rows: Rows  #: (q,) row of the pair
    centers: Floats  #: (q, 3) metres
    radii: Floats  #: (q,) with padding and error
    gaps: Floats  #: (q,) metres from the box of the other object, negative where they overlap
    errors: Floats  #: (q,) metres by which rounding may have moved a gap

    def take(self, rows: Rows | Mask) -> Balls:
        """Return some of the balls."""
        return Balls._make(column[rows] for column in self)

    @property
    def bodies(self) -> ConvexBodies:
        """The balls as bodies."""
        count = len(self.rows)
        kinds, hulls = np.full(count, SEGMENT_CORE, np.int8), (NO_HULLS, np.zeros(count, np.int64))
        places = self.centers, np.tile(np.eye(3), (count, 1, 1))
        return ConvexBodies(kinds, np.zeros((count, 4)), self.radii, *hulls, *places)


class BallDistances(NamedTuple):
    """Signed distances of balls from the other objects of pairs, ascending by pair."""

    rows: Rows  #: (q,) row of the pair
    lower: Floats  #: (q,) metres, negative where they overlap, never above the truth
    positions: tuple[Floats, Floats]  #: (q, 3) of the first object of the pair, and of the second
    normals: Floats  #: (q, 3) unit, from the first object to the second


def is_cloud_pair(kinds: NDArray[np.int8], pairs: Pairs) -> Mask:
    """Return which pairs (m, 2) of slots have a cloud; kinds: of all slots."""
    if not (kinds == CLOUD).any():
        return np.zeros(len(pairs), np.bool_)
    return np.asarray((kinds[pairs] == CLOUD).any(axis=1))


def pairs_that_count(store: ObjectStore, cache: ShapeCache, pairs: Pairs) -> Pairs:
    """Return the pairs (m, 2) without those of two clouds, or of a cloud without points."""
    clouds = store.kinds[pairs] == CLOUD
    kept = ~clouds.all(axis=1)
    for slot in np.unique(pairs[clouds]).tolist():
        shape = cache.shape(slot)
        if isinstance(shape, Cloud) and len(shape.points) == 0:
            kept &= (pairs != slot).all(axis=1)
    return pairs if kept.all() else pairs[kept]


@dataclass(frozen=True, eq=False)
class CloudPairs:
    """Pairs (m, 2) of slots, each of one cloud and another object; boxes: of all slots, padded."""

    store: ObjectStore
    cache: ShapeCache
    boxes: Boxes
    pairs: Pairs

    @property
    def turned(self) -> Mask:
        """(m,) whether the cloud is the first of the pair."""
        return self.store.kinds[self.pairs[:, 0]] == CLOUD

    @property
    def others(self) -> Rows:
        """(m,) the slots of the other objects."""
        return np.where(self.turned, self.pairs[:, 1], self.pairs[:, 0])

    @property
    def clouds(self) -> Rows:
        """(m,) the slots of the clouds."""
        return np.where(self.turned, self.pairs[:, 0], self.pairs[:, 1])

    def take(self, rows: Rows) -> CloudPairs:
        """Return some of the pairs."""
        return CloudPairs(self.store, self.cache, self.boxes, self.pairs[rows])

    def balls(self, reach: float | Floats, only: str = "all") -> Balls:
        """Return the balls within reach, metres, one or (m,), of the boxes of other objects.

        only: as for ``near_points``.
        """
        around = self.boxes[self.others].arrays
        reaches = np.broadcast_to(np.asarray(reach, np.float64), len(self.pairs))
        return self.balls_about(around, reaches, only)

    def balls_about(self, around: BoxArrays, reaches: Floats, only: str = "all") -> Balls:
        """Return the balls within reaches (m,) of boxes (m,)."""
        clouds, parts = self.clouds, []
        for slot in np.unique(clouds).tolist():
            rows, cloud = np.flatnonzero(clouds == slot), self.cache.shape(slot)
            assert isinstance(cloud, Cloud)
            radius = cloud.radius + self.store.paddings[slot]
            (position,), (turn,) = as_poses(self.store.poses[slot][None], warn=False)
            centers, rotations, halves = (column[rows] for column in around)
            frames = np.ascontiguousarray(turn.T @ rotations)
            local = BoxArrays((centers - position) @ turn, frames, halves)
            middle, _, extent = cloud.local_box
            size = np.abs(position).sum() + np.abs(middle).sum() + extent.sum() + 3.0 * radius
            errors = PLACING * (size + np.abs(centers).sum(axis=1) + halves.sum(axis=1))
            near = near_points(cloud.tree, local, reaches[rows] + radius + errors, only)
            errors = errors[near.boxes]
            places = cloud.points[near.points] @ turn.T + position
            numbers = rows[near.boxes], places, radius + errors, near.distances - radius, errors
            parts.append(Balls(*numbers))
        if len(parts) == 1:
            return parts[0]
        joined = Balls._make(map(np.concatenate, zip(*parts, strict=True)))
        return joined.take(np.argsort(joined.rows, kind="stable"))

    def box_verdicts(self) -> Verdicts:
        """Return verdicts (m,) of the clouds and the boxes of the other objects."""
        result = np.full(len(self.pairs), SEPARATE, np.int8)
        near = self.balls(0.0, "any")
        result[near.rows] = np.where(near.gaps < -near.errors, np.int8(OVERLAP), np.int8(TOUCHING))
        return result

    def shape_verdicts(self, level: Accuracy) -> Verdicts:
        """Return verdicts (m,) of the clouds and the hulls, or triangles, of the other objects."""
        result = np.full(len(self.pairs), SEPARATE, np.int8)
        balls = self.balls(0.0)
        rest = np.ones(len(balls.rows), np.bool_)
        deepest = least_of(balls.rows, balls.gaps)
        rest[deepest] = False
        for rows in (deepest, np.flatnonzero(rest)):  # the deepest decides nearly all that collide
            waiting = balls.take(rows[result[balls.rows[rows]] == SEPARATE])
            if len(waiting.rows):
                result[waiting.rows[self._meets(waiting, level)]] = TOUCHING
        return result

    def _meets(self, balls: Balls, level: Accuracy) -> Mask:
        """Return (q,) which balls are not certainly apart from the other object of their pair."""
        slots, i = np.unique(self.others[balls.rows], return_inverse=True)
        j = np.arange(len(i))
        if level == Accuracy.MESH:
            meshes, radii = placed_meshes(self.store, self.cache, self.boxes, slots)
            return mesh_body_distances(meshes, radii, balls.bodies, i, j, 0.0)[1]
        return convex_may_collide(self._convex(slots, level), balls.bodies, i, j)

    def _convex(self, slots: Rows, level: Accuracy) -> ConvexBodies:
        """Return the boxes, or above OBB the convex shapes, of slots (k,)."""
        if level <= Accuracy.OBB:
            return box_bodies(self.boxes, slots)
        return convex_bodies(self.store, self.cache, self.boxes, slots)

    def with_balls(self, slots: Rows, level: Accuracy, balls: Balls) -> ConvexBodies:
        """Return the boxes or shapes of slots (k,), followed by balls (q,)."""
        first, second = self._convex(slots, level), balls.bodies
        arrays = {
            name: np.concatenate([value, vars(second)[name]])
            for name, value in vars(first).items()
            if name != "hulls"
        }
        return ConvexBodies(hulls=first.hulls, **arrays)

    def meshes(self, slots: Rows) -> tuple[PlacedMeshes, Floats]:
        """Return the placed trees of slots (k,), one for each, and radii (k,) with padding."""
        return placed_meshes(self.store, self.cache, self.boxes, slots)

    def closest(self, levels: Levels, limit: float, most: int = 1) -> BallDistances:
        """Return the ``most`` closest balls of each pair within a limit, the closest first.

        levels (m,): of the other objects. If ``most`` is more than one, only balls that collide,
        and the closest.
        """
        parts = [self._closest(level, rows, limit, most) for level, rows in by_level(levels)]
        rows, lower, near, far, normals = map(np.concatenate, zip(*parts, strict=True))
        order = np.lexsort((lower, rows))
        rank = np.arange(len(rows)) - np.searchsorted(rows[order], rows[order])
        kept = order[(rank < most) & (lower[order] <= limit)]
        rows, back = rows[kept], self.turned[rows[kept], None]
        near, far, normals = near[kept], far[kept], normals[kept]
        positions = np.where(back, far, near), np.where(back, near, far)
        return BallDistances(rows, lower[kept], positions, np.where(back, -normals, normals))

    def _closest(
        self, level: Accuracy, rows: Rows, limit: float, most: int
    ) -> tuple[Rows, Floats, Floats, Floats, Floats]:
        """Return rows, distances, points of the other object and of the ball, and normals."""
        pairs = self.take(rows)
        balls = pairs.balls(limit, "nearest")
        distances = pairs._distances(balls, level, limit)
        if level > Accuracy.OBB or most > 1:
            reaches = np.full(len(rows), limit)
            reaches[balls.rows] = np.minimum(limit, np.maximum(distances.upper, balls.gaps))
            balls = pairs.balls(reaches)
            distances = pairs._distances(balls, level, limit)
        ends = distances.positions_a, distances.positions_b
        return rows[balls.rows], distances.lower, *ends, distances.normals

    def _distances(self, balls: Balls, level: Accuracy, limit: float) -> ConvexDistances:
        """Return the distances of balls (q,) from the other objects, infinite beyond the limit."""
        slots, i = np.unique(self.others[balls.rows], return_inverse=True)
        bodies, j = balls.bodies, np.arange(len(i))
        distances, near = convex_distances(self._convex(slots, level), bodies, i, j, limit)
        if level < Accuracy.MESH:
            distances.lower[~near] = np.inf
            return distances
        meshes, radii = self.meshes(slots[i])
        exact, near = mesh_body_distances(meshes, radii, bodies, j, j, limit)
        for old, new in zip(vars(distances).values(), vars(exact).values(), strict=True):
            old[near] = new[near]
        distances.lower[~near] = np.inf
        deep = np.flatnonzero(near & (exact.lower == 0.0))
        if len(deep):
            self._set_depths(distances, balls.take(deep), slots[i[deep]], deep)
        return distances

    def _set_depths(
        self, distances: ConvexDistances, balls: Balls, slots: Rows, deep: Rows
    ) -> None:
        """Write the depths of balls (k,) in the meshes of slots (k,), at rows ``deep``.

        The shorter push counts: that found from the hull's, or along the line through the centre
        and the nearest point of the surface, which is shorter where the mesh is not convex. Centres
        are moved aside a little for that line: on the surface it has no direction.
        """
        k, bodies = np.arange(len(deep)), balls.bodies
        hulls, _ = convex_distances(self._convex(slots, Accuracy.HULL), bodies, k, k)
        middles = 0.5 * (hulls.positions_a + hulls.positions_b)
        lower = np.minimum(hulls.lower, 0.0)
        outer = Separations(np.column_stack([k, k]), lower, hulls.normals.copy(), middles)
        meshes, radii = self.meshes(slots)
        table = within_bodies(outer, meshes, radii, bodies)
        none, arrays = np.zeros(len(deep)), meshes.arrays
        hollow = MeshTrees.trusted(
            **arrays.trees._asdict() | {"solid": np.zeros(len(meshes.trees), np.bool_)}
        )
        surfaces = PlacedMeshes.trusted(hollow, *arrays[1:])
        off = ASIDE * arrays.trees.radii[arrays.meshes, None]
        probes = replace(bodies, radii=none, centers=bodies.centers + off)
        near, solid = (mesh_body_distances(m, none, probes, k, k)[0] for m in (surfaces, meshes))
        ways = np.where((solid.lower > 0.0)[:, None], near.normals, -near.normals)
        start = Separations(table.pairs, table.separations.copy(), ways, table.positions.copy())
        shorter = within_bodies(start, meshes, radii, bodies)
        better = np.flatnonzero(shorter.separations > table.separations)
        for old, new in zip(vars(table).values(), vars(shorter).values(), strict=True):
            old[better] = new[better]
        half = 0.5 * table.separations[:, None] * table.normals
        distances.lower[deep], distances.normals[deep] = table.separations, table.normals
        distances.positions_a[deep] = table.positions - half
        distances.positions_b[deep] = table.positions + half


def placed_points(store: ObjectStore, cache: ShapeCache, slot: int) -> tuple[Cloud, Floats, float]:
    """Return a cloud, its points (n, 3) where it is, and their radius, padded (m)."""
    cloud = cache.shape(slot)
    assert isinstance(cloud, Cloud)
    (position,), (turn,) = as_poses(store.poses[slot][None], warn=False)
    middle, _, extent = cloud.local_box
    size = np.abs(position).sum() + np.abs(middle).sum() + extent.sum()
    radius = cloud.radius + store.paddings[slot] + PLACING * size
    (x, y, z), points = cloud.points.T, np.empty_like(cloud.points)
    for k in range(3):  # a product of matrices waits for other threads
        points[:, k] = turn[k, 0] * x + turn[k, 1] * y + turn[k, 2] * z + position[k]
    return cloud, points, float(radius)


def placed_balls(store: ObjectStore, cache: ShapeCache, slot: int) -> tuple[ConvexBodies, Boxes]:
    """Return all balls of a cloud, padded, and the boxes about them."""
    _, centers, radius = placed_points(store, cache, slot)
    radii, none = np.full(len(centers), radius), np.zeros(len(centers))
    rows = none.astype(np.int64)
    bodies = Balls(rows, centers, radii, none, none).bodies
    halves = np.repeat(radii[:, None], 3, axis=1)
    return bodies, Boxes.trusted(centers, bodies.rotations, halves)


def by_level(levels: Levels) -> Iterator[tuple[Accuracy, Rows]]:
    """Yield the levels of pairs (m,), those below OBB as OBB, and the rows of each."""
    levels = np.maximum(levels, np.int8(Accuracy.OBB))
    for level in np.unique(levels).tolist():
        yield Accuracy(level), np.flatnonzero(levels == level)


def least_of(rows: Rows, values: Floats) -> Rows:
    """Return the index of the least value of each row; rows (q,) ascending."""
    order = np.lexsort((values, rows))
    return order[np.flatnonzero(np.diff(rows[order], prepend=-1))]

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

"""The effect ``clearance``: how far apart pairs are that are nearer than a limit, and where."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.clearance.clearance import Clearances, near_pairs
from obb_collision.queries.convex.distances import (
    ConvexDistances,
    convex_distances,
    mesh_body_distances,
)
from obb_collision.queries.meshes.mesh_mesh import MeshClearances, clearances_of
from obb_collision.scene.broad_phase.broad_phase import NO_PAIRS, Pairs
from obb_collision.scene.effects.base import (
    ACCURACY,
    ACCURACY_OPTION,
    ByLevel,
    Cycle,
    Effect,
    Option,
    Outcome,
    Setting,
    isolated,
    meeting_pairs,
    refined,
    take_rows,
)
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.clouds import CloudPairs, by_level
from obb_collision.scene.refinement.placed_shapes import PlacedShapes

BLANK = Clearances(NO_PAIRS, np.empty(0), *np.empty((3, 0, 3)))


class ClearanceEffect(Effect):
    """The ``Clearances`` of all pairs at most ``max_distance`` apart, sorted.

    These include colliding pairs. Above OBB distances are certified lower bounds; the points are as
    far apart as the upper bounds.
    """

    name = "clearance"
    description = "Distances and closest points of near pairs"
    options: Mapping[str, Option] = {
        "max_distance": Option(
            0.1,
            0.0,
            1e6,
            "Maximum distance of a pair (m); pairs farther apart are left out.",
            reaches=True,
        ),
        ACCURACY: ACCURACY_OPTION,
    }

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute clearances of pairs whose bounds are near; most need no closest points."""
        max_distance = setting.values["max_distance"]
        slots = np.flatnonzero(cycle.active)
        minimum, maximum = cycle.boxes[slots].world_bounds()
        half = np.nextafter(0.5 * max_distance, np.inf)
        selected = None if setting.selected is None else setting.selected[slots]
        low, high = np.nextafter(minimum - half, -np.inf), np.nextafter(maximum + half, np.inf)
        pairs = meeting_pairs(cycle, slots, low, high, selected)

        def compute(candidates: Pairs) -> Clearances:
            table = near_pairs(cycle.boxes, candidates, max_distance)[0]
            table = refined(table, cycle, setting, BY_LEVEL, cloud_clearances)
            beyond = table.distances > max_distance
            return take_rows(table, ~beyond) if beyond.any() else table

        _, result, failures = isolated(compute, pairs, BLANK, cycle.name)
        levels = cycle.levels(result.pairs, setting, max(BY_LEVEL))
        return Outcome(result, len(pairs), failures, accuracies=levels)


def hull_clearances(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Clearances:
    """Return the clearances of pairs on HULL; beyond the limit distances are only lower bounds."""
    bodies, i, j = shapes.bodies(boxes, pairs)
    table, _ = convex_distances(bodies, bodies, i, j, setting.values["max_distance"])
    lower = shapes.parted(table.lower, pairs, Accuracy.HULL)
    return Clearances(pairs, lower, table.positions_a, table.positions_b, table.normals)


def triangle_clearances(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Clearances:
    """Return the clearances of pairs on MESH, with a mesh on at least one side.

    0 where they collide, infinite beyond the limit. Round shapes are exact.
    """
    table = Clearances(pairs, np.full(len(pairs), np.inf), *np.zeros((3, len(pairs), 3)))
    limit = setting.values["max_distance"]
    for sides in shapes.exact_sides(boxes, pairs):
        a, b, rows = (sides.a, sides.radii_a), (sides.b, sides.radii_b), np.arange(len(sides.rows))
        exact: MeshClearances | ConvexDistances
        if sides.radii_b is None:
            exact, near = mesh_body_distances(*a, sides.b, rows, rows, limit)
            distances = exact.lower
        else:
            exact, near = clearances_of(*a, *b, rows, rows, limit)
            distances = exact.distances
        rows, back = sides.rows[near], sides.turned[near, None]
        x, y, n = (v[near] for v in (exact.positions_a, exact.positions_b, exact.normals))
        table.distances[rows], table.normals[rows] = distances[near], np.where(back, -n, n)
        table.positions_a[rows] = np.where(back, y, x)
        table.positions_b[rows] = np.where(back, x, y)
    table.distances[:] = shapes.parted(table.distances, pairs, Accuracy.MESH)
    return table


def cloud_clearances(
    pairs: CloudPairs, shapes: PlacedShapes, levels: Levels, setting: Setting
) -> Clearances:
    """Return the distances of the nearest balls, infinite beyond the limit.

    Where a cloud collides: minus the depth of the deepest ball.
    """
    count = len(pairs.pairs)
    table = Clearances(pairs.pairs, np.full(count, np.inf), *np.zeros((3, count, 3)))
    near = pairs.closest(levels, setting.values["max_distance"])
    table.distances[near.rows], table.normals[near.rows] = near.lower, near.normals
    table.positions_a[near.rows], table.positions_b[near.rows] = near.positions
    for level, rows in by_level(levels):
        table.distances[rows] = shapes.parted(table.distances[rows], pairs.pairs[rows], level)
    return table


BY_LEVEL: ByLevel[Clearances] = {Accuracy.HULL: hull_clearances, Accuracy.MESH: triangle_clearances}
EFFECT: Effect = ClearanceEffect()

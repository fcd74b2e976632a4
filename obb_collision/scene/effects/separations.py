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

"""The effect ``separations``: how deep each colliding pair is, along which axis, and where."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.contacts.contacts import NO_AXIS, Contacts
from obb_collision.queries.mesh_contacts.mesh_convex import within_bodies
from obb_collision.queries.mesh_contacts.surfaces import patches_of, within
from obb_collision.queries.verdict.verdict import Separations, pair_separations
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
    pair_rows,
    take_rows,
    write_rows,
)
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.clouds import CloudPairs, by_level
from obb_collision.scene.refinement.placed_shapes import PairSides, PlacedShapes
from obb_collision.typing import Floats

BLANK = Separations.blank(NO_PAIRS)


class SeparationsEffect(Effect):
    """The ``Separations`` of the colliding pairs that are selected for it."""

    name = "separations"
    description = (
        "Depth, normal and position of pairs in collisions and collisions_text, where off gives NaN"
    )
    options: Mapping[str, Option] = {ACCURACY: ACCURACY_OPTION}

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute the table of ``Report.separations``, ``normals`` and ``positions``."""
        tables = BLANK, BY_LEVEL, cloud_separations
        return pair_rows(self.name, cycle, setting, pair_separations, *tables)


def hull_separations(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Separations:
    """Return the separations of pairs on HULL: minus a depth (m) that certainly parts the hulls."""
    distances = shapes.distances(boxes, pairs).distances
    middles = 0.5 * (distances.positions_a + distances.positions_b)
    lower = shapes.parted(distances.lower, pairs, Accuracy.HULL)
    return Separations(pairs, lower, distances.normals.copy(), middles)


def triangle_separations(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Separations:
    """Return the separations of pairs on MESH, with a mesh on at least one side.

    Minus a depth that certainly parts them, also round shapes; no push along the normal is shorter.
    Cylinders, cones and ellipsoids are pushed along directions of meshes around them.
    """
    if shapes.depths is not None and np.array_equal(shapes.depths[0], pairs):
        return take_rows(shapes.depths[1], np.arange(len(pairs)))
    table = hull_separations(boxes, shapes, pairs, setting)
    for sides in shapes.mesh_sides(boxes, pairs):
        deeper = within(_rows_of(table, sides), sides.a, sides.radii_a, sides.b, sides.radii_b)
        _write(table, sides, deeper)
    for sides in shapes.curved_sides(boxes, pairs, shapes.curved(pairs)):
        deeper = within_bodies(_rows_of(table, sides), sides.a, sides.radii_a, sides.b)
        _write(table, sides, deeper)
    table.separations[:] = shapes.parted(table.separations, pairs, Accuracy.MESH)
    shapes.depths = pairs, take_rows(table, np.arange(len(pairs)))
    return table


def triangle_contacts(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Contacts:
    """Return the contacts of pairs on MESH, with a mesh on at least one side.

    Of several points those on cylinders, cones and ellipsoids are on meshes around them.
    """
    max_points = int(setting.values["max_points"])
    table = triangle_separations(boxes, shapes, pairs, setting)
    result = Contacts.blank(pairs.copy(), max_points)  # a copy: shapes keep ``pairs`` as a key
    for sides in shapes.mesh_sides(boxes, pairs):
        separations = _rows_of(table, sides)
        rows = np.ascontiguousarray(separations.pairs[:, 0])
        patches = patches_of(separations, sides.a, sides.b, rows, rows, max_points)
        write_rows(result, sides.rows, patches)
    result.pairs[:], result.normals[:], result.axes[:] = pairs, table.normals, NO_AXIS
    return result


def cloud_separations(
    pairs: CloudPairs, shapes: PlacedShapes, levels: Levels, _: Setting
) -> Separations:
    """Return minus the depths of the deepest balls."""
    table = Separations.blank(pairs.pairs)
    deep = pairs.closest(levels, np.inf)
    table.separations[deep.rows], table.normals[deep.rows] = deep.lower, deep.normals
    table.positions[deep.rows] = 0.5 * (deep.positions[0] + deep.positions[1])
    for level, rows in by_level(levels):
        table.separations[rows] = shapes.parted(table.separations[rows], pairs.pairs[rows], level)
    return table


def _write(table: Separations, sides: PairSides, new: Separations) -> None:
    """Write the rows of the pairs of ``sides``, whose normals point from a to b."""
    table.separations[sides.rows], table.positions[sides.rows] = new.separations, new.positions
    table.normals[sides.rows] = _sign(sides) * new.normals


def _sign(sides: PairSides) -> Floats:
    return np.where(sides.turned, -1.0, 1.0)[:, None]


def _rows_of(table: Separations, sides: PairSides) -> Separations:
    """Return the rows of the pairs of ``sides``, with normals from a to b."""
    pairs = np.repeat(np.arange(len(sides.rows)), 2).reshape(-1, 2)
    normals = _sign(sides) * table.normals[sides.rows]
    return Separations(pairs, table.separations[sides.rows], normals, table.positions[sides.rows])


BY_LEVEL: ByLevel[Separations] = {
    Accuracy.HULL: hull_separations,
    Accuracy.MESH: triangle_separations,
}
EFFECT: Effect = SeparationsEffect()

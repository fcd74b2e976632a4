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

"""Penetration depth on HULL and MESH, for the effects that report it."""

from __future__ import annotations

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.contacts.contacts import NO_AXIS, Contacts
from obb_collision.queries.mesh_contacts.body_depths import within_bodies
from obb_collision.queries.mesh_contacts.surfaces import patches_of, within
from obb_collision.queries.verdict.verdict import Separations
from obb_collision.scene.broad_phase.broad_phase import Pairs
from obb_collision.scene.effects.base import Setting, take_rows, write_rows
from obb_collision.scene.refinement.placed_shapes import PairSides, PlacedShapes
from obb_collision.typing import Floats


def hull_separations(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Separations:
    """Return the separations of pairs on HULL: minus a depth that certainly parts them."""
    found = shapes.distances(boxes, pairs).found
    middles = 0.5 * (found.positions_a + found.positions_b)
    lower = shapes.parted(found.lower, pairs, Accuracy.HULL)
    return Separations(pairs, lower, found.normals.copy(), middles)


def triangle_separations(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Separations:
    """Return the separations of pairs on MESH, with a mesh on at least one side.

    Minus a depth that certainly parts them, of round shapes, too: no push along the normal is
    shorter. Directions to push cylinders, cones and ellipsoids are those of meshes around them.
    """
    if shapes.depths is not None and np.array_equal(shapes.depths[0], pairs):
        return take_rows(shapes.depths[1], np.arange(len(pairs)))
    table = hull_separations(boxes, shapes, pairs, setting)
    for some in shapes.mesh_sides(boxes, pairs):
        found = within(_seen_from(table, some), some.a, some.radii_a, some.b, some.radii_b)
        _write(table, some, found)
    for some in shapes.curved_sides(boxes, pairs, shapes.curved(pairs)):
        _write(table, some, within_bodies(_seen_from(table, some), some.a, some.radii_a, some.b))
    table.separations[:] = shapes.parted(table.separations, pairs, Accuracy.MESH)
    shapes.depths = pairs, take_rows(table, np.arange(len(pairs)))
    return table


def triangle_contacts(
    boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting
) -> Contacts:
    """Return the contacts of pairs on MESH, with a mesh on at least one side.

    Where there are several points, those of cylinders, cones and ellipsoids are on meshes around
    them.
    """
    max_points = int(setting.values["max_points"])
    table = triangle_separations(boxes, shapes, pairs, setting)
    result = Contacts.blank(pairs.copy(), max_points)  # pairs are the key of what is kept
    for some in shapes.mesh_sides(boxes, pairs):
        seen = _seen_from(table, some)
        each = np.ascontiguousarray(seen.pairs[:, 0])
        found = patches_of(seen, some.a, some.b, each, each, max_points)
        write_rows(result, some.rows, found)
    result.pairs[:], result.normals[:], result.axes[:] = pairs, table.normals, NO_AXIS
    return result


def _write(table: Separations, some: PairSides, found: Separations) -> None:
    """Write the rows of a table that some sides have."""
    table.separations[some.rows], table.positions[some.rows] = found.separations, found.positions
    table.normals[some.rows] = _sign(some) * found.normals


def _sign(some: PairSides) -> Floats:
    return np.where(some.turned, -1.0, 1.0)[:, None]


def _seen_from(table: Separations, some: PairSides) -> Separations:
    """Return the rows of a table that some sides have, by their own rows and from their a to b."""
    each = np.repeat(np.arange(len(some.rows)), 2).reshape(-1, 2)
    normals = _sign(some) * table.normals[some.rows]
    return Separations(each, table.separations[some.rows], normals, table.positions[some.rows])

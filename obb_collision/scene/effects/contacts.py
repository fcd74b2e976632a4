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

"""The effect ``contacts``: the contact patch of each colliding pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.geometry.boxes import Boxes
from obb_collision.queries.contacts.contacts import NO_AXIS, Contacts, pair_contacts
from obb_collision.queries.convex.contacts import convex_contacts
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
)
from obb_collision.scene.effects.separations import cloud_separations, triangle_contacts
from obb_collision.scene.refinement.budget import Levels
from obb_collision.scene.refinement.clouds import CloudPairs
from obb_collision.scene.refinement.placed_shapes import PlacedShapes


class ContactsEffect(Effect):
    """The ``Contacts`` of the colliding pairs: up to ``max_points`` points each."""

    name = "contacts"
    description = "Contact points of colliding pairs"
    options: Mapping[str, Option] = {
        "max_points": Option(4, 4, 8, "Maximum number of contact points per pair.", choices=(4, 8)),
        ACCURACY: ACCURACY_OPTION,
    }

    def run(self, cycle: Cycle, setting: Setting) -> Outcome:
        """Compute the contact patches of the selected pairs."""
        max_points = int(setting.values["max_points"])

        def compute(boxes: Boxes, pairs: Pairs) -> Contacts:
            return pair_contacts(boxes, pairs, max_points)

        blank = Contacts.blank(NO_PAIRS, max_points)
        return pair_rows(self.name, cycle, setting, compute, blank, BY_LEVEL, cloud_contacts)


def hull_contacts(boxes: Boxes, shapes: PlacedShapes, pairs: Pairs, setting: Setting) -> Contacts:
    """Return the contacts of pairs on HULL; hulls that are apart have none."""
    bodies, i, j, distances = shapes.distances(boxes, pairs)
    lower = shapes.parted(distances.lower, pairs, Accuracy.HULL)
    distances, max_points = replace(distances, lower=lower), int(setting.values["max_points"])
    return convex_contacts(bodies, bodies, pairs, i, j, max_points, distances)


def cloud_contacts(
    pairs: CloudPairs, shapes: PlacedShapes, levels: Levels, setting: Setting
) -> Contacts:
    """Return the deepest balls of clouds, along the normal of the deepest one."""
    most = int(setting.values["max_points"])
    table = cloud_separations(pairs, shapes, levels, setting)
    result = Contacts.blank(pairs.pairs.copy(), most)
    result.positions[:], result.position_depths[:] = np.nan, np.nan
    result.normals[:], result.axes[:] = table.normals, NO_AXIS
    result.depths[:] = np.maximum(-table.separations, 0.0)
    deep = pairs.closest(levels, np.inf, most)
    met = (deep.lower <= 0.0) & (table.separations[deep.rows] <= 0.0)
    rows = deep.rows[met]
    places = np.arange(len(rows)) - np.searchsorted(rows, rows)
    result.positions[rows, places] = (0.5 * (deep.positions[0] + deep.positions[1]))[met]
    result.position_depths[rows, places] = -deep.lower[met]
    result.counts[:] = np.bincount(rows, minlength=len(pairs.pairs))
    return result


BY_LEVEL: ByLevel[Contacts] = {Accuracy.HULL: hull_contacts, Accuracy.MESH: triangle_contacts}
EFFECT: Effect = ContactsEffect()

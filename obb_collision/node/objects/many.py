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

"""Objects that come, stay and go many at a time, without a step in Python for each where it counts.

What these do to one object is what the methods of ``Objects`` do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import COLUMNS, Slots
from obb_collision.shapes import Cylinder, Ellipsoid, Shape
from obb_collision.typing import Floats

KEPT = ("live", "ns", "id", "placed", "world", "expiry", "shaped")
"""Columns that stay where an object goes and comes again with the shape it had."""


def renew_slots(objects: Objects, slots: Slots) -> None:
    """Take objects out and put them in again where they are, with the shapes they have."""
    if len(slots) == 0:
        return
    table = objects.table
    objects.want_no_other(slots)
    stale = slots[table.stale[slots]]
    for column in COLUMNS:
        if column not in KEPT:
            getattr(table, column)[slots] = 0
    objects.placement.begin(slots)
    objects.scene.renew_indices(slots)
    objects.enable_many(stale)


def put_primitives(
    objects: Objects, keys: Sequence[Key], kinds: Slots, sizes: Floats, expiry: Slots
) -> Slots:
    """Add CUBE, SPHERE and CYLINDER of edge lengths (n, 3), or give objects those shapes.

    kinds (n,): types of markers; expiry (n,) as in the table. Returns their slots; all or, on a
    RefusedError ("bad shape"), none. Their namespaces are admitted and there is room for them.
    """
    kind_list, size_list = kinds.tolist(), sizes.tolist()
    table, scene = objects.table, objects.scene
    names = [name_from_key(key) for key in keys]
    known = np.array([table.slots.get(key, -1) for key in keys], np.int64)
    poses = np.zeros((len(keys), 7))
    poses[:, 6] = 1.0
    there = known >= 0
    there[there] = table.placed[known[there]]
    poses[there] = table.world[known[there]]
    overrides = objects.overrides
    levels = [overrides.level(name) for name in names] if overrides.overrides else None
    try:
        bodies = [_body(kind, size) for kind, size in zip(kind_list, size_list, strict=True)]
        slots = scene.add_boxes(names, sizes, poses, levels, bodies)
    except ValueError as error:
        raise RefusedError("bad shape", str(error)) from error
    new = known < 0
    if new.any():
        rows = np.flatnonzero(new).tolist()
        table.claim_many(slots[new], [keys[row] for row in rows], [names[row] for row in rows])
        objects.placement.begin(slots[new])
    signatures = [(kind, *size) for kind, size in zip(kind_list, size_list, strict=True)]
    objects.note_signatures(slots, signatures)
    objects.enable_many(slots)
    touch_slots(objects, slots, expiry)
    return slots


def _body(kind: int, size: list[float]) -> Shape | None:
    """Return the shape of a marker, None for a box: as ``shape_plans`` makes it, but unchecked."""
    x, y, z = size
    if kind == Marker.SPHERE:
        return Ellipsoid.trusted((0.5 * x, 0.5 * y, 0.5 * z))
    if kind == Marker.CYLINDER:
        return Cylinder.trusted(0.5, 1.0, (x, y, z))
    return None


def touch_slots(objects: Objects, slots: Slots, expiry: Slots) -> None:
    """Let objects go on with the shapes they have until their new expiry (n,)."""
    table = objects.table
    table.expiry[slots] = expiry
    table.seen[slots] = False
    table.shape_refused[slots] = False
    objects.want_no_other(slots)
    if objects.unplaceable:
        for slot in slots.tolist():
            objects.forget_unplaceable(table.key(slot))


def have_shapes(
    objects: Objects, slots: Slots, types: npt.NDArray[np.int64], scales: Floats
) -> npt.NDArray[np.bool_]:
    """Return which objects (n,) have the shapes that markers of these types and scales have."""
    given = zip(objects.signatures(slots), types.tolist(), scales.tolist(), strict=True)
    same = [known == (kind, *scale) for known, kind, scale in given]
    return np.array(same, np.bool_).reshape(-1)

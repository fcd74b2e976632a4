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

What these do to one object is what the methods of ``ObjectShapes`` do.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import Key, name_from_key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.shapes import ObjectShapes
from obb_collision.node.objects.table import COLUMNS, ObjectTable, Slots
from obb_collision.shapes import Cylinder, Ellipsoid, Shape
from obb_collision.typing import Floats

KEPT = ("live", "ns", "id", "placed", "expiry", "shaped")
"""Columns that stay where an object goes and comes again with the shape it had."""


def renew_slots(shapes: ObjectShapes, slots: Slots) -> None:
    """Take objects out and put them in again where they are, with the shapes they have."""
    if len(slots) == 0:
        return
    table = shapes.table
    shapes.cancel_pending(slots)
    stale = slots[table.stale[slots]]
    for column in COLUMNS:
        if column not in KEPT:
            getattr(table, column)[slots] = 0
    shapes.placement.begin(slots)
    shapes.scene.renew_indices(slots)
    shapes.placement.enable(stale)


def put_primitives(
    shapes: ObjectShapes, keys: Sequence[Key], kinds: Slots, sizes: Floats, expiry: Slots
) -> Slots:
    """Add CUBE, SPHERE and CYLINDER of edge lengths (n, 3), or give objects those shapes.

    kinds (n,): types of markers; expiry (n,) as in the table. Returns their slots; all or, on a
    RefusedError ("bad shape"), none. Their namespaces are admitted and there is room for them.
    """
    kind_list, size_list = kinds.tolist(), sizes.tolist()
    table, scene = shapes.table, shapes.scene
    names = [name_from_key(key) for key in keys]
    known = np.array([table.slots.get(key, -1) for key in keys], np.int64)
    poses = np.zeros((len(keys), 7))
    poses[:, 6] = 1.0
    there = known >= 0
    there[there] = table.placed[known[there]]
    poses[there] = scene.poses_of(known[there])
    overrides = shapes.overrides
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
        shapes.placement.begin(slots[new])
    signatures = [(kind, *size) for kind, size in zip(kind_list, size_list, strict=True)]
    shapes.note_signatures(slots, signatures)
    shapes.placement.enable(slots)
    touch_slots(shapes, slots, expiry)
    return slots


def _body(kind: int, size: list[float]) -> Shape | None:
    """Return the shape of a marker, None for a box: as ``shape_plans`` makes it, but unchecked."""
    x, y, z = size
    if kind == Marker.SPHERE:
        return Ellipsoid.trusted((0.5 * x, 0.5 * y, 0.5 * z))
    if kind == Marker.CYLINDER:
        return Cylinder.trusted(0.5, 1.0, (x, y, z))
    return None


def touch_slots(shapes: ObjectShapes, slots: Slots, expiry: Slots) -> None:
    """Let objects go on with the shapes they have until their new expiry (n,)."""
    table = shapes.table
    table.expiry[slots] = expiry
    table.seen[slots] = False
    table.shape_refused[slots] = False
    shapes.cancel_pending(slots)
    if shapes.unplaceable:
        for slot in slots.tolist():
            shapes.unplaceable.forget(table.key(slot))


def have_shapes(
    table: ObjectTable, slots: Slots, types: npt.NDArray[np.int64], scales: Floats
) -> npt.NDArray[np.bool_]:
    """Return which objects (n,) have the shapes that markers of these types and scales have."""
    signatures = map(table.signatures.get, slots.tolist())
    given = zip(signatures, types.tolist(), scales.tolist(), strict=True)
    same = [known == (kind, *scale) for known, kind, scale in given]
    return np.array(same, np.bool_).reshape(-1)

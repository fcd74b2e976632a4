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

"""Adding, extending and removing many objects at a time, by arrays where speed matters.

What these do to one object is what the methods of ``ObjectShapes`` do.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision.accuracy import Accuracy
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.conditions import (
    ASIDE,
    RENEWED,
    SHAPE_CONFIRMED,
    SHAPE_GIVEN,
    STALE,
    UNPLACED,
)
from obb_collision.node.objects.shapes import ObjectShapes
from obb_collision.node.objects.table import COLUMNS, ObjectTable, Slots
from obb_collision.scene.store.store import NO_ROWS
from obb_collision.shapes import Cylinder, Ellipsoid, Shape
from obb_collision.typing import Floats

KEPT = ("condition", "ns", "id", "serial", "kind", "size", "expiry")
"""Columns that are unchanged if an object is removed and added again with the same shape."""


def renew_slots(shapes: ObjectShapes, slots: Slots) -> None:
    """Take objects out and put them in again where they are, with the shapes they have."""
    if len(slots) == 0:
        return
    table = shapes.table
    shapes.cancel_pending(slots)
    left_out = slots[table.has(STALE | ASIDE, slots)]
    for column in COLUMNS:
        if column not in KEPT:
            getattr(table, column)[slots] = 0
    table.mark(slots, RENEWED)
    table.repeated[slots] = True  # this message is not the first one about them
    shapes.placement.begin(slots)
    shapes.scene.renew_indices(slots)
    shapes.placement.enable(left_out)


def put_primitives(
    shapes: ObjectShapes,
    namespaces: Slots,
    ids: Slots,
    kinds: Slots,
    sizes: Floats,
    poses: Floats,
    expiry: Slots,
    instead: Slots = NO_ROWS,
) -> Slots:
    """Add CUBE, SPHERE and CYLINDER of edge lengths (n, 3), or give objects those shapes.

    namespaces, ids (n,): keys, all distinct; the namespaces are admitted, and there is room for
    new objects. kinds (n,): types of markers; poses (n, 7), finite, of which new objects get
    theirs; expiry (n,) as in the table; instead: slots of the scene that the table has released,
    for boxes that come. Returns their slots; all or, on a RefusedError ("bad shape"), none.
    """
    table = shapes.table
    slots = table.find(namespaces, ids)
    new = slots < 0
    table.reach(len(shapes.scene) + len(slots))  # so that the table can take what the scene gets
    cubes = kinds == Marker.CUBE
    here = np.flatnonzero(~new & cubes & (table.kind[slots] == Marker.CUBE))
    other = np.flatnonzero(~cubes | ~(new | (table.kind[slots] == Marker.CUBE)))
    if len(other):
        slots[other] = _put_bodies(
            shapes, slots[other], namespaces[other], ids[other], kinds[other], sizes[other]
        )
    if len(here):
        shapes.scene.resize_boxes(slots[here], sizes[here])
    fresh = np.flatnonzero(new & cubes)
    if len(fresh):
        names = _names(table, namespaces[fresh], ids[fresh])
        levels = _levels(shapes, names)
        slots[fresh] = shapes.scene.begin_boxes(names, sizes[fresh], poses[fresh], levels, instead)
    begun = slots[new]
    table.claim_many(begun, namespaces[new], ids[new])
    shapes.placement.begin(begun)
    table.note_primitives(slots, kinds, sizes)
    table.mark(slots, SHAPE_GIVEN)
    shapes.placement.enable(slots)
    touch_slots(shapes, slots, expiry)
    return slots


def _put_bodies(
    shapes: ObjectShapes, slots: Slots, namespaces: Slots, ids: Slots, kinds: Slots, sizes: Floats
) -> Slots:
    """Add objects that are no boxes, or change such; slots: -1 for new ones; returns all slots."""
    names = _names(shapes.table, namespaces, ids)
    poses = np.zeros((len(slots), 7))
    poses[:, 6] = 1.0
    there = slots >= 0
    there[there] = ~shapes.table.has(UNPLACED, slots[there])
    poses[there] = shapes.scene.poses_of(slots[there])
    pairs = zip(kinds.tolist(), sizes.tolist(), strict=True)
    try:
        bodies = [_body(kind, size) for kind, size in pairs]
        return shapes.scene.add_boxes(names, sizes, poses, _levels(shapes, names), bodies)
    except ValueError as error:
        raise RefusedError("bad shape", str(error)) from error


def _names(table: ObjectTable, namespaces: Slots, ids: Slots) -> list[str]:
    texts = table.namespaces.names
    if (namespaces == namespaces[0]).all():  # as most senders have it: half the time
        text = texts[int(namespaces[0])]
        return [f"{text}/{ident}" for ident in ids.tolist()]
    pairs = zip(namespaces.tolist(), ids.tolist(), strict=True)
    return [f"{texts[number]}/{ident}" for number, ident in pairs]


def _levels(shapes: ObjectShapes, names: list[str]) -> list[Accuracy | None] | None:
    overrides = shapes.overrides
    return [overrides.value(name) for name in names] if overrides else None


def _body(kind: int, size: list[float]) -> Shape | None:
    """Return the shape of a marker, None for a box: as ``shape_plans`` makes it, but unchecked."""
    x, y, z = size
    if kind == Marker.SPHERE:
        return Ellipsoid.trusted((0.5 * x, 0.5 * y, 0.5 * z))
    if kind == Marker.CYLINDER:
        return Cylinder.trusted(0.5, 1.0, (x, y, z))
    return None


def touch_slots(shapes: ObjectShapes, slots: Slots, expiry: Slots) -> None:
    """Extend objects, whose shapes are unchanged, to their new expiry (n,)."""
    table = shapes.table
    table.expiry[slots] = expiry
    table.seen[slots] = False
    table.mark(slots, SHAPE_CONFIRMED)
    shapes.cancel_pending(slots)
    if shapes.unplaceable:
        for slot in slots.tolist():
            shapes.unplaceable.forget(table.key(slot))


def have_shapes(
    table: ObjectTable, slots: Slots, types: npt.NDArray[np.int64], scales: Floats
) -> npt.NDArray[np.bool_]:
    """Return which objects (n,) have the shapes that markers of PRIMITIVES and scales have."""
    same: npt.NDArray[np.bool_] = (table.kind[slots] == types) & (table.size[slots] == scales).all(
        axis=1
    )
    return same

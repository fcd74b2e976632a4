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

"""The topic ``object_boxes``, and others like it: each message is its complete set of boxes.

Sets wait until the next cycle. Only the newest one that can be placed is applied: it replaces those
before it anyway.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.geometry.poses import compose_poses
from obb_collision.node.inputs.batch import Faults, put_rows
from obb_collision.node.inputs.clouds import QueuedCloud
from obb_collision.node.inputs.newest import NewestInput
from obb_collision.node.messages.cdr import cloud_from_bytes
from obb_collision.node.messages.clouds import boxes_from_ros
from obb_collision.node.messages.conversions import (
    Key,
    are_unusable,
    name_from_key,
    pose_kinds,
    stamp_from_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number, stand_in
from obb_collision.node.objects.conditions import POSE_REFUSED, SHAPE_REFUSED
from obb_collision.node.objects.frames import FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.refusals import MAX_UNPLACEABLE
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import ID_BITS, ID_OFFSET, NO_TIME, are_numbers, signed
from obb_collision.typing import Floats, Integers, Mask, Rows


class SetInput(NamedTuple):
    """An input of complete sets: its topic, the namespace of boxes without one, its number."""

    topic: str
    namespace: str
    number: int


BOXES = SetInput("object_boxes", "boxes", 1)
REPEATED = RefusedError("repeated", "the last row of an object counts")
BAD_KEY = RefusedError("bad key", "ns and id must be int32")
UNMARKED = (REPEATED.reason, BAD_KEY.reason, OLDER)
"""Reasons that put no object in doubt: another row has its key, the key is invalid, or a newer
pose is known."""
OWNED = RefusedError(
    "object of another input", "an object belongs to one input: markers, boxes or a robot"
)


class BoxRows(NamedTuple):
    """Boxes as received: keys (n,), poses (n, 7) and sizes (n, 3), metres."""

    namespaces: Integers | None
    ids: Integers
    poses: Floats
    sizes: Floats
    namespace: str = BOXES.namespace

    @property
    def numbers(self) -> Rows:
        """(n,) numbers of the namespaces."""
        if self.namespaces is None:
            return np.full(len(self.ids), namespace_number(self.namespace))
        return signed(self.namespaces)

    @property
    def are_keys(self) -> Mask:
        """(n,) whether a row names an object."""
        legal: Mask = (self.ids >= -ID_OFFSET) & (self.ids < ID_OFFSET)
        return legal if self.namespaces is None else legal & are_numbers(self.namespaces)


def read_boxes(data: bytes, most: int) -> QueuedCloud:
    """Return the ``BoxRows`` of a serialised message of ``object_boxes``; RefusedError if bad."""
    message = cloud_from_bytes(data)
    frame, stamp = message.header.frame_id, stamp_from_ros(message.header.stamp)
    return QueuedCloud(BoxRows(*boxes_from_ros(message, most)), frame, stamp, len(message.data))


class BoxInput(NewestInput):
    """Takes messages that are complete sets of boxes, and applies the newest message.

    read: returns the boxes in the bytes of a message, given how many rows are allowed.
    """

    def __init__(
        self,
        objects: Objects,
        frames: FrameSource,
        clock: Callable[[], int],
        source: SetInput = BOXES,
        read: Callable[[bytes, int], QueuedCloud] = read_boxes,
    ) -> None:
        super().__init__(objects, frames, clock, source.topic, read)
        self.source = source

    def _use(self, cloud: QueuedCloud, frame: Floats | None) -> None:
        """Bring the objects in line with a set, given in a frame that is at ``frame`` (7,)."""
        boxes: BoxRows = cloud.content
        numbers, ids, poses = boxes.numbers, boxes.ids, boxes.poses
        faults = Faults(len(ids))
        faults.note(~boxes.are_keys, BAD_KEY)
        if not boxes.are_keys.all():
            self._monitor.mark_unreadable(BAD_KEY.reason, cloud.sender)
        faults.note(_repeated(numbers, ids, faults.good), REPEATED)
        faults.note_sizes(boxes.sizes, "bad size")
        faults.note_poses(poses)
        if frame is not None:
            good = faults.good
            poses = poses.copy()
            poses[good] = compose_poses(frame, poses[good])
            faults.kinds = pose_kinds(poses)
            bad = are_unusable(faults.kinds)
            faults.note(bad, RefusedError("bad pose", "out of range once placed"))
        of_cloud = cloud.stamp, cloud.received, self.topic, cloud.carried, cloud.sender
        state = State("", *of_cloud)
        self._update(numbers, ids, poses, boxes.sizes, faults, state)

    def _refuse(self, cloud: QueuedCloud, error: RefusedError) -> None:
        boxes: BoxRows = cloud.content
        rows = np.flatnonzero(boxes.are_keys)
        if len(rows) < len(boxes.ids) or len(rows) == 0:
            self._monitor.mark_unreadable(error.reason, cloud.sender)
        self._doubt(error.reason)
        numbers, ids = boxes.numbers[rows], boxes.ids[rows]
        new = self._table.find(numbers, ids) < 0
        self._refuse_new(numbers[new], ids[new], error.reason)

    def _key(self, number: int, ident: int) -> Key:
        return self._table.namespaces.names.get(number, stand_in(number)), ident

    @property
    def _own(self) -> Mask:
        """(rows,) which objects came by the sets of this input."""
        return np.asarray(self._table.live & (self._table.of_set == self.source.number))

    def _doubt(self, reason: str) -> None:
        self._table.mark(np.flatnonzero(self._own), POSE_REFUSED)

    def _update(
        self, numbers: Rows, ids: Rows, poses: Floats, sizes: Floats, faults: Faults, state: State
    ) -> None:
        """Bring the objects in line with a set of keys (n,), poses (n, 7) and sizes (n, 3), metres.

        Further faults are added to ``faults``.
        """
        table = self._table
        slots = table.find(numbers, ids)
        faults.note((slots >= 0) & ~self._own[slots], OWNED)
        self._objects.shapes.unplaceable.forget_set(self.source.number)

        def fail(row: int, error: RefusedError) -> None:
            faults.note(np.arange(len(ids)) == row, error, of_shape=True)

        def refuse(beyond: Mask, error: RefusedError) -> None:
            faults.note(beyond, error, of_shape=True)

        new = (slots < 0) & faults.good
        with self._removed(slots), self._objects.shapes.room(new, numbers, self._admit, refuse):

            def put(rows: Rows) -> None:
                slots[rows] = self._put(numbers[rows], ids[rows], poses[rows], sizes[rows])

            rows = np.flatnonzero(faults.good)
            put_rows(rows, put, fail, self._objects.guard, f"input {self.topic}")
        rows = np.flatnonzero(faults.good)
        old = np.zeros(len(ids), np.bool_)
        old[rows] = self._objects.states.store(
            slots[rows], poses[rows], state, kinds=faults.kinds[rows]
        )
        faults.note(old, RefusedError(OLDER, "a newer pose was received"))
        self._report(numbers, ids, slots, faults, sizes)

    @contextmanager
    def _removed(self, slots: Rows) -> Iterator[None]:
        """Remove this input's boxes at other slots; new boxes can take their slots before."""
        shapes, gone = self._objects.shapes, self._own
        gone[slots[slots >= 0]] = False
        shapes.release(np.flatnonzero(gone))
        try:
            yield
        finally:
            shapes.scene.objects.remove(shapes.strangers())
            self._objects.declare_empty()

    def _put(self, numbers: Rows, ids: Rows, poses: Floats, sizes: Floats) -> Rows:
        """Create boxes, and resize those that have other sizes; returns their slots."""
        table, shapes = self._table, self._objects.shapes
        slots, kinds = table.find(numbers, ids), np.full(len(ids), Marker.CUBE)
        same = table.have_shapes(slots, kinds, sizes)
        shapes.touch(slots[same], NO_TIME)
        rest = np.flatnonzero(~same)
        if len(rest):
            keys, columns = (numbers[rest], ids[rest]), (kinds[rest], sizes[rest], poses[rest])
            slots[rest] = shapes.put_primitives(keys, *columns, instead=shapes.strangers())
            table.of_set[slots[rest]] = self.source.number
        return slots

    def _admit(self, number: int) -> int:
        if number == namespace_number(self.source.namespace):
            return self._table.namespaces.admit(self.source.namespace)
        return self._table.namespaces.admit_number(number)

    def _report(self, numbers: Rows, ids: Rows, slots: Rows, faults: Faults, sizes: Floats) -> None:
        """Count faults, mark their boxes, and store the refusals of boxes without an object."""
        table = self._table
        for rows, (error, of_shape) in faults:
            item = name_from_key(self._key(int(numbers[rows[-1]]), int(ids[rows[-1]])))
            self._monitor.refuse(error.reason, item, error.detail, len(rows))
            if error.reason in UNMARKED:
                continue
            present = slots[rows] >= 0
            present[present] = self._own[slots[rows[present]]]
            own = slots[rows[present]]
            # what is refused for its pose may tell a new size
            other = of_shape | ~table.have_shapes(own, table.kind[own], sizes[rows[present]])
            table.mark(own[other], SHAPE_REFUSED)
            table.mark(own[~other], POSE_REFUSED)
            self._refuse_new(numbers[rows[~present]], ids[rows[~present]], error.reason)

    def _refuse_new(self, numbers: Rows, ids: Rows, reason: str) -> None:
        numbers, ids = numbers[-MAX_UNPLACEABLE:], ids[-MAX_UNPLACEABLE:]
        for pair in zip(numbers.tolist(), ids.tolist(), strict=True):
            key, source = self._key(*pair), self.source.number
            self._objects.shapes.unplaceable.add(key, reason, of_set=source)


def _repeated(numbers: Rows, ids: Rows, legal: Mask) -> Mask:
    """Return which rows (n,) have the key of a later row; rows that are not legal have no key."""
    rows = np.flatnonzero(legal)
    keys = (numbers[rows] << ID_BITS) + ids[rows]
    repeated = np.zeros(len(legal), np.bool_)
    if (keys[1:] > keys[:-1]).all():  # as most senders number them
        return repeated
    order = np.argsort(keys, kind="stable")
    repeated[rows[order[:-1]]] = keys[order[:-1]] == keys[order[1:]]
    return repeated

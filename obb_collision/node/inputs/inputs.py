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

"""Messages -> objects: every item is used or refused on its own, and counted if refused.

Markers are in ``markers``, sets of boxes in ``boxes``.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from obb_collision.node.inputs.boxes import OWNED, BoxInput
from obb_collision.node.inputs.detections import DETECTIONS, read_detections
from obb_collision.node.inputs.markers import MarkerInput
from obb_collision.node.inputs.newest import NewestInput
from obb_collision.node.messages.cdr import (
    Header,
    NamedPose,
    NamedStates,
    cloud_from_bytes,
    pose_from_bytes,
    states_from_bytes,
)
from obb_collision.node.messages.clouds import poses_from_ros
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    UNUSABLE,
    ZERO,
    are_unusable,
    pose_kinds,
    stamp_from_ros,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import shortened, stand_in
from obb_collision.node.objects.frames import FrameSource
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.refusals import UnknownObjects
from obb_collision.node.objects.states import OLDER, State
from obb_collision.node.objects.table import OF_SOURCE, Slots, signed
from obb_collision.typing import Floats, Mask, Rows

LENGTHS_DIFFER = "array lengths differ"
"""Reason: a message has more names than poses, or twists, or fewer."""


class Inputs:
    """Stores the messages of the topics about objects; the latest state of an object wins."""

    def __init__(
        self,
        objects: Objects,
        clock: Callable[[], int],
        frames: FrameSource,
    ) -> None:
        self._objects, self._monitors = objects, objects.monitors
        self._clock = clock
        self.unknown = UnknownObjects(objects.table)
        """Names that states came for, and that have no object."""
        self.markers = MarkerInput(objects, clock, self.unknown)
        self.boxes = BoxInput(objects, frames, clock)
        self.sets = [self.boxes]
        """All inputs whose messages are complete sets of boxes."""
        if DETECTIONS.topic in objects.monitors:
            self.sets.append(BoxInput(objects, frames, clock, DETECTIONS, read_detections))
        self.bases: dict[str, Callable[[NamedPose, int], None]] = {}
        """By name of a robot: the callback for poses of its base."""
        self.newest: list[NewestInput] = [*self.sets]
        """All inputs of which the newest message counts."""

    def callbacks(self) -> dict[str, Callable[[bytes], None]]:
        """Return the callback per input topic; they take serialised messages."""
        return {
            "objects": self.guarded("objects", self.markers.queue),
            "object_transform": self.guarded("object_transform", self._transform, in_order=True),
            "object_states": self.guarded("object_states", self._states, in_order=True),
            "object_poses": self.guarded("object_poses", self._poses, in_order=True),
            **{boxes.topic: self.guarded(boxes.topic, boxes.queue) for boxes in self.sets},
        }

    def guarded(
        self,
        topic: str,
        take: Callable[[bytes, int], None],
        in_order: bool = False,
        changes: bool = True,
    ) -> Callable[[bytes], None]:
        """Return a callback that counts messages, and those that ``take`` refuses or fails on.

        take: stores a message, given the time (ns) of its receipt; its RefusedError refuses the
        whole message. in_order: whether the markers and boxes that came before are applied first.
        changes: whether it changes objects, which after an unforeseen error may differ from the
        messages.
        """
        monitor = self._monitors[topic]

        def callback(data: bytes) -> None:
            now = self._clock()
            monitor.received(now)
            try:
                if in_order:
                    self.markers.apply()
                    for boxes in self.sets:
                        boxes.apply()
                take(data, now)
            except Exception as error:
                refusal = self._objects.guard.refusal(f"input {topic}", error)
                if changes and not isinstance(error, (RefusedError, MemoryError)):
                    self._objects.broken = f"input {topic}"
                monitor.refuse_whole(refusal.reason, refusal.detail)

        return callback

    def _transform(self, data: bytes, now: int) -> None:
        message = pose_from_bytes(data)
        if message.name in self.bases:
            self.bases[message.name](message, now)
        else:
            names = [message.name]
            self._store_named("object_transform", names, message.pose, message.header, now)

    def _states(self, data: bytes, now: int) -> None:
        """Store poses by name, and twists if there is one for each; else they are counted."""
        message, monitor = states_from_bytes(data), self._monitors["object_states"]
        names, poses = message.names, message.poses
        if len(names) != len(poses):  # then the pose of a name is ambiguous
            detail = f"{len(names)} joint_names, {len(poses)} transforms"
            monitor.refuse(LENGTHS_DIFFER, detail=detail)
            slots = self._objects.table.find_named(names)
            self._objects.states.refuse(slots[slots >= 0])
            self._note_unknown(slots < 0, lambda row: names[row], now)
            if len(names) < len(poses):
                monitor.mark_unreadable(LENGTHS_DIFFER)
            return
        twists = self._twists(message)
        self._store_named("object_states", names, poses, message.header, now, twists)

    def _twists(self, message: NamedStates) -> Floats | None:
        """Return twists (n, 6), NaN where they are invalid; None without one for each pose."""
        names, twists = message.names, message.twists
        if len(twists) == 0:
            return None
        monitor = self._monitors["object_states"]
        if len(twists) != len(names):
            detail = f"{len(twists)} twists, {len(names)} names; poses used"
            monitor.refuse(LENGTHS_DIFFER, "twist", detail)
            return None
        bad = np.asarray(~(np.abs(twists) <= LARGEST_COORDINATE).all(axis=1))
        monitor.refuse_rows(bad, "bad twist", lambda row: _shown(names[row]), "pose used")
        twists[bad] = np.nan
        return twists

    def _poses(self, data: bytes, now: int) -> None:
        message, table = cloud_from_bytes(data), self._objects.table
        namespaces, ids, poses = poses_from_ros(message, self._objects.max_points)
        slots = table.find(namespaces, ids)
        name = self._names_of(namespaces, ids)
        if namespaces is not None and (slots < 0).any():
            known = table.has_namespaces(namespaces)
            if not known.all():
                self._note_unknown(~known, name, now)
                numbers, monitor = namespaces, self._monitors["object_poses"]
                monitor.refuse_rows(~known, "unknown namespace", lambda row: f"ns {numbers[row]}")
                slots, ids, poses = slots[known], ids[known], poses[known]
                name = self._names_of(namespaces[known], ids)
        self._note_unknown(slots < 0, name, now)
        self._store("object_poses", slots, poses, message.header, now, lambda row: f"id {ids[row]}")

    def _names_of(self, namespaces: Rows | None, ids: Rows) -> Callable[[int], str]:
        """Return a function from a row of bulk poses to the name of its object."""
        texts = self._objects.table.namespaces.names

        def name(row: int) -> str:
            if namespaces is None:
                return f"{next(iter(texts.values()), '')}/{ids[row]}"
            number = int(signed(namespaces[row : row + 1])[0])
            return f"{texts.get(number, stand_in(number))}/{ids[row]}"

        return name

    def _note_unknown(self, rows: Mask, name: Callable[[int], str], now: int) -> None:
        """Note the names of states whose objects do not exist."""
        if rows.any():
            self.unknown.note(map(name, np.flatnonzero(rows).tolist()), now)

    def _store_named(
        self,
        topic: str,
        names: list[str],
        poses: Floats,
        header: Header,
        now: int,
        twists: Floats | None = None,
    ) -> None:
        slots = self._objects.table.find_named(names)
        self._note_unknown(slots < 0, lambda row: names[row], now)
        self._store(topic, slots, poses, header, now, lambda row: _shown(names[row]), twists)

    def _store(
        self,
        topic: str,
        slots: Slots,
        poses: Floats,
        header: Header,
        now: int,
        describe: Callable[[int], str],
        twists: Floats | None = None,
    ) -> None:
        """Store the good rows; count the others by reason and mark their objects."""
        monitor = self._monitors[topic]
        unknown, kinds = slots < 0, pose_kinds(poses)
        owned, table = unknown, self._objects.table
        if self.bases or len(self.newest) > len(self.sets):
            owned = table.of_robot[slots] | (table.of_set[slots] == OF_SOURCE)
        free, refused = ~(unknown | owned), slots[:0]
        if not free.all() or kinds.max(initial=0) >= UNUSABLE:
            for reason, rows in (
                ("unknown object", unknown),
                (OWNED.reason, owned & ~unknown),
                ("bad pose", free & (kinds == UNUSABLE)),
                ("zero quaternion", free & (kinds == ZERO)),
            ):
                monitor.refuse_rows(rows, reason, describe)
            usable = free & ~are_unusable(kinds)
            refused = slots[free & ~usable]
            slots, poses, kinds = slots[usable], poses[usable], kinds[usable]
            twists = None if twists is None else twists[usable]
        try:
            stamp = stamp_from_ros(header.stamp)
            state = State(header.frame_id, stamp, now, topic, sender=monitor.sender)
            old = self._objects.states.store(slots, poses, state, twists, kinds)
            monitor.refuse_rows(old, OLDER)
        except RefusedError as error:
            monitor.refuse(error.reason, detail=error.detail, count=max(1, len(slots)))
            self._objects.states.refuse(slots)
        self._objects.states.refuse(refused)


def _shown(name: str) -> str:
    return repr(shortened(name))

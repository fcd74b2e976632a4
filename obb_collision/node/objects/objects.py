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

"""The objects of the node: added, moved, stale, expired and removed.

Messages are stored here as they arrive (the latest state of an object wins); once a cycle
``update`` brings the scene up to date. An object whose latest state is refused, or that is stale,
continues to collide with its last box.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from obb_collision.accuracy import Accuracy
from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.messages.cdr import NO_LIMIT
from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.messages.names import FrameTable
from obb_collision.node.objects.frames import FrameSource
from obb_collision.node.objects.placement import Placement
from obb_collision.node.objects.shapes import ObjectShapes
from obb_collision.node.objects.states import Staleness, States
from obb_collision.node.objects.table import NO_TIME, OF_SOURCE, ObjectTable, Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.building.builder import Builder, Limits
from obb_collision.scene.report import Report
from obb_collision.scene.scene import Scene
from obb_collision.scene.store.patterns import Overrides
from obb_collision.scene.store.store import NO_ROWS
from obb_collision.typing import Mask


class Objects:
    """The table of objects, and what works on it: shapes, states, and their placement in the scene.

    monitors: by input topic, count refused and doubtful items.
    """

    def __init__(
        self,
        fixed_frame: str,
        frames: FrameSource,
        guard: Guard,
        monitors: Mapping[str, InputMonitor],
    ) -> None:
        self.scene, self.table, self.guard, self.monitors = Scene(), ObjectTable(), guard, monitors
        self.scene.rules.warns = False  # objects come and go
        scene, table = self.scene, self.table
        self.placement = Placement(scene, table, FrameTable(fixed_frame), frames, guard, monitors)
        self.states = States(table, self.placement, monitors)
        self.staleness = Staleness(scene, table, self.states, self.placement)
        self.shapes = ObjectShapes(scene, table, self.placement, guard, monitors["objects"])
        self.unplaceable = self.shapes.unplaceable
        """Newcomers that were refused, and why."""
        self.table.namespaces.named = self._rename
        self._tree_builder = Builder()
        self.max_points = NO_LIMIT
        """Points of a cloud, and rows of bulk poses and sets of boxes."""
        self.broken = ""
        """Where an unforeseen error may have left objects that differ from the messages."""
        self.is_declared_empty = False
        """Whether a sender has declared that there is no object, and none has come since."""
        self.links_on_boxes: Slots = NO_ROWS
        """Links of robots in pairs that the last check left on boxes, their hulls being built."""
        self.trees = self.scene.objects.build_outside(self._tree_builder)
        """Hulls and trees of shapes, for an accuracy above obb."""

    def _rename(self, namespace: int) -> None:
        """Set the names of the objects of a namespace (number) to those in the table now."""
        table, overrides = self.table, self.shapes.overrides
        slots = np.flatnonzero(table.live & (table.ns == namespace))
        names = [name_from_key(key) for key in table.keys(slots)]
        self.scene.objects.rename(slots, names)
        table.limited[slots] = False  # their limits go by their names
        table.renamed()
        for name in names if overrides else ():
            self.scene.set_accuracy(name, overrides.value(name))

    @property
    def is_empty(self) -> bool:
        """Whether there is no object but links of robots, or but what sensors see.

        With links the clouds of sensors are objects as any; alone they collide with nothing.
        """
        table = self.table
        links = int(np.count_nonzero(table.of_robot))
        clouds = int(np.count_nonzero(table.of_set == OF_SOURCE))
        return len(table) - links <= (0 if links else clouds)

    def pairs_on_boxes(self, report: Report) -> Mask:
        """Return (m,) which pairs of a report are on boxes though a hull of theirs is being built.

        Those of robots, whose boxes collide far too often; their links are noted.
        """
        pairs, table = report.pairs, self.table
        self.links_on_boxes = NO_ROWS
        on_boxes = np.zeros(len(pairs), np.bool_)
        if report.behind and self.trees.waiting:
            links = table.of_robot[pairs]
            on_boxes = links.any(axis=1) & (report.accuracies <= Accuracy.OBB)
            on_boxes &= np.isin(pairs, self.trees.slots_waiting).any(axis=1)
            self.links_on_boxes = np.unique(pairs[on_boxes][links[on_boxes]])
        return on_boxes

    def declare_empty(self) -> None:
        """Note that a sender has declared its objects: with none, the scene is empty on purpose."""
        self.is_declared_empty = self.is_empty and not self.unplaceable

    def set_limits(self, limits: Limits) -> None:
        """Limit what shapes may take to build."""
        self.shapes.builder.limits = self._tree_builder.limits = limits

    def close(self) -> None:
        """End the processes that build."""
        self.shapes.builder.close()
        self._tree_builder.close()

    def clear(self) -> int:
        """Remove all objects and names; returns the number of objects."""
        slots = np.flatnonzero(self.table.live)
        self.shapes.remove(slots)
        for key in list(self.unplaceable):
            self.shapes.unplaceable.forget(key)
        self.table.namespaces.forget_unused()
        self.placement.forget_unused_frames()
        self.broken = ""
        self.declare_empty()
        return len(slots)

    def clock_jumped(self, shift: int) -> None:
        """Take over a jump of the clock by ``shift`` (ns): ages and remaining lifetimes stay.

        Stamps of before it mean nothing any more.
        """
        table = self.table
        self.staleness.keep_ages(shift)
        table.received += shift
        table.world_received += shift
        table.expiry[table.expiry != NO_TIME] += shift
        table.order[:] = table.world_stamp[:] = 0
        self.shapes.unplaceable.clock_jumped(shift)
        self.placement.clock_jumped(shift)

    def update(self, now: int) -> None:
        """Bring the scene up to date at time ``now`` (ns): expire, place, mark stale."""
        table = self.table
        if len(self.scene) != len(table):
            self.scene.objects.remove(self.shapes.strangers())
        self.is_declared_empty &= self.is_empty and not self.unplaceable
        self.shapes.remove(np.flatnonzero(table.live & table.seen & (table.expiry <= now)))
        self.shapes.unplaceable.expire(now)
        self.shapes.use_built()
        self.placement.place(now)
        self.staleness.mark(now)
        table.seen[:] = table.live  # whose lifetime is over has taken part once, at least
        self.states.mark_doubtful(now)

    def set_overrides(self, overrides: Overrides[Accuracy]) -> None:
        """Set the accuracy of objects by their names, also of future objects."""
        self.shapes.overrides = overrides
        for name in map(name_from_key, self.table.slots):
            self.scene.set_accuracy(name, overrides.value(name))

    def newest_stamp(self, now: int) -> int:
        """Return the stamp (ns) of the newest state evaluated.

        The time of receipt where no stamp is credible; ``now`` where there is no object.
        """
        table, rows = self.table, self.table.visible
        if not rows.any():
            return now
        return self.believed_stamp(now) or int(table.world_received[rows].max())

    def believed_stamp(self, now: int) -> int:
        """Return the stamp (ns) of the newest state evaluated, 0 where no stamp is credible."""
        stamps = self.table.world_stamp[self.table.visible]
        believed = stamps <= now + self.states.stamp_tolerance
        return int(stamps.max(initial=0, where=believed))

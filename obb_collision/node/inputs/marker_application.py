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

"""Applying the outcome of markers: objects are removed, added or changed."""

from __future__ import annotations

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.box_set import OWNED
from obb_collision.node.inputs.marker_adder import MarkerAdder
from obb_collision.node.inputs.marker_batch import (
    GOOD,
    Faults,
    Outcome,
    find_faults,
    settle,
)
from obb_collision.node.inputs.marker_rows import Gathered
from obb_collision.node.inputs.unknown_objects import UnknownObjects
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.shape_plans import ANNOTATIONS
from obb_collision.node.objects.conditions import LIVE, UNPLACED
from obb_collision.node.objects.many import (
    renew_slots,
)
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER
from obb_collision.node.runtime.guard import Guard
from obb_collision.typing import Mask, Rows


class MarkerApplication:
    """Applies markers at a time (ns)."""

    def __init__(
        self,
        objects: Objects,
        monitor: InputMonitor,
        guard: Guard,
        now: int,
        unknown: UnknownObjects,
    ) -> None:
        self._objects, self._now, self._unknown = objects, now, unknown
        self._adder = MarkerAdder(objects, monitor, guard, now)

    def settle(self, markers: Gathered) -> tuple[Faults, Outcome]:
        """Return the faults of markers, which are counted, and their outcome."""
        faults = find_faults(markers, self._objects.placement.frame_index)
        outcome = settle(markers, faults, self._now, self._objects.states.stamp_tolerance)
        for number, error in enumerate(faults.errors):
            bad = (faults.number == number) & ~markers.counted
            self._adder.refuse(markers, np.flatnonzero(bad), error)
        late = outcome.late & ~markers.counted
        self._adder.refuse(markers, np.flatnonzero(late), RefusedError(OLDER))
        new = (markers.action == Marker.ADD) & (faults.number == GOOD) & ~markers.counted
        new[outcome.winner[outcome.winner >= 0]] = False
        self._objects.states.superseded["objects"] += int(np.count_nonzero(new & ~outcome.late))
        markers.counted[:] = True
        return faults, outcome

    def run(self, markers: Gathered, faults: Faults, outcome: Outcome) -> None:
        """Apply them."""
        objects = self._objects
        outcome = self._without_boxes(markers, outcome)
        slots = self._remove(markers, outcome)
        there = np.flatnonzero(outcome.winner >= 0)
        there = there[np.argsort(outcome.winner[there])]
        self._adder.add(markers, outcome.winner[there], slots[there], outcome.previous)
        for row in outcome.bad[outcome.bad >= 0].tolist():
            number = faults.number[row]
            error, of_shape = faults.errors[number], faults.of_shape[number]
            expiry = int(markers.expiry[row])
            objects.shapes.refuse(markers.key(row), error.reason, of_shape, expiry)

    def _without_boxes(self, markers: Gathered, outcome: Outcome) -> Outcome:
        """Exclude, and count, markers that name objects of sets of boxes, or links of robots."""
        table = self._objects.table
        slots = self._adder.find_slots(markers, outcome.first)
        owned = (slots >= 0) & ((table.of_set[slots] > 0) | table.of_robot[slots])
        if not owned.any():
            return outcome
        winner, removed = outcome.winner[owned], outcome.removed[owned]
        self._adder.mark(markers, winner[winner >= 0], OWNED)
        self._adder.refuse(markers, outcome.remover[owned][removed & (winner < 0)], OWNED)
        return outcome._replace(
            first=outcome.first[~owned],
            winner=outcome.winner[~owned],
            bad=outcome.bad[~owned],
            removed=outcome.removed[~owned],
            remover=outcome.remover[~owned],
        )

    def _remove(self, markers: Gathered, outcome: Outcome) -> Rows:
        """Take out what was there and is deleted; return the slots (k,) of the rest, -1 for none.

        What is deleted and comes again as it was, in the fixed frame, stays in its place.
        """
        objects, table = self._objects, self._objects.table
        added, deletes = markers.action == Marker.ADD, markers.action == Marker.DELETE
        added &= ~np.isin(markers.type, ANNOTATIONS)
        everything = markers.ns[markers.action == Marker.DELETEALL]
        was_something = not objects.is_empty or bool(objects.unplaceable) or added.any()
        doomed = self._deleted_by_all(markers)
        slots = self._adder.find_slots(markers, outcome.first)
        doomed[slots[outcome.removed & (slots >= 0)]] = True
        deleted = [markers.key(row) for row in outcome.first[outcome.removed].tolist()]
        for key in deleted if objects.unplaceable else ():
            objects.shapes.unplaceable.delete(key)
        again = np.flatnonzero((slots >= 0) & (outcome.winner >= 0))
        again = again[doomed[slots[again]]]
        if len(again):
            rows = outcome.winner[again]
            is_fixed = [objects.placement.frame_table.is_fixed(frame) for frame in markers.frames]
            fixed = np.array(is_fixed)[markers.frame[rows]]
            same = self._adder.have_shapes(markers, rows, slots[again])
            same |= self._adder.have_built_shapes(markers, rows, slots[again])
            same &= fixed
            again = again[same & ~table.has(UNPLACED, slots[again])]
            doomed[slots[again]] = False
        gone = np.flatnonzero(doomed & table.live)
        self._unknown.deleted((*deleted, *table.keys(gone)), self._now)
        objects.shapes.remove(gone)
        told = was_something and (len(everything) or deletes.any())
        if told or any(not markers.namespaces[index] for index in everything.tolist()):
            objects.declare_empty()
        renew_slots(objects.shapes, slots[again])
        return np.where((slots >= 0) & table.has(LIVE, slots), slots, -1)

    def _deleted_by_all(self, markers: Gathered) -> Mask:
        """Return which slots are deleted by DELETEALL, of all or of a namespace, as in RViz."""
        objects, table = self._objects, self._objects.table
        doomed = np.zeros(len(table.condition), np.bool_)
        for index in np.unique(markers.ns[markers.action == Marker.DELETEALL]).tolist():
            name = markers.namespaces[index]
            objects.shapes.unplaceable.delete_all(name or None)
            if not name:
                doomed |= table.live
            elif index not in markers.bad_namespaces:
                doomed |= table.live & (table.ns == self._adder.number_of(name))
        return doomed & ~((table.of_set > 0) | table.of_robot)

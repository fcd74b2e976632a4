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

"""Lists of cubes, spheres and points: markers of their elements take their place.

The elements of the list ``ns/id`` are ``ns/id#/0``, ``ns/id#/1``, ...: parts of one body, see
``scene.store.patterns``. What deletes or replaces the list does so to its elements. Of several
messages of a list in a batch, the last one that can be used counts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.geometry.poses import compose_poses
from obb_collision.node.inputs.batch import Batch
from obb_collision.node.messages.conversions import Key, are_unusable, name_from_key, pose_kinds
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_shapes import LISTS, Elements, MarkerShape, elements_of
from obb_collision.node.messages.names import check_name
from obb_collision.node.objects.conditions import POSE_OVERTAKEN
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.states import OLDER
from obb_collision.scene.store.patterns import PARTS, whole_of
from obb_collision.typing import Mask, Rows

COLUMNS = (
    *("part", "row", "received", "sender", "expiry", "stamp", "id", "type", "action", "locked"),
    *("poses", "scales"),
)
"""The columns of a batch, but for the names."""
TOO_MANY = RefusedError("too many objects", "in lists that came together")
EVERY = np.zeros(1, np.int64)
"""The id of a marker that is about all of a namespace."""


class Inserted(NamedTuple):
    """Markers to insert before a row, which are like it but for what they have here."""

    row: int
    action: int
    namespace: str
    ids: Rows
    elements: Elements | None = None


@dataclass
class Changes:
    """Markers to insert into a batch, those that stay (n,), and faults by row."""

    stays: Mask
    inserted: list[Inserted] = field(default_factory=list)
    faults: dict[int, RefusedError] = field(default_factory=dict)
    chosen: dict[Key, tuple[int, Elements]] = field(default_factory=dict)
    """The row of each list that counts, so far."""
    newest: dict[Key, int] = field(default_factory=dict)
    """Stamps: older ones are late."""
    all_deleted: bool = False
    """Whether nothing in the table counts any more."""


class MarkerLists:
    """Replaces the markers of lists in batches; the lists that are there are those in the table."""

    def __init__(self, objects: Objects) -> None:
        self._objects, self._table = objects, objects.table
        self._monitor = objects.monitors["objects"]
        self._version = -1
        self._known: dict[str, set[int]] = {}

    def expand(self, markers: Batch) -> tuple[Batch, dict[int, RefusedError]]:
        """Return markers of elements in place of lists, and the faults of lists, by row."""
        lists = (markers.action == Marker.ADD) & np.isin(markers.type, list(LISTS))
        known = self._lists()
        if not (known or lists.any()):
            return markers, {}
        changes = Changes(np.ones(len(markers), np.bool_))
        for row in np.flatnonzero(lists | self._are_about(markers, lists, known)).tolist():
            if markers.action[row] == Marker.DELETEALL:
                self._delete_all(markers.ns.texts[markers.ns.of[row]], row, changes, known)
            else:
                self._take(markers, row, bool(lists[row]), changes)
        room = self._objects.shapes.max_objects
        for key, (row, elements) in changes.chosen.items():
            room -= len(elements.points)
            if room < 0:
                changes.faults[row] = TOO_MANY
            else:
                self._replace(key, row, elements, changes)
        return _with_inserted(markers, changes)

    def _lists(self) -> dict[str, set[int]]:
        """Return the ids of lists that may be there, by namespace."""
        namespaces = self._table.namespaces
        if namespaces.version != self._version:
            self._version, self._known = namespaces.version, {}
            for text in namespaces.names.values():
                namespace, _, ident = whole_of(f"{text}/0").rpartition("/")
                if text == _space((namespace, ident)):
                    self._known.setdefault(namespace, set()).add(int(ident))
        return self._known

    def _are_about(self, markers: Batch, lists: Mask, known: dict[str, set[int]]) -> Mask:
        """Return which markers (n,) may delete or replace a list, or are taken as such."""
        about: Mask = markers.action == Marker.DELETEALL
        new = set(markers.ns.of[lists].tolist())
        for index, text in enumerate(markers.ns.texts):
            if index in new or (text in known and index not in markers.ns.bad):
                rows = markers.ns.of == index
                ids = [*known.get(text, ()), *markers.id[rows & lists].tolist()]
                about |= rows & np.isin(markers.id, ids)
        return about

    def _take(self, markers: Batch, row: int, is_list: bool, changes: Changes) -> None:
        """Take note of a marker of a list, or of one that ends a list."""
        key, action = markers.key(row), int(markers.action[row])
        if action not in (Marker.ADD, Marker.DELETE):
            return
        newest = 0 if action == Marker.DELETE else self._newest(markers, key, row, changes)
        if 0 < markers.stamp[row] < newest:
            changes.stays[row] = False
            self._refuse_late(key)
            return
        elements = None
        if is_list:
            try:
                elements = self._elements(markers, row)
            except RefusedError as error:
                changes.faults[row] = error
                return
        changes.newest[key] = newest
        self._drop(key, changes)
        if elements is None:
            ids = self._table.id[self._slots(key)]
            changes.inserted.append(Inserted(row, Marker.DELETE, _space(key), ids))
        else:
            changes.chosen[key] = row, elements

    def _newest(self, markers: Batch, key: Key, row: int, changes: Changes) -> int:
        """Return the newest stamp of a list with a marker: that of this one unless it is late."""
        states, table = self._objects.states, self._table
        stamp, received = int(markers.stamp[row]), int(markers.received[row])
        newest, slot = changes.newest.get(key, 0), table.slots.get((_space(key), 0))
        if slot is not None and key not in changes.newest and not changes.all_deleted:
            orders = received - int(table.received[slot]) <= states.order_timeout
            newest = int(table.order[slot]) if orders else 0
        return max(newest, stamp if stamp <= received + states.stamp_tolerance else 0)

    def _refuse_late(self, key: Key) -> None:
        """Count a marker that is older than its list."""
        self._monitor.refuse(OLDER, name_from_key(key), "a newer state was received")
        self._table.mark(self._slots(key), POSE_OVERTAKEN)

    def _elements(self, markers: Batch, row: int) -> Elements:
        """Return the elements of a list; RefusedError where it is not used."""
        part, at = markers.parts[markers.part[row]], int(markers.row[row])
        for names in (markers.ns, markers.frame):
            if int(names.of[row]) in names.bad:
                raise names.bad[int(names.of[row])]
        if markers.stamp[row] < 0:
            raise RefusedError("bad stamp")
        if are_unusable(pose_kinds(markers.poses[row : row + 1]))[0]:
            raise RefusedError("bad pose", "not finite, too large, or without a quaternion")
        check_name(_space(markers.key(row)), "namespace")
        kind, scale = int(markers.type[row]), markers.scales[row]
        shape = MarkerShape(kind, scale, part.points("points", at))
        return elements_of(shape, self._objects.shapes.max_objects)

    def _slots(self, key: Key) -> Rows:
        """Return the slots (k,) of the elements of a list."""
        table, number = self._table, self._table.namespaces.find(_space(key))
        return np.flatnonzero(table.live & (number is not None and table.ns == number))

    def _delete_all(
        self, namespace: str, row: int, changes: Changes, known: dict[str, set[int]]
    ) -> None:
        """Delete the lists of a namespace, "" for all, that came before a row."""
        for key in [key for key in changes.chosen if namespace in ("", key[0])]:
            self._drop(key, changes)
        if not namespace:
            changes.all_deleted = True
            changes.newest.clear()
        for ident in known.get(namespace, ()):
            space = _space((namespace, ident))
            changes.inserted.append(Inserted(row, Marker.DELETEALL, space, EVERY))
            changes.newest[namespace, ident] = 0

    def _drop(self, key: Key, changes: Changes) -> None:
        """Drop a marker of a list that does not count any more."""
        earlier = changes.chosen.pop(key, None)
        if earlier is not None:
            changes.stays[earlier[0]] = False
            self._monitor.superseded += 1

    def _replace(self, key: Key, row: int, elements: Elements, changes: Changes) -> None:
        """Insert the markers of elements in place of that of their list."""
        changes.stays[row] = False
        if key in self._table.slots or self._objects.unplaceable or changes.faults:
            own = np.array([key[1]], np.int64)
            changes.inserted.append(Inserted(row, Marker.DELETE, key[0], own))
        ids, count = self._table.id[self._slots(key)], len(elements.points)
        surplus = ids[ids >= count]
        changes.inserted.append(Inserted(row, Marker.DELETE, _space(key), surplus))
        new = np.arange(count)
        changes.inserted.append(Inserted(row, Marker.ADD, _space(key), new, elements))


def _space(key: tuple[str, int | str]) -> str:
    """Return the namespace of the elements of a list."""
    return f"{key[0]}/{key[1]}{PARTS}"


def _with_inserted(markers: Batch, changes: Changes) -> tuple[Batch, dict[int, RefusedError]]:
    """Return the markers that stay with those that are inserted, and the faults by new row."""
    stay = np.flatnonzero(changes.stays)
    befores = [np.full(len(part.ids), part.row) for part in changes.inserted]
    source = np.concatenate([stay, *befores])
    columns = {name: getattr(markers, name)[source] for name in COLUMNS}
    of, texts, end = markers.ns.of[source], [*markers.ns.texts], len(stay)
    numbers = {text: number for number, text in enumerate(texts)}
    for part in changes.inserted:
        rows, end = slice(end, end + len(part.ids)), end + len(part.ids)
        if part.namespace not in numbers:
            numbers[part.namespace] = len(texts)
            texts.append(part.namespace)
        of[rows] = numbers[part.namespace]
        columns["id"][rows], columns["action"][rows] = part.ids, part.action
        if part.elements is not None:
            kind, scale, points = part.elements
            columns["type"][rows], columns["scales"][rows] = kind, scale
            turn = np.tile((0.0, 0.0, 0.0, 1.0), (len(points), 1))
            placed = compose_poses(columns["poses"][rows], np.hstack([points, turn]))
            columns["poses"][rows, :3] = placed[:, :3]
    order = np.argsort(2 * source + (np.arange(len(source)) < len(stay)), kind="stable")
    ns = markers.ns._replace(of=of[order], texts=texts)
    frame = markers.frame._replace(of=markers.frame.of[source][order])
    taken = {name: column[order] for name, column in columns.items()}
    where = np.empty(len(source), np.int64)
    where[order] = np.arange(len(source))
    at = dict(zip(stay.tolist(), where[: len(stay)].tolist(), strict=True))
    faults = {at[row]: error for row, error in changes.faults.items()}
    return replace(markers, **taken, ns=ns, frame=frame), faults

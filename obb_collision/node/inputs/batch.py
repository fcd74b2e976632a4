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

"""The markers of several messages as arrays, and which of them take effect.

Actions take effect in order, but only the last usable state of an object is applied. So one cycle
works off a backlog of any number of messages. DELETEALL cancels the markers before it. Nothing else
is left out but what later markers undo.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from visualization_msgs.msg import Marker

from obb_collision._jit import njit
from obb_collision.boxes import Boxes
from obb_collision.node.messages.box_markers import FREE, Markers
from obb_collision.node.messages.cdr import Items, markers_from_bytes
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    NANOSECONDS,
    SMALLEST_MEANT,
    UNUSABLE,
    ZERO,
    Key,
    Kinds,
    pose_kinds,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import MAX_FRAMES, check_name, shortened
from obb_collision.node.objects.table import ID_BITS, ID_OFFSET, NO_TIME, PRIMITIVES
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.building.jobs import NO_MEMORY
from obb_collision.typing import Floats, Mask, Rows

GOOD = -1
SHORTEST_LIFETIME = 100_000
"""RViz takes a marker lifetime up to this (ns) as none."""


def put_rows(
    rows: Rows,
    put: Callable[[Rows], None],
    fail: Callable[[int, RefusedError], None],
    guard: Guard,
    where: str,
    name: Callable[[int], str] = str,
) -> bool:
    """Call ``put`` on all rows or, where that fails, on fewer; return whether none failed.

    fail: takes a row that failed alone, and why. where, name: for the guard, which counts what was
    not foreseen: the input, and the name of a row.
    """
    try:
        if len(rows):
            put(rows)
        return True
    except Exception as error:
        if len(rows) > 1:
            half = len(rows) // 2
            parts = rows[:half], rows[half:]
            done = [put_rows(part, put, fail, guard, where, name) for part in parts]
            return all(done)
        row = int(rows[0])
        if isinstance(error, MemoryError):
            error = RefusedError(NO_MEMORY)
        fail(row, guard.refusal(where, error, name(row)))
        return False


class Names(NamedTuple):
    """The namespaces or frames of markers: their indices (n,), and the faults of some names."""

    of: Rows
    texts: list[str]
    bad: dict[int, RefusedError]


class Fault(NamedTuple):
    """Why an item can't be used; of_shape: whether its shape is at fault, not its pose."""

    error: RefusedError
    of_shape: bool


class Faults:
    """The faults of n markers or boxes: the first fault noted of each item."""

    kinds: Kinds
    """Of their poses, once those are noted."""

    def __init__(self, count: int) -> None:
        self._number = np.full(count, GOOD, np.int64)
        self._found: list[Fault] = []

    @property
    def good(self) -> Mask:
        """(n,) which items have no fault."""
        good: Mask = self._number == GOOD
        return good

    def __iter__(self) -> Iterator[tuple[Rows, Fault]]:
        """Yield the faults, each with the rows that have it."""
        for number, fault in enumerate(self._found):
            yield np.flatnonzero(self._number == number), fault

    @property
    def are_of_shape(self) -> Mask:
        """(n,) which items have a fault of the shape."""
        numbers = [number for number, fault in enumerate(self._found) if fault.of_shape]
        return np.isin(self._number, numbers)

    def of(self, row: int) -> Fault:
        """Return the fault of a row that has one."""
        return self._found[self._number[row]]

    def note(self, bad: Mask, error: RefusedError, of_shape: bool = False) -> None:
        """Add a fault to the bad items (n,) that have none so far."""
        bad = bad & self.good
        if bad.any():
            self._number[bad] = len(self._found)
            self._found.append(Fault(error, of_shape))

    def note_poses(self, poses: Floats, among: Mask | bool = True) -> None:
        """Add the faults of poses (n, 7)."""
        self.kinds = kinds = pose_kinds(poses)
        self.note(among & (kinds == UNUSABLE), RefusedError("bad pose", "not finite or too large"))
        self.note(among & (kinds == ZERO), RefusedError("zero quaternion"))

    def note_sizes(self, sizes: Floats, reason: str, among: Mask | bool = True) -> None:
        """Add the faults of edge lengths (n, 3), metres."""
        legal = (sizes >= SMALLEST_MEANT) & (sizes <= LARGEST_COORDINATE)
        bad = among & ~(legal[:, 0] & legal[:, 1] & legal[:, 2])
        if bad.any():
            detail = f"{sizes[int(np.argmax(bad))].tolist()} must be finite and positive"
            self.note(bad, RefusedError(reason, detail), of_shape=True)

    def note_groups(
        self, rows: Mask, of: Rows, bad: dict[int, RefusedError], of_shape: bool = False
    ) -> None:
        """Add the faults of groups, such as names, to their markers: one error per reason."""
        by_reason: dict[str, list[int]] = {}
        for index, error in bad.items():
            by_reason.setdefault(error.reason, []).append(index)
        for indices in by_reason.values():
            self.note(rows & np.isin(of, indices), bad[indices[-1]], of_shape)


@dataclass(frozen=True)
class Batch:
    """The markers of messages in order, n of them, as arrays; times in nanoseconds.

    part: the number of the message that each is from; row: where it is there. stamp: -1 for one
    that no clock gives.
    """

    parts: Sequence[Items]
    part: Rows
    row: Rows
    received: Rows
    sender: Rows
    expiry: Rows
    stamp: Rows
    id: Rows
    type: Rows
    action: Rows
    locked: Mask
    poses: Floats
    scales: Floats
    ns: Names
    frame: Names

    def __len__(self) -> int:
        return len(self.row)

    def key(self, row: int) -> Key:
        """Return the key of a marker; a namespace that can't be used is shortened."""
        return self.ns.texts[self.ns.of[row]], int(self.id[row])


def gather(
    parts: Sequence[Items], received: Sequence[int], senders: Sequence[int] | None = None
) -> Batch:
    """Return the markers of messages, in order."""
    sizes = [len(part) for part in parts]
    part = np.repeat(np.arange(len(parts)), sizes)
    times = np.asarray(received, np.int64)[part]
    numbers = np.concatenate([part.numbers for part in parts])
    head, body, stamp = numbers["head"], numbers["body"], numbers["stamp"]
    counts = np.concatenate([part.of("points")[:, 1] for part in parts])
    lifetime = _nanoseconds(body["lifetime"])
    lives = lifetime > SHORTEST_LIFETIME
    legal = (stamp["sec"] >= 0) & (stamp["nanosec"] < NANOSECONDS)
    return Batch(
        parts,
        part,
        row=np.concatenate([np.arange(size) for size in sizes]),
        received=times,
        sender=np.zeros_like(times) if senders is None else np.asarray(senders, np.int64)[part],
        expiry=np.where(lives, times + np.where(lives, lifetime, 0), NO_TIME),
        stamp=np.where(legal, _nanoseconds(stamp), -1),
        id=head["id"].astype(np.int64),
        type=head["type"].astype(np.int64),
        action=head["action"].astype(np.int64),
        locked=body["locked"] != 0,
        poses=_poses(numbers, counts),
        scales=body["scale"].astype(np.float64),
        ns=_names(parts, "ns", "namespace"),
        frame=_names(parts, "frame", "frame"),
    )


def _poses(numbers: npt.NDArray[Any], points: Rows) -> Floats:
    """Return poses (n, 7); an arrow between points needs no quaternion, as in RViz."""
    poses: Floats = numbers["body"]["pose"].astype(np.float64)
    is_between = (numbers["head"]["type"] == Marker.ARROW) & (points > 1)
    poses[is_between & ~poses[:, 3:].any(axis=1), 6] = 1.0
    return poses


def _nanoseconds(times: npt.NDArray[Any]) -> Rows:
    result: Rows = times["sec"].astype(np.int64) * NANOSECONDS + times["nanosec"]
    return result


def _names(parts: Sequence[Items], field: str, what: str) -> Names:
    numbers_of: dict[bytes, int] = {}
    indices = []
    for part in parts:
        starts = np.flatnonzero(part.of(field)[:, 2] == 0)
        numbers = [
            numbers_of.setdefault(part.text(field, row), len(numbers_of)) for row in starts.tolist()
        ]
        lengths = np.diff(np.append(starts, len(part)))
        indices.append(np.repeat(np.array(numbers, np.int64), lengths))
    names, faults = [], dict[int, RefusedError]()
    for index, data in enumerate(numbers_of):
        name = data.decode(errors="replace")
        try:
            if "\ufffd" in name and data != name.encode():
                raise RefusedError("bad name", f"{what} must be UTF-8")
            check_name(name, what)
        except RefusedError as error:
            faults[index] = error
            name = shortened(name)
        names.append(name)
    return Names(np.concatenate(indices), names, faults)


def _bad_frames(frames: Names, index_frame: Callable[[str], int]) -> dict[int, RefusedError]:
    bad = dict(frames.bad)
    good = [index for index in range(len(frames.texts)) if index not in bad]
    for index in good[:MAX_FRAMES]:
        try:
            index_frame(frames.texts[index])
        except RefusedError as error:
            bad[index] = error
    for index in good[MAX_FRAMES:]:
        bad[index] = RefusedError("too many frames", f"{len(good)} in one cycle")
    return bad


def find_faults(markers: Batch, index_frame: Callable[[str], int]) -> Faults:
    """Return the faults of markers that array operations can find.

    index_frame: returns the index of a frame, or raises RefusedError.
    """
    faults = Faults(len(markers))
    deletes = (markers.action == Marker.DELETE) | (markers.action == Marker.DELETEALL)
    adds = markers.action == Marker.ADD
    faults.note(~(adds | deletes), RefusedError("unknown action"), of_shape=True)
    faults.note_groups(adds, markers.ns.of, markers.ns.bad, of_shape=True)
    faults.note(adds & (markers.stamp < 0), RefusedError("bad stamp"))
    faults.note_poses(markers.poses, adds)
    faults.note_groups(adds, markers.frame.of, _bad_frames(markers.frame, index_frame))
    faults.note_sizes(markers.scales, "bad scale", adds & np.isin(markers.type, PRIMITIVES))
    return faults


class Settled(NamedTuple):
    """The outcome of markers: k objects, one row each; -1 for none.

    first: a marker of the object. winner: the last one that can be used and is not undone. bad: a
    later one that can't be used. remover: the last one for which what was there before is gone.
    overtaken: one with an older stamp since. late (n,): markers with an older stamp than one before
    them. previous (n,): the one that would count without this one. newest (n,): the newest stamp
    of the object once this one is taken.
    """

    first: Rows
    winner: Rows
    bad: Rows
    remover: Rows
    overtaken: Rows
    late: Mask
    previous: Rows
    newest: Rows

    def of_objects(self, objects: Mask) -> Settled:
        """Return the outcome for some of the objects."""
        columns = {name: getattr(self, name)[objects] for name in self._fields[:5]}
        return self._replace(**columns)


ADDS, BAD, DELETES, ENDS, CANCELLED = range(5)
"""Effects of a marker on its object: one that ENDS has expired, and is superseded."""


@njit
def _settle(
    keys: Rows, rows: Rows, effects: Rows, times: Rows, objects: Rows, late: Mask, previous: Rows
) -> int:
    """Go through the markers of each object in order; return how many objects there are.

    times (n, 4): stamp, receipt, expiry, and the newest stamp of the object: before all of them,
    and once each is taken. A stamp is compared as it would be on receipt: with the newest one of
    the object by then, if the object has not expired.
    """
    count = newest = 0
    until = NO_TIME
    for position in range(len(rows)):
        row = rows[position]
        if position == 0 or keys[row] != keys[rows[position - 1]]:
            objects[count, 0] = row
            count += 1
            newest, until = times[row, 3], NO_TIME
        outcome, effect = objects[count - 1], effects[row]
        if effect == CANCELLED:
            continue
        if effect == BAD:
            outcome[2] = row
            continue
        stamp = times[row, 0]
        if effect == DELETES or times[row, 1] >= until:
            newest = 0
        if effect != DELETES:
            if 0 < stamp < newest:
                late[row] = True
                outcome[4] = row
                continue
            newest = stamp if stamp else newest
        until, times[row, 3] = times[row, 2], newest
        outcome[2] = outcome[4] = -1
        if effect == ADDS:
            previous[row] = outcome[1]
            outcome[1] = row
        else:
            outcome[1] = -1
            outcome[3] = row
    return count


def settle(
    markers: Batch, faults: Faults, now: int, tolerance: int, newest: Rows | int = 0
) -> Settled:
    """Return the outcome of markers at time ``now`` (ns).

    A stamp further than ``tolerance`` (ns) ahead of the time of receipt orders nothing. newest
    (n,): the newest stamp of the object before these markers, 0 where it orders none of them.
    """
    count, good = len(markers), faults.good
    rows = np.flatnonzero(markers.action != Marker.DELETEALL)
    keys = (markers.ns.of << ID_BITS) + markers.id + ID_OFFSET
    rows = rows[np.argsort(keys[rows], kind="stable")]
    objects = np.full((len(rows), 5), -1, np.int64)
    late, previous = np.zeros(count, np.bool_), np.full(count, -1, np.int64)
    deletes, ends = markers.action == Marker.DELETE, _ended(markers, good, now)
    last = _last_deletion(markers)
    cases = [np.arange(count) <= last, ~good, deletes, ends]
    effects = np.select(cases, [CANCELLED, BAD, DELETES, ENDS], ADDS)
    believed = np.where(markers.stamp <= markers.received + tolerance, markers.stamp, 0)
    before = np.where(last >= 0, 0, newest)
    times = np.column_stack((believed, markers.received, markers.expiry, before))
    distinct = _settle(keys, rows, effects, times, objects, late, previous)
    first, winner, bad, remover, overtaken = objects[:distinct].T
    return Settled(first, winner, bad, remover, overtaken, late, previous, times[:, 3])


def _last_deletion(markers: Batch) -> Rows:
    """Return the last DELETEALL that is about each marker (n,) or the object it names; -1: none."""
    of = markers.ns.of
    last = np.full(len(markers.ns.texts), -1)
    deletes = np.flatnonzero(markers.action == Marker.DELETEALL)
    last[of[deletes]] = deletes  # the last one of each stays
    everything = [last[index] for index, name in enumerate(markers.ns.texts) if not name]
    latest: Rows = np.maximum(last, max(everything, default=-1))[of]
    return latest


def _ended(markers: Batch, good: Mask, now: int) -> Mask:
    """Return which states (n,) ended while they waited, and are superseded by now.

    The last message about a namespace counts though its lifetime is over: else a node that is
    slower than the lifetimes would never see anything.
    """
    adds = good & (markers.action == Marker.ADD)
    last = np.full(len(markers.ns.texts), -1)
    np.maximum.at(last, markers.ns.of[adds], markers.part[adds])
    return adds & (markers.expiry <= now) & (markers.part < last[markers.ns.of])


def compile_kernels() -> None:
    """Compile the node's kernels by using each once: write markers, and apply them."""
    boxes = Boxes(np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), np.ones((2, 3)))
    keys = [("", 1), ("", 2)]
    data = Markers("").write(keys, boxes, np.full(2, FREE), 0, 0.0, None)
    markers = gather([markers_from_bytes(data)], [0])
    pose_kinds(markers.poses)
    settle(markers, Faults(len(markers)), 0, 0)

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

"""The markers of several messages combined: which of them take effect.

Actions are applied in order, but of the states of an object only the last one that can be used is
worth the time: a backlog is worked off at once, however many messages it has. DELETEALL cancels
what came before it; nothing else is left out that the order would not have undone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision._jit import njit
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    NANOSECONDS,
    SMALLEST_MEANT,
    Key,
    pose_faults,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_scan import (
    ACTION,
    FRAME,
    ID,
    LIFETIME_NANOSEC,
    LIFETIME_SEC,
    LOCKED,
    NS,
    SAME_FRAME,
    SAME_NS,
    STAMP_NANOSEC,
    STAMP_SEC,
    TYPE,
    Scanned,
)
from obb_collision.node.messages.names import MAX_FRAMES, check_name, shortened
from obb_collision.node.objects.table import ID_BITS, ID_OFFSET, NEVER, PRIMITIVES
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.scene.building.errors import NO_MEMORY
from obb_collision.typing import Floats, Mask, Rows


def each(
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
            done = [
                each(some, put, fail, guard, where, name) for some in (rows[:half], rows[half:])
            ]
            return all(done)
        row = int(rows[0])
        if isinstance(error, MemoryError):
            error = RefusedError(NO_MEMORY)
        if not isinstance(error, RefusedError):
            guard.caught(where, error, name(row))
            error = RefusedError(INTERNAL_ERROR, str(error))
        fail(row, error)
        return False


SHORTEST_LIFETIME = 100_000
"""RViz takes a marker lifetime up to this (ns) as none."""
BYTES_PER_ROW = 200
"""Of the arrays of a marker."""


@dataclass
class Gathered:
    """The markers of messages in order, n of them, as arrays.

    message: the number of the message that each is from, rising; source, row: where it says what
    its shape is, -1 where that is its type and scale. ns, frame: indices of names; counted:
    whether a fault of it is counted already. order: the newest stamp of its object up to it, as
    far as markers had it that are left out since; 0 for none.
    """

    sources: list[Scanned]
    source: Rows
    row: Rows
    message: Rows
    received: Rows
    id: Rows
    type: Rows
    action: Rows
    locked: Mask
    seconds: Rows
    nanoseconds: Rows
    expiry: Rows
    floats: Floats
    counted: Mask
    order: Rows
    ns: Rows
    namespaces: list[str]
    bad_namespaces: dict[int, RefusedError]
    frame: Rows
    frames: list[str]
    bad_frames: dict[int, RefusedError]

    def __len__(self) -> int:
        return len(self.row)

    @property
    def nbytes(self) -> int:
        """Memory that this takes, about: that of the shapes, and the arrays."""
        return sum(source.nbytes for source in self.sources) + len(self) * BYTES_PER_ROW

    @property
    def stamp(self) -> Rows:
        """(n,) nanoseconds."""
        return self.seconds * NANOSECONDS + self.nanoseconds

    @property
    def poses(self) -> Floats:
        """(n, 7) as given."""
        return self.floats[:, :7]

    @property
    def scales(self) -> Floats:
        """(n, 3) as given."""
        return self.floats[:, 7:]

    def key(self, row: int) -> Key:
        """Key of a marker; a namespace that can't be used is shortened."""
        return self.namespaces[self.ns[row]], int(self.id[row])

    def take(self, rows: Rows) -> Gathered:
        """Return some markers; of their messages only the shapes are held in memory."""
        taken: dict[str, Any] = {name: getattr(self, name)[rows] for name in ROW_ARRAYS}
        shaped = np.flatnonzero(
            (taken["source"] >= 0)
            & (taken["action"] == Marker.ADD)
            & ~np.isin(taken["type"], PRIMITIVES)
        )
        alone = [
            self.sources[source].alone(row)
            for source, row in zip(
                taken["source"][shaped].tolist(), taken["row"][shaped].tolist(), strict=True
            )
        ]
        taken["source"][:] = -1
        taken["source"][shaped], taken["row"][shaped] = np.arange(len(alone)), 0
        return replace(self, sources=alone, **taken)


ROW_ARRAYS = tuple(
    field.name for field in fields(Gathered) if field.type in ("Rows", "Mask", "Floats")
)


def gather(parts: Sequence[Scanned], received: Sequence[int], first: int = 0) -> Gathered:
    """Return the markers of messages, in order; first: the number of the first message."""
    sizes = [len(part) for part in parts]
    source = np.repeat(np.arange(len(parts)), sizes)
    times = np.asarray(received, np.int64)[source]
    whole = np.concatenate([part.integers for part in parts])
    lifetime = whole[:, LIFETIME_SEC] * NANOSECONDS + whole[:, LIFETIME_NANOSEC]
    lives = lifetime > SHORTEST_LIFETIME
    ns, namespaces, bad_namespaces = _names(parts, NS, SAME_NS, "namespace")
    frame, frames, bad_frames = _names(parts, FRAME, SAME_FRAME, "frame")
    return Gathered(
        sources=list(parts),
        source=source,
        row=np.concatenate([np.arange(size) for size in sizes]),
        message=source + first,
        received=times,
        id=whole[:, ID],
        type=whole[:, TYPE],
        action=whole[:, ACTION],
        locked=whole[:, LOCKED] != 0,
        seconds=whole[:, STAMP_SEC],
        nanoseconds=whole[:, STAMP_NANOSEC],
        expiry=np.where(lives, times + np.where(lives, lifetime, 0), NEVER),
        floats=np.concatenate([part.floats for part in parts]),
        counted=np.zeros(len(source), np.bool_),
        order=np.zeros(len(source), np.int64),
        ns=ns,
        namespaces=namespaces,
        bad_namespaces=bad_namespaces,
        frame=frame,
        frames=frames,
        bad_frames=bad_frames,
    )


def join(first: Gathered, second: Gathered) -> Gathered:
    """Return the markers of both, in order."""
    both: dict[str, Any] = {
        name: np.concatenate([getattr(first, name), getattr(second, name)]) for name in ROW_ARRAYS
    }
    start = len(first)
    later = both["source"][start:]
    both["source"][start:] = np.where(later >= 0, later + len(first.sources), -1)
    result = replace(first, sources=[*first.sources, *second.sources], **both)
    for rows, names, bad in (
        ("ns", "namespaces", "bad_namespaces"),
        ("frame", "frames", "bad_frames"),
    ):
        known = {name: index for index, name in enumerate(getattr(first, names))}
        places = [known.setdefault(name, len(known)) for name in getattr(second, names)]
        faults = {places[index]: error for index, error in getattr(second, bad).items()}
        both[rows][start:] = np.array(places, np.int64)[both[rows][start:]]
        setattr(result, names, list(known))
        setattr(result, bad, getattr(first, bad) | faults)
    return result


def _names(
    parts: Sequence[Scanned], column: int, same: int, what: str
) -> tuple[Rows, list[str], dict[int, RefusedError]]:
    """Return the indices (n,) of texts, the texts, and the faults of some of them."""
    known: dict[bytes, int] = {}
    indices = []
    for part in parts:
        starts = np.flatnonzero(part.integers[:, same] == 0)
        found = [known.setdefault(part.text(row, column), len(known)) for row in starts.tolist()]
        lengths = np.diff(np.append(starts, len(part)))
        indices.append(np.repeat(np.array(found, np.int64), lengths))
    names, faults = [], {}
    for index, data in enumerate(known):
        name = data.decode(errors="replace")
        try:
            if "\ufffd" in name and data != name.encode():
                raise RefusedError("bad name", f"{what} must be UTF-8")
            check_name(name, what)
        except RefusedError as error:
            faults[index] = error
            name = shortened(name)
        names.append(name)
    return np.concatenate(indices), names, faults


GOOD = -1
MAX_TRIES = 3
"""States of an object that are tried where the last one can't be built."""


class Faults:
    """Faults of markers: ``number`` (n,) into ``errors``, GOOD for none.

    of_shape: by error, whether it is the shape that can't be used, and not the pose.
    """

    def __init__(self, count: int) -> None:
        self.number = np.full(count, GOOD, np.int64)
        self.errors: list[RefusedError] = []
        self.of_shape: list[bool] = []

    def note(self, bad: Mask, error: RefusedError, of_shape: bool = False) -> None:
        """Add a fault to markers that have none so far."""
        bad = bad & (self.number == GOOD)
        if bad.any():
            self.number[bad] = len(self.errors)
            self.errors.append(error)
            self.of_shape.append(of_shape)

    def note_names(
        self, rows: Mask, names: Rows, bad: Mapping[int, RefusedError], of_shape: bool = False
    ) -> None:
        """Add the faults of names: one error per reason."""
        by_reason: dict[str, list[int]] = {}
        for index, error in bad.items():
            by_reason.setdefault(error.reason, []).append(index)
        for indices in by_reason.values():
            self.note(rows & np.isin(names, indices), bad[indices[-1]], of_shape)


def _bad_frames(markers: Gathered, index_frame: Callable[[str], int]) -> Mapping[int, RefusedError]:
    bad = dict(markers.bad_frames)
    good = [index for index in range(len(markers.frames)) if index not in bad]
    for index in good[:MAX_FRAMES]:
        try:
            index_frame(markers.frames[index])
        except RefusedError as error:
            bad[index] = error
    for index in good[MAX_FRAMES:]:
        bad[index] = RefusedError("too many frames", f"{len(good)} in one cycle")
    return bad


def find_faults(markers: Gathered, index_frame: Callable[[str], int]) -> Faults:
    """Return the faults of markers that are found by arrays.

    index_frame: returns the index of a frame, or raises RefusedError.
    """
    faults = Faults(len(markers))
    deletes = (markers.action == Marker.DELETE) | (markers.action == Marker.DELETEALL)
    adds = markers.action == Marker.ADD
    faults.note(~(adds | deletes), RefusedError("unknown action"), of_shape=True)
    faults.note_names(adds, markers.ns, markers.bad_namespaces, of_shape=True)
    seconds, rest = markers.seconds, markers.nanoseconds
    faults.note(adds & ((seconds < 0) | (rest >= NANOSECONDS)), RefusedError("bad stamp"))
    numbers, quaternions = pose_faults(markers.poses)
    faults.note(adds & numbers, RefusedError("bad pose", "not finite or too large"))
    faults.note(adds & quaternions, RefusedError("zero quaternion"))
    faults.note_names(adds, markers.frame, _bad_frames(markers, index_frame))
    primitive, scales = np.isin(markers.type, PRIMITIVES), markers.scales
    meant = ((scales >= SMALLEST_MEANT) & (scales <= LARGEST_COORDINATE)).all(axis=1)
    bad = adds & primitive & ~meant
    if bad.any():
        detail = f"{scales[int(np.argmax(bad))].tolist()} must be finite and positive"
        faults.note(bad, RefusedError("bad scale", detail), of_shape=True)
    return faults


class Outcome(NamedTuple):
    """The outcome of markers: k objects, one row each; -1 for none.

    first: a marker of the object. winner: the last one that can be used and is not undone. bad: a
    later one that can't be used. removed: whether what was there before is gone; remover: the last
    marker for which it is. late (n,): markers with an older stamp than one before them. previous
    (n,): the marker that would count without this one. order (n,): as in ``Gathered``, once all
    have been looked at.
    """

    first: Rows
    winner: Rows
    bad: Rows
    removed: Mask
    remover: Rows
    late: Mask
    previous: Rows
    order: Rows


@njit
def _settle(
    keys: Rows, rows: Rows, deletes: Mask, good: Mask, ends: Mask, cancelled: Mask,
    stamps: Rows, received: Rows, expiry: Rows,
    objects: Rows, late: Mask, previous: Rows, order: Rows,
) -> int:  # fmt: skip
    """Go through the markers of each object in order; return how many objects there are.

    A stamp is compared as it would be on receipt: with the newest one of the object by then, if
    the object has not expired.
    """
    count = newest = 0
    until = NEVER
    for position in range(len(rows)):
        row = rows[position]
        if position == 0 or keys[row] != keys[rows[position - 1]]:
            objects[count, 0] = row
            count += 1
            newest, until = 0, NEVER
        found = objects[count - 1]
        if cancelled[row]:
            continue
        if not good[row]:
            found[2] = row
            continue
        if deletes[row] or received[row] >= until:
            newest = 0
        newest = max(newest, order[row])
        if not deletes[row]:
            if 0 < stamps[row] < newest:
                late[row] = True
                continue
            newest = stamps[row] if stamps[row] else newest
        order[row], until = newest, expiry[row]
        found[2] = -1
        if deletes[row] or ends[row]:
            found[1] = -1
            found[3] = row
        else:
            previous[row] = found[1]
            found[1] = row
    return count


def settle(markers: Gathered, faults: Faults, now: int, tolerance: int) -> Outcome:
    """Return the outcome of markers at time ``now`` (ns).

    A stamp further than ``tolerance`` (ns) ahead of the time of receipt orders nothing.
    """
    count = len(markers)
    rows = np.flatnonzero(markers.action != Marker.DELETEALL)
    keys = (markers.ns << ID_BITS) + markers.id + ID_OFFSET
    rows = rows[np.argsort(keys[rows], kind="stable")]
    objects = np.full((len(rows), 4), -1, np.int64)
    late = np.zeros(count, np.bool_)
    previous = np.full(count, -1, np.int64)
    order = markers.order.copy()
    good = faults.number == GOOD
    believed = np.where(markers.stamp <= markers.received + tolerance, markers.stamp, 0)
    found = _settle(
        keys, rows, markers.action == Marker.DELETE, good, _ended(markers, good, now),
        _cancelled(markers), believed, markers.received, markers.expiry,
        objects, late, previous, order,
    )  # fmt: skip
    first, winner, bad, remover = objects[:found].T
    return Outcome(first, winner, bad, remover >= 0, remover, late, previous, order)


def remaining(markers: Gathered, outcome: Outcome) -> Gathered:
    """Return the markers that determine the outcome of all."""
    deletes = np.flatnonzero(markers.action == Marker.DELETEALL)
    deletes = deletes[~_cancelled(markers, own=False)[deletes]]
    winners = outcome.winner[outcome.winner >= 0]
    built = winners[~np.isin(markers.type[winners], PRIMITIVES)]
    rows = np.concatenate((deletes, winners, outcome.previous[built], outcome.bad, outcome.remover))
    rows = np.unique(rows[rows >= 0])
    kept = markers.take(rows)
    kept.action[np.isin(rows, outcome.remover)] = Marker.DELETE
    kept.counted[:], kept.order[:] = True, outcome.order[rows]
    return kept


def _cancelled(markers: Gathered, own: bool = True) -> Mask:
    """Return which markers (n,) come before a DELETEALL that is about them.

    own: one counts as coming before itself.
    """
    rows = np.arange(len(markers))
    last = np.full(len(markers.namespaces), -1)
    deletes = np.flatnonzero(markers.action == Marker.DELETEALL)
    last[markers.ns[deletes]] = deletes  # the last one of each stays
    everything = [last[index] for index, name in enumerate(markers.namespaces) if not name]
    ends = np.maximum(last, max(everything, default=-1))[markers.ns]
    return rows <= ends if own else rows < ends


def _ended(markers: Gathered, good: Mask, now: int) -> Mask:
    """Return which states (n,) ended while they waited, and are superseded by now.

    The last message about a namespace counts though its lifetime is over: else a node that is
    slower than the lifetimes would never see anything.
    """
    adds = good & (markers.action == Marker.ADD)
    last = np.full(len(markers.namespaces), -1)
    np.maximum.at(last, markers.ns[adds], markers.message[adds])
    return adds & (markers.expiry <= now) & (markers.message < last[markers.ns])

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

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision._jit import njit
from obb_collision.node.inputs.marker_rows import Gathered
from obb_collision.node.messages.conversions import (
    LARGEST_COORDINATE,
    NANOSECONDS,
    SMALLEST_MEANT,
    pose_faults,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import MAX_FRAMES
from obb_collision.node.objects.table import ID_BITS, ID_OFFSET, NEVER, PRIMITIVES
from obb_collision.typing import Mask, Rows

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

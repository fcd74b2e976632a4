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

"""The markers of several messages as arrays, one row per marker."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.messages.conversions import (
    NANOSECONDS,
    Key,
)
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_kernels import (
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
)
from obb_collision.node.messages.marker_scan import Scanned
from obb_collision.node.messages.names import check_name, shortened
from obb_collision.node.objects.table import NEVER, PRIMITIVES
from obb_collision.typing import Floats, Mask, Rows

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

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

"""The topic ``objects``: messages wait as bytes and are applied together, at the next cycle.

A sender that is faster than the cycles can't hold them up or make the node grow: what waits is
bounded in bytes and applied early beyond that, and however many states of an object wait, one of
them is looked at.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from visualization_msgs.msg import Marker

from obb_collision.node.diagnostics.monitors import InputMonitor
from obb_collision.node.inputs.marker_application import MarkerApplication
from obb_collision.node.inputs.marker_batch import (
    remaining,
)
from obb_collision.node.inputs.marker_rows import Gathered, gather, join
from obb_collision.node.inputs.unknown_objects import UnknownObjects
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.marker_kernels import ACTION, NS
from obb_collision.node.messages.marker_scan import Scanned, scan_markers
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import NEVER
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard

MAX_WAITING_BYTES = 64 << 20
MAX_WAITING_MESSAGES = 1000


class MarkerInput:
    """Receives messages of ``objects``, and applies their outcome."""

    def __init__(
        self,
        objects: Objects,
        monitor: InputMonitor,
        clock: Callable[[], int],
        guard: Guard,
    ) -> None:
        self._objects, self._monitor, self._clock, self._guard = objects, monitor, clock, guard
        self._waiting: list[tuple[bytes, int]] = []
        self._kept: Gathered | None = None  # of messages before those
        self._size = 0
        self._messages = 0
        self.unknown = UnknownObjects(objects.table)
        """What takes the names of objects that are deleted."""

    def take(self, data: bytes) -> None:
        """Queue a serialised MarkerArray for the next cycle."""
        now = self._clock()
        self._monitor.received(now)
        self._waiting.append((data, now))
        self._size += len(data)
        if self._size > MAX_WAITING_BYTES or len(self._waiting) > MAX_WAITING_MESSAGES:
            self._coalesce()

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        self._waiting = [(data, at + shift) for data, at in self._waiting]
        if self._kept is not None:
            self._kept.received += shift
            self._kept.expiry[self._kept.expiry != NEVER] += shift

    def _gather(self) -> Gathered | None:
        """Return all queued messages, and empty the queue.

        The newest message is read first: what comes before a DELETEALL is dropped unread.
        """
        kept, waiting = self._kept, self._waiting
        self._waiting, self._kept, self._size = [], None, 0
        parts: list[Scanned] = []
        received: list[int] = []
        is_read = False
        for data, at in reversed(waiting):
            part = self._scan(data, is_read)
            is_read |= part is not None
            if part is not None and len(part):
                parts.append(part)
                received.append(at)
                if _deletes_all(part):
                    kept = None
                    break
        if not parts:
            return kept
        new = gather(parts[::-1], received[::-1], self._messages)
        self._messages += len(parts)
        return new if kept is None else join(kept, new)

    def _scan(self, data: bytes, is_read_since: bool) -> Scanned | None:
        """Return the markers of a message, None if it is refused.

        is_read_since: whether a newer one could be read.
        """
        now, refuse = self._clock(), self._monitor.refuse_whole
        try:
            return scan_markers(data)
        except RefusedError as error:
            refuse(now, error.reason, error.detail)
        except Exception as error:
            self._guard.caught("input objects", error, "whole message")
            refuse(now, INTERNAL_ERROR, str(error))
        if is_read_since:
            self._monitor.unreadable = ""
        return None

    def _coalesce(self) -> None:
        """Reduce the queue to its outcome, or apply that if it is still too large."""
        markers = self._gather()
        if markers is None:
            return
        _, outcome = self._application().settle(markers)
        self._kept = remaining(markers, outcome)
        self._size = self._kept.nbytes
        if self._size > MAX_WAITING_BYTES // 2:
            self.apply()

    def apply(self) -> None:
        """Apply what waits."""
        markers = self._gather()
        if markers is None or self._run(markers):
            return
        for number in np.unique(markers.message).tolist():  # one that fails takes no other with it
            if not self._run(markers.take(np.flatnonzero(markers.message == number))):
                self._monitor.refuse_whole(self._clock(), INTERNAL_ERROR)
                self._objects.broken = "input objects"

    def _run(self, markers: Gathered) -> bool:
        """Apply markers; return whether that went through."""
        application = self._application()
        return self._guard.run(
            "input objects",
            lambda: application.run(markers, *application.settle(markers)),
            "whole message",
        )

    def _application(self) -> MarkerApplication:
        given = self._objects, self._monitor, self._guard, self._clock()
        return MarkerApplication(*given, self.unknown)


def _deletes_all(scanned: Scanned) -> bool:
    deletes = scanned.integers[:, ACTION] == Marker.DELETEALL
    return bool((deletes & (scanned.integers[:, NS + 1] == 0)).any())

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

"""Where objects were at a check, for whatever is computed later, without a copy of all of them."""

from __future__ import annotations

import threading

from obb_collision.geometry.boxes import Boxes
from obb_collision.typing import Floats, Rows

#: While fewer than one object in so many moved since, what they were is noted; else all is copied.
NOTED_SHARE = 4


class Snapshot:
    """The world boxes of all slots at one time, over arrays that the store goes on writing to.

    Before the store writes, it either has the rows noted or leaves the arrays to the snapshot: the
    latter while some thread reads them, which is what ``with snapshot:`` is for.
    """

    __slots__ = ("__weakref__", "_boxes", "_lock", "_notes", "_readers", "_room", "attached")

    def __init__(self, boxes: Boxes) -> None:
        self._boxes = boxes
        self._notes: list[tuple[Rows, Floats, Floats]] = []
        self._room = len(boxes) // NOTED_SHARE
        self._readers = 0
        self._lock = threading.Lock()
        self.attached = True
        """Whether the arrays are still those of the store."""

    def __enter__(self) -> None:
        with self._lock:
            self._readers += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._readers -= 1

    @property
    def is_current(self) -> bool:
        """Whether nothing has changed since."""
        return self.attached and not self._notes

    @property
    def boxes(self) -> Boxes:
        """The boxes; to be used while the snapshot is read."""
        with self._lock:
            if self._notes:
                self._copy()
            return self._boxes

    def note(self, rows: Rows) -> bool:
        """Note what rows are, which are about to change; False if that will not do."""
        with self._lock:
            if self._readers or len(rows) > self._room:
                return False
            self._room -= len(rows)
            boxes = self._boxes
            self._notes.append((rows.copy(), boxes.centers[rows], boxes.rotations[rows]))
            return True

    def detach(self) -> None:
        """Part from the store, which leaves the arrays to a snapshot that is current."""
        with self._lock:
            if self._notes:
                self._copy()
            self.attached = False

    def _copy(self) -> None:
        """Part from the store by a copy, in which the rows noted are what they were."""
        centers, rotations = self._boxes.centers.copy(), self._boxes.rotations.copy()
        for rows, old_centers, old_rotations in reversed(self._notes):
            centers[rows], rotations[rows] = old_centers, old_rotations
        self._boxes = Boxes.trusted(centers, rotations, self._boxes.arrays.half_extents)
        self.attached = False
        self._notes.clear()

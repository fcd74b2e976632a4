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

"""Transforms of frames at the stamps that a cycle needs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from obb_collision.node.messages.conversions import pose_faults
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects.frames import EXTRAPOLATION, FrameSource
from obb_collision.node.objects.table import Slots
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.typing import Floats, Mask

FEW_STAMPS = 8
"""Up to this many stamps of a frame are looked up one after the other, newest first; with
more, steps backwards double: a transform missing at a stamp is missing at all newer ones."""


class Transforms:
    """Looks frames up at most once per stamp; valid for one cycle.

    name: of a frame by its index.
    """

    def __init__(self, frames: FrameSource, name: Callable[[int], str], guard: Guard) -> None:
        self._frames, self._name, self._guard = frames, name, guard
        self._found: dict[tuple[int, int], Floats | None] = {}
        self.errors: dict[int, RefusedError] = {}
        """By frame: why the latest look-up of those that failed did."""

    def get(self, frame: int, stamp: int) -> Floats | None:
        """Pose (7,) of a frame at a stamp (ns, 0 for the latest); None where there is none."""
        key = frame, stamp
        if key not in self._found:
            self._found[key] = self._look_up(frame, stamp)
        return self._found[key]

    def _look_up(self, frame: int, stamp: int) -> Floats | None:
        name = self._name(frame)
        try:
            found = self._frames.lookup(name, stamp)
            if any(fault.any() for fault in pose_faults(found[None])):
                raise RefusedError("bad transform", f"{name!r}: {found.tolist()}")
            return found
        except RefusedError as error:
            self.errors[frame] = error
        except Exception as error:
            self._guard.caught("look-up of frames", error, name)
            self.errors[frame] = RefusedError(INTERNAL_ERROR, str(error))
        return None

    def reach(self, frames: Slots, all_stamps: Slots) -> Mask:
        """Return which states (n,) can be placed: those up to the newest stamp that is found."""
        ok: Mask = frames == 0
        for frame in np.unique(frames[~ok]).tolist():
            rows = np.flatnonzero(frames == frame)
            given = all_stamps[rows]
            stamps = np.unique(given[given > 0])
            newest = self._newest(frame, stamps)
            ok[rows] = (given > 0) & (given <= newest)
            if (given == 0).any() and self.get(frame, 0) is not None:
                ok[rows[given == 0]] = True
        return ok

    def _newest(self, frame: int, stamps: Slots) -> int:
        """Return the newest of rising stamps at which a frame is found, -1 for none."""
        late, at, leap = len(stamps), len(stamps) - 1, 1
        while at >= 0 and self.get(frame, int(stamps[at])) is None:
            if self.errors[frame].reason != EXTRAPOLATION:
                return -1
            late = at
            leap = 1 if len(stamps) <= FEW_STAMPS else 2 * leap
            at = max(at - leap, 0) if at > 0 else -1
        if at < 0:
            return -1
        while late - at > 1:
            middle = (at + late) // 2
            if self.get(frame, int(stamps[middle])) is None:
                late = middle
            else:
                at = middle
        return int(stamps[at])

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

"""Objects without ROS around them: a clock, frames and stamps that a test sets."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np

from obb_collision.node.diagnostics.answer import Answer, objects_answer
from obb_collision.node.messages.conversions import Key
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.objects import Objects
from obb_collision.node.objects.frames import EXTRAPOLATION, UNKNOWN_FRAME
from obb_collision.node.objects.states import AgeLimits, State
from obb_collision.node.objects.table import UNKNOWN
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.store import Overrides
from obb_collision.shapes import Box
from obb_collision.typing import Floats

MILLISECOND = 1_000_000
SECOND = 1000 * MILLISECOND
START = 1000 * SECOND
"""Time of the clock at the start of a test (ns)."""


class KnownUntil:
    """Frames that are known from one stamp to another, and stand still at the origin."""

    waits = True
    description = "a test"

    def __init__(self) -> None:
        self.spans: dict[str, tuple[int, int]] = {}
        self.asked: list[tuple[str, int]] = []

    def lookup(self, frame: str, stamp: int) -> Floats:
        self.asked.append((frame, stamp))
        if frame not in self.spans:
            raise RefusedError(UNKNOWN_FRAME, frame)
        first, last = self.spans[frame]
        if stamp and not first <= stamp <= last:
            raise RefusedError(EXTRAPOLATION, f"{stamp} is not between {first} and {last}")
        return np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


class ObjectsRig:
    """Objects with boxes that slide along x, as far as their stamp says: 1 m per second."""

    def __init__(self, *keys: Key, timeout: float = 0.2, object_timeout: float = 0.0) -> None:
        self.frames = KnownUntil()
        self._noted: dict[bool, Counter[tuple[str, str]]] = {True: Counter(), False: Counter()}
        self.errors: list[str] = []
        self.objects = Objects("map", self.frames, Guard(self.errors.append, lambda: True))
        self.objects.placement.timeout = timeout
        self.limit(object_timeout)
        self.now = START
        self.slots = np.array(
            [self.objects.shapes.put(key, Box([1.0, 1.0, 1.0])) for key in keys], np.int64
        )

    @property
    def refused(self) -> Counter[tuple[str, str]]:
        return self._count(is_refused=True)

    @property
    def doubted(self) -> Counter[tuple[str, str]]:
        return self._count(is_refused=False)

    def _count(self, is_refused: bool) -> Counter[tuple[str, str]]:
        for note in self.objects.notices.take():
            assert note.item
            self._noted[note.is_refused][note.topic, note.reason] += note.total
        return self._noted[is_refused]

    def send(
        self, stamp: int, frame: str = "", row: int | None = None, topic: str = "object_states"
    ) -> int:
        """Store a state of all objects, or of one; returns how many were too old."""
        slots = self.slots if row is None else self.slots[[row]]
        poses = np.zeros((len(slots), 7))
        poses[:, 0], poses[:, 6] = place(stamp), 1.0
        state = State(frame, stamp, self.now, topic)
        return int(self.objects.states.store(slots, poses, state).sum())

    def cycle(self) -> None:
        self.objects.update(self.now)

    def limit(self, timeout: float = 0.0, policy: str = UNKNOWN, **more: Any) -> None:
        """Set the age limit (s) of all objects, from their first state on, and what follows it."""
        limits = AgeLimits(policy=policy, timeouts=Overrides([("*", timeout)]), **more)
        self.objects.staleness.limits = limits

    def known(self) -> Answer:
        found = objects_answer(self.objects, self.now)
        return replace(found, pairs=len(self.objects.scene.check()))

    def x(self, row: int = 0) -> float:
        """Where an object is in the scene."""
        return float(self.objects.scene.objects.poses_of(self.slots[[row]])[0, 0])

    def is_doubtful(self, row: int = 0) -> bool:
        return bool(self.objects.table.doubtful[self.slots[row]])


def place(stamp: int) -> float:
    """Where an object is at a stamp (m)."""
    return (stamp - START) / SECOND

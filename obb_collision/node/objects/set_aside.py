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

"""Checks that fail because of some objects: those are set aside, and the rest is checked.

An object set aside takes part in no check, is grey and counted as unplaceable, so that it is not
known what collides. It is tried again now and then, since other states of it may not fail.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Collection

import numpy as np

from obb_collision.node.messages.conversions import name_from_key
from obb_collision.node.objects.conditions import ASIDE, SET_ASIDE, TRIED_AGAIN
from obb_collision.node.objects.objects import Objects
from obb_collision.node.objects.table import Slots
from obb_collision.node.runtime.guard import Guard
from obb_collision.scene.report import Report

RETRY_PERIOD = 1.0
"""Seconds after which objects that were set aside are tried again."""
MAX_TRIES = 128
"""Maximum number of checks to find those that fail: 16 of 10,000 objects take at most this many."""


class SetAside:
    """Checks the scene of objects, without those with which that fails.

    clock: seconds, rising.
    """

    def __init__(
        self, objects: Objects, guard: Guard, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._objects, self._guard, self._clock = objects, guard, clock
        self._scene, self._table = objects.scene, objects.table
        self._retry = 0.0
        self._untried: Slots = np.empty(0, np.int64)  # for whom there was no time

    def check(self, effects: Collection[str]) -> Report:
        """Check the scene; raises only what is not due to single objects."""
        due = self._due()
        try:
            report = self._scene.check(() if len(due) else effects)
        except MemoryError:  # of no object in particular
            raise
        except Exception as error:
            self._isolate([self._exclude_all(error)])
        else:
            if not len(due):
                return report
            self._isolate([due])
        return self._scene.check(effects)

    def _due(self) -> Slots:
        """Return objects that are set aside and to be tried again now."""
        aside = np.flatnonzero(self._table.has(ASIDE))
        if len(aside) == 0 or self._clock() >= self._retry:
            return aside
        return aside[np.isin(aside, self._untried)]

    def _exclude_all(self, error: Exception) -> Slots:
        """Set aside all objects that take part and return them; raise if checks fail without."""
        slots = np.flatnonzero(self._table.live)
        slots = slots[self._objects.placement.takes_part(slots)]
        self._include(slots, False)
        if self._failure() is not None:
            self._include(slots, True)
            raise error
        return slots

    def _isolate(self, waiting: list[Slots]) -> None:
        """Include parts that are set aside again, halved where checks fail, down to objects."""
        for _ in range(MAX_TRIES):
            if not waiting:
                break
            part = waiting.pop()
            self._include(part, True)
            error = self._failure()
            if error is None:
                continue
            self._include(part, False)
            if len(part) > 1:
                waiting += [part[len(part) // 2 :], part[: len(part) // 2]]
            else:
                name = name_from_key(self._table.key(int(part[0])))
                self._guard.caught("check", error, name)
        self._untried = np.concatenate([self._untried[:0], *waiting])  # they are in the next cycle
        self._retry = self._clock() + RETRY_PERIOD

    def _include(self, slots: Slots, included: bool) -> None:
        self._table.mark(slots, TRIED_AGAIN if included else SET_ASIDE)
        self._objects.placement.enable(slots)

    def _failure(self) -> Exception | None:
        """Return why a check of what takes part fails, None if it does not."""
        try:
            self._scene.check()
        except MemoryError:
            raise
        except Exception as error:
            return error
        return None

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

"""How busy the machine is: a process that only sleeps, and how late it wakes."""

from __future__ import annotations

import multiprocessing
import time
from typing import Any

BEAT = 0.002
"""Seconds that it sleeps each time."""


class Metronome:
    """A process of its own, so that no lock of this one makes it late."""

    def __init__(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._latest: Any = context.Value("d", 0.0)
        self._process = context.Process(target=_beat, args=(self._latest,), daemon=True)
        self._process.start()

    @property
    def latest(self) -> float:
        """How late it was at most since the restart (s)."""
        return float(self._latest.value)

    def restart(self) -> None:
        """Reset how late it was."""
        self._latest.value = 0.0

    def end(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.join()


def _beat(latest: Any) -> None:
    last = time.monotonic()
    while True:
        time.sleep(BEAT)
        now = time.monotonic()
        latest.value = max(latest.value, now - last - BEAT)
        last = now

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

"""How far a check is: a bar on a terminal, elsewhere a line now and then."""

from __future__ import annotations

import sys
import time

WIDTH = 30
"""Characters of the bar."""
PERIOD = 10.0
"""Seconds between two lines where there is no terminal."""


class Bar:
    """Shows progress on stderr. total: of ``unit``."""

    def __init__(self, total: float, unit: str) -> None:
        self._total, self._unit = total, unit
        self._live = sys.stderr.isatty()
        self._due = time.monotonic() + PERIOD

    def show(self, done: float, text: str) -> None:
        """Draw how far it is."""
        if self._live:
            filled = round(WIDTH * min(1.0, done / self._total))
            sys.stderr.write(f"\r[{'#' * filled:<{WIDTH}}] {text}\x1b[K")
        elif time.monotonic() >= self._due:
            self._due += PERIOD
            sys.stderr.write(f"{done:.0f} of {self._total:.0f} {self._unit}: {text}\n")
        sys.stderr.flush()

    def end(self) -> None:
        """Leave the line of the bar."""
        if self._live:
            sys.stderr.write("\n")

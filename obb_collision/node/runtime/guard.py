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

"""Internal failures: each is counted and logged once, and the node continues.

Anything that goes wrong with an item of a message is refused with a reason (``RefusedError``). What
is caught here was not foreseen: a defect, or no memory left. It is caught at the item, else at the
message or the output, else at the cycle, the timer or the service.
"""

from __future__ import annotations

import traceback
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from obb_collision.node.messages.errors import RefusedError

INTERNAL_ERROR = "internal error"
"""The reason under which ``/diagnostics`` counts an item that failed."""
MAX_PLACES = 256
"""Distinct failures that are logged; further ones are counted only, so that memory is bounded."""


class Guard:
    """Counts failures by location; each distinct one is logged once, with its traceback.

    log: takes the text of an error. is_alive: whether the node's context is still there; what
    fails because it is gone is no error of the node, and ends it as it should.
    """

    def __init__(self, log: Callable[[str], None], is_alive: Callable[[], bool]) -> None:
        self._log, self._is_alive = log, is_alive
        self._logged: set[str] = set()
        self.counts: Counter[str] = Counter()
        """Failures since the start by where they happened: "input objects", "cycle"..."""
        self.last = ""
        """The latest failure in a line."""

    def caught(self, where: str, error: Exception, item: str = "") -> None:
        """Count an exception; ``item`` names the object or message that it came with."""
        if not self._is_alive():
            raise error
        self.counts[where] += 1
        what = f"{where}{f' ({item})' if item else ''}: {_line(error)}"
        self.last = what
        place = f"{where} {type(error).__name__} {_place(error)}"
        if place in self._logged or len(self._logged) >= MAX_PLACES:
            return
        self._logged.add(place)
        trace = "".join(traceback.format_exception(error))
        self._log(f"{INTERNAL_ERROR} (logged once, then only counted): {what}\n{trace}")

    def refusal(self, where: str, error: Exception, item: str = "") -> RefusedError:
        """Return why an item is refused; an unforeseen error is counted."""
        if isinstance(error, RefusedError):
            return error
        self.caught(where, error, item)
        return RefusedError(INTERNAL_ERROR, str(error))

    @contextmanager
    def catching(self, where: str, item: str = "") -> Iterator[None]:
        """Count an exception that leaves the block, and continue behind it."""
        try:
            yield
        except Exception as error:
            self.caught(where, error, item)

    @property
    def total(self) -> int:
        """All failures since the start."""
        return self.counts.total()


def _line(error: Exception) -> str:
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:200]}" if text else type(error).__name__


def _place(error: Exception) -> str:
    frames = traceback.extract_tb(error.__traceback__)
    return f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames else ""

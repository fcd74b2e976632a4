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

"""Messages that were lost on their way, by the numbers that their publishers give them.

The middleware drops the oldest messages of a full queue without a word. Each publisher numbers its
messages, but a message does not say whose it is: it is taken for the next one of the publisher that
fits best.
"""

from __future__ import annotations

from collections.abc import Callable

NO_NUMBER = 2**63
"""Numbers from here on mean that the middleware gives none."""


class Losses:
    """Counts gaps in the numbers of messages. publishers: how many there are at present."""

    def __init__(self, publishers: Callable[[], int]) -> None:
        self._publishers = publishers
        self._last: list[int] = []  # of each publisher, most recent last

    def count(self, number: int | None) -> int:
        """Return how many messages were lost before the one of a number."""
        if not number or number >= NO_NUMBER:
            return 0
        if number - 1 in self._last:
            self._last.remove(number - 1)
            self._last.append(number)
            return 0
        known = self._publishers()
        del self._last[: max(0, len(self._last) - known)]
        before = [last for last in self._last if last < number]
        lost = 0
        if before and len(self._last) >= known:
            lost = number - max(before) - 1
            self._last.remove(max(before))
        elif self._last and len(self._last) >= known:  # a publisher in place of one that ended
            self._last.pop(0)
        self._last.append(number)
        return lost

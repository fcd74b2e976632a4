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

"""The publishers of an input: who sent a message, which messages were lost, and who is gone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import count
from typing import Any

NO_NUMBER = 2**63
"""Numbers from here on mean that the middleware gives none."""
ALONE, ANY = 0, -1
"""Senders whose gid is not given: the only publisher, and one of several."""
MOST = 4096
"""Publishers of an input that are remembered, those heard last."""


class Senders:
    """The publishers of one input.

    depth: of the queue; publishers: returns how many there are; gids: returns the gids of all, as
    the graph has them; numbers: yields the number of each new publisher, unique among all inputs.
    """

    def __init__(
        self,
        depth: int,
        publishers: Callable[[], int],
        gids: Callable[[], Iterable[bytes]] = tuple,
        numbers: Iterator[int] | None = None,
    ) -> None:
        self._depth, self._publishers, self._gids = depth, publishers, gids
        self._numbers = count(1) if numbers is None else numbers
        self._known: dict[bytes, tuple[int, int]] = {}  # sender, and the number of its last message
        self._last: list[int] = []  # without gids: of each publisher, most recent last
        self._are_listed = False  # whether gids of messages are those of the graph
        self._taken = self._before = 0  # since the queue was empty; sent before those of new ones

    def emptied(self) -> None:
        """Note that no message waits: messages are lost only where a queue is full."""
        self._taken = self._before = 0

    def note_message(self, info: Mapping[str, Any]) -> tuple[int, int]:
        """Return the number of the sender of a message, and how many messages were lost before it.

        Messages that a new publisher sent before its first one may be older than the node; they
        count as lost if the queue was full.
        """
        number = info.get("publication_sequence_number") or 0
        number = 0 if number >= NO_NUMBER else number
        gid = (info.get("publisher_gid") or {}).get("data")
        if not gid:
            alone = self._publishers() <= 1
            return ALONE if alone else ANY, self._count(number) if number else 0
        sender, last = self._known.pop(gid, (0, 0))
        missing = max(0, number - last - 1)
        self._taken += 1
        self._before += 0 if sender else missing
        lost = missing if sender else 0
        if self._taken >= self._depth:
            lost, self._before = lost + self._before, 0
        if not sender:
            sender = next(self._numbers)
            self._are_listed = self._are_listed or gid in self._gids()
        self._known[gid] = sender, number
        if len(self._known) > MOST:
            del self._known[next(iter(self._known))]
        return sender, lost

    def gone(self, senders: Iterable[int]) -> set[int]:
        """Return which of the senders certainly publish no more."""
        asked = {sender for sender in senders if sender > ALONE}
        if not asked or not self._publishers():
            return asked
        present = {self._known.get(gid, (0, 0))[0] for gid in self._gids()}
        remembered = {sender for sender, _ in self._known.values()}
        return (asked & remembered) - present if self._are_listed else set()

    def _count(self, number: int) -> int:
        """Return how many messages were lost before one whose publisher is not known."""
        if number - 1 in self._last:
            self._last.remove(number - 1)
            self._last.append(number)
            return 0
        publishers = self._publishers()
        del self._last[: max(0, len(self._last) - publishers)]
        before = [last for last in self._last if last < number]
        lost = 0
        if before and len(self._last) >= publishers:
            lost = number - max(before) - 1
            self._last.remove(max(before))
        elif self._last and len(self._last) >= publishers:  # a publisher in place of one that ended
            self._last.pop(0)
        self._last.append(number)
        return lost

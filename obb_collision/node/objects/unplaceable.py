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

"""New objects that were refused: not in the scene, and therefore reported."""

from __future__ import annotations

from obb_collision.node.messages.conversions import Key
from obb_collision.node.messages.names import shortened
from obb_collision.node.messages.shape_plans import NO_BODY
from obb_collision.node.objects.table import NEVER

MAX_UNPLACEABLE = 1000
"""Maximum refused objects stored, the latest ones: bounds the memory that senders can use."""


class Unplaceable(dict[Key, str]):
    """The reasons by key; names that are too long are shortened."""

    def __init__(self) -> None:
        super().__init__()
        self._expiry: dict[Key, int] = {}
        self._of_sets: set[Key] = set()

    def add(self, key: Key, reason: str, expiry: int = NEVER, of_set: bool = False) -> None:
        """Store a refused object whose lifetime would end at ``expiry`` (ns); not annotations.

        of_set: whether it was in a complete set; then only the next set says that it is gone.
        """
        self.forget(key)
        if reason == NO_BODY:
            return
        key = shortened(key[0]), key[1]
        self[key] = reason
        if expiry != NEVER:
            self._expiry[key] = expiry
        if of_set:
            self._of_sets.add(key)
        if len(self) > MAX_UNPLACEABLE:
            self.forget(next(iter(self)))

    def forget(self, key: Key) -> None:
        """Remove one, if it is stored."""
        key = shortened(key[0]), key[1]
        self.pop(key, None)
        self._expiry.pop(key, None)
        self._of_sets.discard(key)

    def delete(self, key: Key) -> None:
        """Remove one that a marker deletes."""
        if (shortened(key[0]), key[1]) not in self._of_sets:
            self.forget(key)

    def delete_all(self, namespace: str | None) -> None:
        """Remove all that markers delete, or those of a namespace."""
        shown = None if namespace is None else shortened(namespace)
        for key in [key for key in self if shown in (None, key[0])]:
            self.delete(key)

    def expire(self, now: int) -> None:
        """Remove those whose lifetime is over."""
        for key in [key for key, expiry in self._expiry.items() if expiry <= now]:
            self.forget(key)

    def clock_jumped(self, shift: int) -> None:
        """Shift times by a jump of the clock (ns)."""
        for key in self._expiry:
            self._expiry[key] += shift

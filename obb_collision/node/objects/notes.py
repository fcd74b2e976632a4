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

"""What happened to items between two cycles that has to be counted: refused, or doubtful."""

from __future__ import annotations

from typing import NamedTuple


class Note(NamedTuple):
    """Items of a topic that are refused, or used but not trusted, for one reason; one is named."""

    topic: str
    reason: str
    is_refused: bool
    item: str
    detail: str
    total: int


class Notes:
    """Notes since they were last taken: one per topic and reason, with the latest item."""

    def __init__(self) -> None:
        self._notes: dict[tuple[str, str, bool], Note] = {}

    def refuse(self, topic: str, reason: str, item: str, detail: str, count: int = 1) -> None:
        """Note items that could not be used."""
        self._add(Note(topic, reason, True, item, detail, count))

    def doubt(self, topic: str, reason: str, item: str, detail: str, count: int = 1) -> None:
        """Note items that are used, but not trusted."""
        self._add(Note(topic, reason, False, item, detail, count))

    def _add(self, note: Note) -> None:
        before = self._notes.get(note[:3])
        total = note.total + (0 if before is None else before.total)
        self._notes[note[:3]] = note._replace(total=total)

    def take(self) -> list[Note]:
        """Return the notes, and reset them."""
        notes, self._notes = self._notes, {}
        return list(notes.values())

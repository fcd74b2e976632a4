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


"""Rows are used together; one that fails does not prevent the others."""

from __future__ import annotations

from collections.abc import Callable

from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.runtime.guard import INTERNAL_ERROR, Guard
from obb_collision.scene.building.errors import NO_MEMORY
from obb_collision.typing import Rows


def each(
    rows: Rows,
    put: Callable[[Rows], None],
    fail: Callable[[int, RefusedError], None],
    guard: Guard,
    where: str,
    name: Callable[[int], str] = str,
) -> bool:
    """Call ``put`` on all rows or, where that fails, on fewer; return whether none failed.

    fail: takes a row that failed alone, and why. where, name: for the guard, which counts what was
    not foreseen: the input, and the name of a row.
    """
    try:
        if len(rows):
            put(rows)
        return True
    except Exception as error:
        if len(rows) > 1:
            half = len(rows) // 2
            done = [
                each(some, put, fail, guard, where, name) for some in (rows[:half], rows[half:])
            ]
            return all(done)
        row = int(rows[0])
        if isinstance(error, MemoryError):
            error = RefusedError(NO_MEMORY)
        if not isinstance(error, RefusedError):
            guard.caught(where, error, name(row))
            error = RefusedError(INTERNAL_ERROR, str(error))
        fail(row, error)
        return False

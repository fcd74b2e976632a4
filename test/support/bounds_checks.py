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

"""Accesses out of bounds that kernels report, also those that something catches.

With ``NUMBA_BOUNDSCHECK=1`` a kernel raises IndexError; the node, and effects, go on after any
error of one object, so a test could pass all the same.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import CodeType
from typing import Any

MESSAGE = "index is out of bounds"
"""What numba says; lists and numpy say something else."""


@contextmanager
def none_out_of_bounds() -> Iterator[None]:
    """Fail at the end if a kernel has raised it in any thread (Python 3.12 or later)."""
    monitoring: Any = getattr(sys, "monitoring", None)
    if monitoring is None or monitoring.get_tool(monitoring.DEBUGGER_ID) is not None:
        yield
        return
    seen: set[str] = set()

    def raised(code: CodeType, offset: int, error: BaseException) -> None:
        if isinstance(error, IndexError) and str(error) == MESSAGE:
            seen.add(f"{code.co_filename}: {code.co_qualname}")

    monitoring.use_tool_id(monitoring.DEBUGGER_ID, "bounds checks")
    monitoring.register_callback(monitoring.DEBUGGER_ID, monitoring.events.RAISE, raised)
    monitoring.set_events(monitoring.DEBUGGER_ID, monitoring.events.RAISE)
    try:
        yield
    finally:
        monitoring.set_events(monitoring.DEBUGGER_ID, 0)
        monitoring.free_tool_id(monitoring.DEBUGGER_ID)
    assert not seen, f"accesses out of bounds, called from {sorted(seen)}"

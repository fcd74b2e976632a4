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

"""What this process compiles: counted, and said once it takes longer than a second.

It is said by ``logging``, which writes to stderr where nobody has set it up.
"""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import Any

from numba.core import event

from obb_collision._kernel_cache import logger, places, unsaved

#: Seconds of compiling after which it is said, and between two lines about it.
FIRST_WORD, NEXT_WORD = 1.0, 5.0


class Compiled(event.Listener):  # type: ignore[misc]  # numba has no types
    """Counts the kernels of this package that the process compiles, and the seconds it takes.

    say: what to do at each beginning and end.
    """

    def __init__(self, say: Callable[[Compiled], None]) -> None:
        self.names: list[str] = []
        self.say = say
        self._depth = 0
        self._seconds, self._start = 0.0, 0.0
        event.register("numba:compile", self)

    @property
    def seconds(self) -> float:
        """Seconds of compiling so far."""
        return self._seconds + (perf_counter() - self._start if self._depth else 0.0)

    def on_start(self, event: Any) -> None:
        """Take note of a beginning; kernels compile those that they call in between."""
        if _name(event) is not None:
            if self._depth == 0:
                self._start = perf_counter()
            self._depth += 1
            self.say(self)

    def on_end(self, event: Any) -> None:
        """Take note of an end."""
        name = _name(event)
        if name is not None:
            self.names.append(name)
            self._depth -= 1
            if self._depth == 0:
                self._seconds += perf_counter() - self._start
            self.say(self)


def _name(event: Any) -> str | None:
    """Return the name of a kernel of this package, None for others."""
    function = event.data["dispatcher"].py_func
    name = f"{function.__module__}.{function.__qualname__}"
    return name.removeprefix("obb_collision.") if name.startswith("obb_collision.") else None


class Words:
    """Logs that this process compiles, and the progress."""

    def __init__(self) -> None:
        self._due = FIRST_WORD

    def __call__(self, compiled: Compiled) -> None:
        """Log it if it is time to."""
        if compiled.seconds < self._due:
            return
        kept = f", kept in {places[0]} for the next time" if places and not unsaved else ""
        how = f" (obb_collision warm-up compiles all beforehand){kept}"
        logger.warning(
            "compiling kernels%s: %d so far, %.0f s",
            how if self._due == FIRST_WORD else "",
            *(len(compiled.names), compiled.seconds),
        )
        self._due = compiled.seconds + NEXT_WORD


compiled = Compiled(Words())
"""What this process has compiled."""

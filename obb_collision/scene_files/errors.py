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

"""What is wrong with a scene file: every problem with its file, line and key."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from obb_collision.words import MAX_PATH, printable

#: Problems reported at once; a file with more has one cause.
MAX_PROBLEMS = 20
#: Maximum characters shown of a problem's reason.
MAX_REASON = 500


class Problem(NamedTuple):
    """What is wrong, at which line (from 1; 0: the file itself) and key (empty: all of it)."""

    line: int
    key: str
    reason: str


class SceneFileError(ValueError):
    """A scene file that cannot be used: ``problems``, each named ``file:line: key: reason``.

    The message can be printed and sent whatever is in the file or its name.
    """

    def __init__(self, file: str, problems: Sequence[Problem]) -> None:
        self.file = file
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        lines = [_told(file, problem) for problem in self.problems[:MAX_PROBLEMS]]
        rest = len(self.problems) - MAX_PROBLEMS
        super().__init__("\n".join(lines + ([f"and {rest} more"] if rest > 0 else [])))


def _told(file: str, problem: Problem) -> str:
    place = file if len(file) <= MAX_PATH else f"...{file[-100:]}"
    where = f"{place}:{problem.line}" if problem.line else place
    reason = problem.reason if len(problem.reason) <= MAX_REASON else problem.reason[:MAX_REASON]
    return printable(f"{where}: {problem.key}: {reason}" if problem.key else f"{where}: {reason}")


class Problems:
    """Collects the problems of a file, so that all are reported together, and its oddities."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[Problem] = []
        self.odd: list[Problem] = []

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Collect the problem that ends the block, and continue behind it."""
        try:
            yield
        except SceneFileError as error:
            self.found += error.problems

    def doubts(self) -> tuple[str, ...]:
        """Return what is odd but can be used, one line each."""
        return tuple(_told(self.file, problem) for problem in self.odd)

    def finish(self) -> None:
        """Raise SceneFileError if there were any."""
        if self.found:
            raise SceneFileError(self.file, self.found)

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

#: Problems told at once; a file with more has one cause.
MAX_PROBLEMS = 20


class Problem(NamedTuple):
    """What is wrong, at which line (from 1) and key (empty: the whole file)."""

    line: int
    key: str
    reason: str


class SceneFileError(ValueError):
    """A scene file that can't be used: ``problems``, each named ``file:line: key: reason``."""

    def __init__(self, file: str, problems: Sequence[Problem]) -> None:
        self.file = file
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        lines = [
            f"{file}:{line}: {key}: {reason}" if key else f"{file}:{line}: {reason}"
            for line, key, reason in self.problems[:MAX_PROBLEMS]
        ]
        rest = len(self.problems) - MAX_PROBLEMS
        super().__init__("\n".join(lines + ([f"and {rest} more"] if rest > 0 else [])))


class Problems:
    """Collects what is wrong with a file, so that all of it is told at once."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[Problem] = []

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep the problem that ends what is done within, and go on behind it."""
        try:
            yield
        except SceneFileError as error:
            self.found += error.problems

    def finish(self) -> None:
        """Raise SceneFileError if there were any."""
        if self.found:
            raise SceneFileError(self.file, self.found)

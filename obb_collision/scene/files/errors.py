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

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

"""Values of a YAML file with line and key, and the problems of invalid ones.

Numbers are decimal and finite. (PyYAML reads ``1e-3`` as a word and ``010`` as eight.)
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from difflib import get_close_matches
from itertools import islice
from typing import Any, NamedTuple, NoReturn

from obb_collision.geometry.shapes.primitives import Triple
from obb_collision.geometry.validation import number_of
from obb_collision.words import MAX_NAME, MAX_PATH, printable, text_fault

#: Maximum number of reported problems; a file with more has one cause.
MAX_PROBLEMS = 20
#: Maximum printed characters of a reason.
MAX_REASON = 500


class Problem(NamedTuple):
    """A reason with its line (from 1; 0: the file itself) and key (empty for the whole file)."""

    line: int
    key: str
    reason: str


class SceneFileError(ValueError):
    """An invalid scene file: ``problems``, printed as ``file:line: key: reason``.

    The message is printable text, whatever the file or its name contains.
    """

    def __init__(self, file: str, problems: Sequence[Problem]) -> None:
        self.file = file
        self.problems = tuple(sorted(problems, key=lambda problem: problem.line))
        lines = [_line_of(file, problem) for problem in self.problems[:MAX_PROBLEMS]]
        rest = len(self.problems) - MAX_PROBLEMS
        super().__init__("\n".join(lines + ([f"and {rest} more"] if rest > 0 else [])))


def _line_of(file: str, problem: Problem) -> str:
    place = file if len(file) <= MAX_PATH else f"...{file[-100:]}"
    where = f"{place}:{problem.line}" if problem.line else place
    reason = problem.reason if len(problem.reason) <= MAX_REASON else problem.reason[:MAX_REASON]
    return printable(f"{where}: {problem.key}: {reason}" if problem.key else f"{where}: {reason}")


class Problems:
    """Collects the problems of a file, which are reported together, and its odd values."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.found: list[Problem] = []
        self.odd: list[Problem] = []

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Collect the problem that ends the block, and continue after it."""
        try:
            yield
        except SceneFileError as error:
            self.found += error.problems

    def doubts(self) -> tuple[str, ...]:
        """Return a line for each odd value, which is used all the same."""
        return tuple(_line_of(self.file, problem) for problem in self.odd)

    def read(self, fields: Mapping[str, Value], readers: Mapping[str, Reader]) -> dict[str, Any]:
        """Read fields with readers, in order; SceneFileError lists all problems."""
        read: dict[str, Any] = {}
        for key in readers:
            if key in fields:
                with self.kept():
                    read[key] = readers[key](fields[key])
        if self.found:
            raise SceneFileError(self.file, self.found)
        return read


#: Maximum characters of a number: those of the longest float in decimals.
MAX_NUMBER = 1100
NULL, SEQUENCE, MAPPING = (f"tag:yaml.org,2002:{name}" for name in ("null", "seq", "map"))
#: Tags of plain YAML; others construct objects, and are refused.
PLAIN_TAGS = frozenset(
    f"tag:yaml.org,2002:{name}"
    for name in ("bool", "float", "int", "map", "merge", "null", "seq", "str", "timestamp", "value")
)
TRUE, FALSE = ("true", "yes", "on"), ("false", "no", "off")
#: Maximum of a refused value that is printed: levels of lists, items of a list, letters.
SHOWN_LEVELS, SHOWN_ITEMS, SHOWN_LETTERS = 3, 8, 60
#: Maximum number of words that are compared with an unknown one, and of words in a message.
MAX_GUESSES, MAX_LISTED = 500, 20
#: Maximum characters of a text for people.
MAX_PROSE = 10_000
NO_KEYS: Mapping[str, Any] = {}
#: Keys of earlier versions, and what to do instead.
MOVED = {"motion": "a scene does not move; the demo reads NAME.motion.yaml beside NAME.yaml"}


class Node:
    """A value of YAML: a text, a list of nodes, or, of a mapping, a tuple of pairs of nodes.

    line: from 0; style: of texts, None for plain ones. It is smaller than PyYAML's node, as large
    files have millions, through which Python's garbage collector goes many times.
    """

    __slots__ = ("line", "style", "tag", "value")

    def __init__(self, tag: str, value: Any, line: int, style: str | None = None) -> None:
        self.tag, self.value, self.line, self.style = tag, value, line, style


@dataclass(frozen=True)
class Value:
    """A value in a file: its YAML node, its key, and the problems to add to."""

    node: Node
    key: str
    problems: Problems = field(repr=False)

    def __post_init__(self) -> None:
        if self.node.tag not in PLAIN_TAGS:
            self.refuse(f"tags are not read, got {self.node.tag[:SHOWN_LETTERS]}")

    @property
    def line(self) -> int:
        """Its line, from 1."""
        return self.node.line + 1

    def problem(self, reason: str) -> Problem:
        """Return a problem of this value."""
        return Problem(self.line, self.key, reason)

    def refuse(self, reason: str) -> NoReturn:
        """Raise SceneFileError that names this value."""
        raise SceneFileError(self.problems.file, [self.problem(reason)])

    def doubt(self, reason: str) -> None:
        """Note that this value is odd, but used."""
        self.problems.odd.append(self.problem(reason))

    def expected(self, what: str) -> NoReturn:
        """Raise SceneFileError: the value must be ``what``."""
        self.refuse(f"must be {what}, got {self.shown()}")

    def shown(self) -> str:
        """Return the value for people, shortened."""
        text = printable(_shown(self.node, SHOWN_LEVELS))
        return text if len(text) <= SHOWN_LETTERS else text[: SHOWN_LETTERS - 3] + "..."

    @property
    def is_mapping(self) -> bool:
        """Whether it is a mapping."""
        return isinstance(self.node.value, tuple)

    @property
    def is_list(self) -> bool:
        """Whether it is a list."""
        return isinstance(self.node.value, list)

    @property
    def is_empty(self) -> bool:
        """Whether it is empty or null."""
        return bool(self.node.tag == NULL)

    def items(self) -> list[Value]:
        """Return the values of a list."""
        if not self.is_list:
            self.expected("a list")
        return [
            Value(node, f"{self.key}[{k}]", self.problems) for k, node in enumerate(self.node.value)
        ]

    def entries(self) -> dict[str, Value]:
        """Return the values of a mapping by key; duplicate keys are problems."""
        if not self.is_mapping:
            self.expected("a mapping (key: value)")
        values: dict[str, Value] = {}
        for key_node, node in self.node.value:
            try:  # faster than ``kept``
                name = Value(key_node, self.key, self.problems).text("a key")
                if name == "<<":
                    self.refuse("merged mappings (<<) are not read")
                value = Value(node, f"{self.key}.{name}" if self.key else name, self.problems)
                if name in values:
                    at = Value(key_node, value.key, self.problems)
                    at.refuse(f"stands twice, first in line {values[name].line}")
                values[name] = value
            except SceneFileError as error:
                self.problems.found += error.problems
        return values

    def peek(self, name: str) -> Value | None:
        """Return the value of a key of a mapping, without checking the others; None without it."""
        for key_node, node in self.node.value if self.is_mapping else ():
            if key_node.value == name:
                return Value(node, f"{self.key}.{name}" if self.key else name, self.problems)
        return None

    @contextmanager
    def reasons(self) -> Iterator[None]:
        """Turn errors in the block, such as those of shapes, into problems of this value."""
        try:
            yield
        except SceneFileError:
            raise
        except (ValueError, OSError, MemoryError) as error:
            self.refuse(str(error) or type(error).__name__)

    def fields(self, keys: Collection[str], required: Collection[str] = ()) -> dict[str, Value]:
        """Return the values of a mapping with these keys; other keys are problems, with a guess."""
        values = self.entries()
        for name in [name for name in values if name not in keys]:
            value = values.pop(name)
            reason = MOVED.get(name) or f"unknown key{self.guess(name, keys)}"
            self.problems.found.append(value.problem(reason))
        fields = {name: value for name, value in values.items() if not value.is_empty}
        missing = [name for name in required if name not in fields]
        if missing:
            self.refuse(f"needs {', '.join(missing)}")
        return fields

    def read(
        self, required: Mapping[str, Reader], optional: Mapping[str, Reader] = NO_KEYS
    ) -> dict[str, Any]:
        """Read the values of a mapping with the reader of each key."""
        readers = {**required, **optional}
        fields = self.fields(readers, required)
        return {key: readers[key](value) for key, value in fields.items()}

    def guess(self, word: str, words: Collection[str]) -> str:
        """Suggest one of some words for an unknown one, as the end of a sentence."""
        if len(self.problems.found) >= MAX_PROBLEMS:  # no more problems are reported
            return ""
        near = list(islice(words, MAX_GUESSES))
        close = get_close_matches(word, near, 1)
        if close:
            return f"; did you mean {close[0]}?"
        more = ", ..." if len(words) > MAX_LISTED else ""
        return f"; there are {', '.join(near[:MAX_LISTED])}{more}" if near else ""

    def text(self, what: str = "a word", most: int = MAX_NAME) -> str:
        """Return a printable word, quoted or not."""
        if not isinstance(self.node.value, str) or self.is_empty or not self.node.value:
            self.expected(what)
        fault = text_fault(self.node.value, most)
        if fault is not None:
            self.refuse(fault)
        return str(self.node.value)

    def prose(self) -> str:
        """Return text for people, which may have several lines."""
        if not isinstance(self.node.value, str) or self.is_empty:
            self.expected("text")
        text = str(self.node.value)
        fault = text_fault(text.replace("\n", " ").replace("\t", " ") or " ", MAX_PROSE)
        if fault is not None:
            self.refuse(fault)
        return text

    def label(self) -> str:
        """Return a word that may be empty, or missing."""
        return "" if self.is_empty or not getattr(self.node, "value", "") else self.text()

    def choice(self, choices: Collection[str]) -> str:
        """Return a word that is one of the choices."""
        word = self.text(f"one of {', '.join(choices)}")
        if word not in choices:
            self.expected(f"one of {', '.join(choices)}")
        return word

    def flag(self) -> bool:
        """Return true or false."""
        plain = isinstance(self.node.value, str) and self.node.style is None
        word = str(self.node.value).lower() if plain else ""
        if word not in TRUE + FALSE:
            self.expected("true or false")
        return word in TRUE

    def number(self, what: str = "a number", fits: Callable[[float], bool] | None = None) -> float:
        """Return a finite number for which ``fits`` is true; what: its description in errors."""
        number = _as_number(self.node)
        if number is None or (fits is not None and not fits(number)):
            self.expected(what)
        return number

    def positive(self) -> float:
        """Return a number above zero."""
        return self.number("a positive number", lambda number: number > 0.0)

    def not_negative(self) -> float:
        """Return a number not below zero."""
        return self.number("a number, not negative", lambda number: number >= 0.0)

    def whole(self, low: int, high: int) -> int:
        """Return an integer within limits, both included."""
        number = self.number(
            f"a whole number from {low} to {high}", lambda x: x == int(x) and low <= x <= high
        )
        return int(number)

    def triple(self) -> Triple:
        """Return a list of three finite numbers."""
        return self.numbers(3)

    def sizes(self) -> Triple:
        """Return a list of three positive numbers."""
        return self.numbers(3, positive=True)

    def numbers(self, count: int, positive: bool = False) -> tuple[Any, ...]:
        """Return a list of so many finite numbers."""
        numbers = [_as_number(node) for node in self.node.value] if self.is_list else []
        good = [x for x in numbers if x is not None and (x > 0.0 or not positive)]
        if len(numbers) != count or len(good) != count:
            self.expected(f"{count} {'positive ' if positive else ''}numbers")
        return tuple(good)


#: Converts a value.
Reader = Callable[[Value], Any]


def items_of(fields: dict[str, Value], key: str) -> list[Value]:
    """Return the items of an optional list."""
    return fields[key].items() if key in fields else []


def _as_number(node: Node) -> float | None:
    plain = isinstance(node.value, str) and node.style is None and node.tag in PLAIN_TAGS
    return number_of(node.value) if plain and len(node.value) <= MAX_NUMBER else None


def _shown(node: Node, levels: int) -> str:
    if isinstance(node.value, str):
        if node.tag == NULL:
            return "nothing"
        text = str(node.value[:SHOWN_LETTERS])
        return text if node.style is None else repr(text)
    brackets = "[{}]" if isinstance(node.value, list) else "{{{}}}"
    if levels == 0:
        return brackets.format("...")
    parts = [
        _shown(item, levels - 1)
        if not isinstance(item, tuple)
        else f"{_shown(item[0], 0)}: {_shown(item[1], levels - 1)}"
        for item in node.value[:SHOWN_ITEMS]
    ]
    return brackets.format(", ".join(parts + ["..."] * (len(node.value) > SHOWN_ITEMS)))

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

"""XML of unknown origin, read within limits, and its values; errors name file, line and element.

No file is fetched and no entity expanded: a document type, which defines entities and may refer to
other files, is refused.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from obb_collision.geometry.formats.parts import HARMLESS, first_fault, shortened
from obb_collision.geometry.shapes.files import read_file
from obb_collision.geometry.validation import number_of
from obb_collision.numerics.constants import MAX_MAGNITUDE
from obb_collision.words import MAX_NAME, MAX_PATH, printable, shown, text_fault

T = TypeVar("T")
#: Maximum size of a description, bytes: a hundred times the largest of real robots.
LARGEST = 16_000_000
#: Maximum levels of elements: a collision's mesh is at the fifth, Gazebo's extensions at the tenth.
MOST_LEVELS = 60
#: Maximum number of elements: a hundred times that of the largest robots.
MOST_ELEMENTS = 400_000
#: Bytes that are parsed between two checks of the limits.
PORTION = 1 << 14
#: The XML declaration, whose encoding is wrong for a text that is decoded already.
DECLARATION = re.compile(r"\A\s*<\?xml[^>]*\?>")
#: The namespace of sources for the program xacro.
XACRO, XACRO_PREFIX = "ros.org/wiki/xacro", "xacro:"


class RobotError(ValueError):
    """A description of a robot that cannot be used: ``FILE:LINE: ELEMENT: REASON``.

    file, line (from 1; 0: the file itself), element (such as ``joint "elbow"``) and reason are
    printable text, whatever the file contains.
    """

    def __init__(self, file: str, line: int, element: str, reason: str) -> None:
        place = file if len(file) <= MAX_PATH else f"...{file[-100:]}"
        self.file, self.line = printable(place), line
        self.element, self.reason = printable(element), printable(reason)
        where = f"{self.file}:{line}" if line else self.file
        super().__init__(": ".join(part for part in (where, self.element, self.reason) if part))


class PickledNode(NamedTuple):
    """Replaces the XML node of a pickled element; it keeps the line."""

    sourceline: int


class Element:
    """An element of XML: its attributes as numbers and names, its children by tag."""

    def __init__(self, node: Any, file: str, within: str = "") -> None:
        self.node, self._file = node, file
        name = node.get("name")
        label = f"{node.tag} {shown(name)}" if name is not None else f"{node.tag}"
        self.tag = str(node.tag)
        self.label = label if name is not None or not within else f"{label} of {within}"

    def __getstate__(self) -> dict[str, Any]:
        """Pickle the line of the element, which errors name, but not its tree."""
        return {**vars(self), "node": PickledNode(self.line)}

    @property
    def line(self) -> int:
        """The line of the element in the file."""
        return int(self.node.sourceline or 0)

    def refuse(self, reason: str) -> RobotError:
        """Return the error that names this element."""
        return RobotError(self._file, self.line, self.label, reason)

    def children(self, *tags: str) -> list[Element]:
        """Return the children with one of the tags, or all, in the order of the file."""
        return [
            Element(node, self._file, self.label)
            for node in self.node
            if isinstance(node.tag, str) and (not tags or node.tag in tags)
        ]

    def child(self, tag: str) -> Element | None:
        """Return the child of a tag, None without one; RobotError for several."""
        children = self.children(tag)
        if len(children) > 1:
            raise children[1].refuse(f"it occurs {len(children)} times; once is expected")
        return children[0] if children else None

    def needed(self, tag: str) -> Element:
        """Return the child of a tag; RobotError without one."""
        child = self.child(tag)
        if child is None:
            raise self.refuse(f"<{tag}> is missing")
        return child

    def get(self, key: str) -> str | None:
        """Return an attribute, None without it."""
        value = self.node.get(key)
        return None if value is None else str(value)

    def text(self, key: str) -> str:
        """Return an attribute; RobotError without one."""
        value = self.get(key)
        if value is None:
            raise self.refuse(f"its {key} is missing")
        return value

    def word(self, key: str, most: int = MAX_NAME) -> str:
        """Return an attribute that is a name; RobotError without one."""
        value = self.text(key)
        fault = text_fault(value, most)
        if fault is not None:
            raise self.refuse(f"its {key} {fault}")
        return value

    def choice(self, key: str, table: Mapping[str, T]) -> T:
        """Look up the value of an attribute in a table; RobotError if it is not there."""
        word = self.word(key)
        if word not in table:
            raise self.refuse(f"its {key} must be one of {', '.join(table)}, got {word!r}")
        return table[word]

    def unit(self, key: str, count: int) -> tuple[Any, ...]:
        """Return the numbers of an attribute as a unit vector; RobotError for zeros."""
        numbers = self.numbers(key, count)
        length = math.hypot(*numbers)
        if not length > 0.0:
            raise self.refuse(f"its {key} is zero")
        return tuple(part / length for part in numbers)

    def numbers(
        self, key: str, count: int, default: Sequence[float] | None = None
    ) -> tuple[Any, ...]:
        """Return the finite numbers of an attribute, or the default if it is missing."""
        if default is not None and self.get(key) is None:
            return tuple(default)
        value = self.text(key)
        parts = value.split()
        if len(parts) != count:
            what = "a number" if count == 1 else f"{count} numbers"
            raise self.refuse(f"its {key} must be {what}, got {shown(value)}")
        return tuple(self._number(key, part) for part in parts)

    def number(self, key: str, default: float | None = None) -> float:
        """Return the finite number of an attribute, or the default if it is missing."""
        return float(self.numbers(key, 1, None if default is None else (default,))[0])

    def _number(self, key: str, text: str) -> float:
        number = number_of(text)
        if number is None:
            raise self.refuse(
                f"its {key} must be of finite numbers up to {MAX_MAGNITUDE:g}, got {shown(text)}"
            )
        return number


def limited(elements: list[Element], most: int, what: str) -> list[Element]:
    """Return elements; RobotError names the first one beyond the limit."""
    if len(elements) > most:
        raise elements[most].refuse(f"there are {len(elements)} {what}, {most} is the limit")
    return elements


def named(elements: list[Element], what: str) -> dict[str, Element]:
    """Return elements by their names; RobotError for two of the same name."""
    by_name: dict[str, Element] = {}
    for element in elements:
        if by_name.setdefault(element.word("name"), element) is not element:
            raise element.refuse(f"there is another {what} of this name")
    return by_name


def read_source(source: str | bytes | PathLike[str], what: str) -> tuple[bytes, str, Path | None]:
    """Return the XML of a file or text, its name in errors, and its path (None for a text).

    A string is a text if its first character after white space is ``<``.
    """
    if isinstance(source, bytes):
        return source, what, None
    if isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<"):
        text = source.lstrip("\ufeff")
        blank = DECLARATION.sub(lambda match: "\n" * match[0].count("\n"), text)
        try:
            return blank.encode(), what, None
        except UnicodeEncodeError as error:
            raise RobotError(what, 0, "", f"not text: {error.reason}") from None
    try:
        return read_file(Path(source), LARGEST)[0], str(source), Path(source)
    except (ValueError, OSError) as error:
        raise RobotError(shortened(str(source)), 0, what, str(error)) from None


def parse(data: bytes, file: str, doubts: list[str] | None = None) -> Element:
    """Return the root element; RobotError for text that is not XML or exceeds a limit.

    Harmless faults, such as an undeclared prefix, are added to ``doubts``.
    """
    from lxml import etree  # here, as what needs no robots need not load it

    if len(data) > LARGEST:
        raise RobotError(file, 0, "", f"it has {len(data)} bytes, {LARGEST} is the limit")
    parser = etree.XMLPullParser(
        events=("start", "end"),
        resolve_entities=False,
        no_network=True,
        load_dtd=False,
        dtd_validation=False,
        huge_tree=False,
        recover=True,  # faults that are not harmless are raised below
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = _parsed(parser, data, file)
    except etree.XMLSyntaxError as error:
        reason = f"not valid XML: {shortened(str(error.msg))}"
        raise RobotError(file, int(error.lineno or 0), "", reason) from None
    except UnicodeDecodeError as error:  # lxml before 6, of the name of an element
        reason = f"not valid XML: {error.reason} in UTF-8"
        raise RobotError(file, 0, "", reason) from None
    log = [*parser.feed_error_log]
    fault = first_fault(log)
    if fault is not None or root is None:
        reason, line = (fault.message, fault.line) if fault else ("there is no element", 1)
        raise RobotError(file, line, "", f"not valid XML: {shortened(reason)}")
    if doubts is not None:
        lines = {HARMLESS[entry.type_name]: entry.line for entry in reversed(log)}
        doubts += [str(RobotError(file, line, "", reason)) for reason, line in lines.items()]
    return Element(root, file)


def _parsed(parser: Any, data: bytes, file: str) -> Any:
    """Return the root node, None without one; RobotError as soon as a limit is exceeded."""
    root, count, level = None, 0, 0
    for first in range(0, len(data) + PORTION, PORTION):
        if first < len(data):
            parser.feed(data[first : first + PORTION])
        else:
            root = parser.close()
        for event, node in parser.read_events():
            level += 1 if event == "start" else -1
            count += event == "start"
            reason = _excess(node, count, level) if event == "start" else ""
            if reason:
                raise RobotError(file, int(node.sourceline or 0), "", reason)
    return root


def _excess(node: Any, count: int, level: int) -> str:
    """Return why an element is refused, "" if it is not.

    count: the number of elements up to this one; level: how deep it is nested.
    """
    if count == 1 and node.getroottree().docinfo.internalDTD is not None:
        return "a document type (<!DOCTYPE) is not read"
    if level > MOST_LEVELS:
        return f"nested too deeply, more than {MOST_LEVELS} levels"
    if count > MOST_ELEMENTS:
        return f"there are more than {MOST_ELEMENTS} elements"
    is_xacro = XACRO in str(node.tag) or str(node.tag).startswith(XACRO_PREFIX)
    return "this is a xacro file: run xacro on it first" if is_xacro else ""

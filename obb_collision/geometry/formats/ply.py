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

"""PLY, as text and binary, in either order of bytes."""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from obb_collision.geometry.formats.parts import (
    NO_CORNERS,
    NO_FACES,
    MeshError,
    Parts,
    Triangles,
    check_complete,
    floats_of,
    integers_of,
    joined_lists,
    lists_in,
    strip_faces,
    text_of,
)
from obb_collision.geometry.formats.polygons import triangulated
from obb_collision.typing import Floats

#: Names of types, old and new, by their code.
CODES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
#: The same for ``struct``.
LETTERS = dict(zip(("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8"), "bBhHiIfd", strict=True))
ORDERS = {b"binary_little_endian": "<", b"binary_big_endian": ">", b"ascii": ""}
END = re.compile(rb"^[ \t]*end_header[ \t]*(\r\n|\n|\r)", re.MULTILINE)
LARGEST_HEADER = 1 << 16
POSITION, INDICES = ("x", "y", "z"), ("vertex_indices", "vertex_index")


@dataclass
class Property:
    """A number of an element, or a list of numbers whose length is of type ``length``."""

    name: str
    code: str
    length: str | None = None


@dataclass
class Element:
    """Rows of one kind, as the header declares them."""

    name: str
    count: int
    properties: list[Property] = field(default_factory=list)


def read(data: bytes, parts: Parts) -> None:
    """Add the polygons and strips of a file. ValueError where it is cut or damaged."""
    order, elements, body = _header(data)
    rows = sum(element.count for element in elements)
    source: Any = _Bytes(body, order) if order else _Words(body, rows)
    points: Floats = np.empty((0, 3))
    lists: list[tuple[str, tuple[Triangles, Triangles]]] = []
    for element in elements:
        source.check(element)
        parts.check_room(element.count if element.name == "face" else 0)
        if element.name == "vertex":
            parts.check_room(0, element.count)
            points = source.numbers(element, POSITION)
            continue
        of_vertices = (p.name for p in element.properties if p.length and p.name in INDICES)
        name = next(of_vertices, None)
        if element.name in ("face", "tristrips"):
            if name is None and element.count:
                raise MeshError(f"its {element.name} has no list of vertices")
        elif name is not None or element.name in ("range_grid", "trips", "polygon"):
            raise MeshError(f"it has {element.name!r}, which is not read: export it as faces")
        lists.append((element.name, source.lists(element, name)))
    source.check_end()
    if not any(element.name == "vertex" for element in elements):
        raise MeshError("it declares no vertices")
    faces = [NO_FACES]
    for kind, (corners, counts) in lists:
        if kind == "face":
            faces.append(triangulated(points, corners, counts))
        elif kind == "tristrips":
            faces += _strips(corners, counts)
    parts.add(points, np.concatenate(faces))


def _strips(corners: Triangles, counts: Triangles) -> Iterator[Triangles]:
    """Yield the triangles of lists of strips; -1 begins a new strip."""
    for strips in np.split(corners, np.cumsum(counts)[:-1]):
        for strip in np.split(strips, np.flatnonzero(strips == -1)):
            yield strip_faces(strip[strip != -1] if len(strip) and strip[0] == -1 else strip)


def _header(data: bytes) -> tuple[str, list[Element], bytes]:
    """Return the order of bytes ("": text), the elements, and what follows the header."""
    if data[:3] != b"ply":
        raise MeshError("it is not a PLY file: it must begin with ply")
    end = END.search(data[:LARGEST_HEADER])
    if end is None:
        raise MeshError("its header has no end (end_header)")
    order: str | None = None
    elements: list[Element] = []
    for line in re.split(rb"[\r\n]+", data[3 : end.start()]):
        words = [word.decode("latin-1") for word in line.split()]
        match words:
            case ["format", name, "1.0"] if name.encode() in ORDERS:
                order = ORDERS[name.encode()]
            case ["element", name, count] if count.isdecimal():
                elements.append(Element(name, int(count)))
            case ["property", "list", length, kind, name] if elements and {length, kind} <= {
                *CODES
            }:
                elements[-1].properties.append(Property(name, CODES[kind], CODES[length]))
            case ["property", kind, name] if elements and kind in CODES:
                elements[-1].properties.append(Property(name, CODES[kind]))
            case ["format" | "element" | "property", *_]:
                raise MeshError(f"its header has {text_of(line)}, which PLY does not know")
            case _:
                pass  # a comment without its word
    if order is None:
        raise MeshError("its header does not say its format")
    return order, elements, data[end.end() :]


def _columns(element: Element, names: tuple[str, ...]) -> list[int]:
    present = [prop.name for prop in element.properties]
    missing = [name for name in names if name not in present]
    if missing and element.count:
        raise MeshError(f"its {element.name} has no {missing[0]}")
    return [present.index(name) for name in names if name in present]


class _Words:
    """The body of a text file, read by lines if each line is a row, else word after word."""

    def __init__(self, body: bytes, rows: int) -> None:
        lines = [line for line in body.replace(b"\r", b"\n").split(b"\n") if line.strip()]
        self._lines = lines if len(lines) == rows else []
        self._words, self._at = [] if self._lines else body.split(), 0

    def check(self, element: Element) -> None:
        """Raise ValueError if too few words are left for the rows of an element."""
        left, width = len(self._words) - self._at, len(element.properties)
        if not self._lines and width and element.count * width > left:
            check_complete(element.count, left // width, f"rows of {element.name!r}")

    def numbers(self, element: Element, names: tuple[str, ...]) -> Floats:
        """Return the properties ``names`` of an element as columns (count, k)."""
        columns, width = _columns(element, names), len(element.properties)
        if self._lines and not any(prop.length for prop in element.properties):
            lines = self._lines[self._at : self._at + element.count]
            words = b" ".join(lines).split()
            if len(words) == width * len(lines):  # nothing else follows in the lines
                self._at += len(lines)
                arrays = [floats_of(words[column::width]) for column in columns]
                return np.stack(arrays, axis=1) if arrays else np.empty((0, len(names)))
        values = [row[at][0] for row in self._rows(element) for at in columns]
        return floats_of(values).reshape(-1, len(names))

    def lists(self, element: Element, name: str | None) -> tuple[Triangles, Triangles]:
        """Return all numbers of a list property, and how many each row has."""
        column = -1 if name is None else _columns(element, (name,))[0]
        if self._lines and column == 0 and len(element.properties) == 1:
            numbers = lists_in(self._lines[self._at : self._at + element.count])
            if numbers is not None:
                self._at += element.count
                return numbers
        lists = [row[column] for row in self._rows(element)] if element.properties else []
        if column < 0:
            return NO_CORNERS, NO_CORNERS
        return joined_lists(lists)

    def _rows(self, element: Element) -> Iterator[list[list[bytes]]]:
        """Yield the words of rows, by property."""
        words, at = self._words, self._at
        line = at
        kinds = [prop.length for prop in element.properties]
        for number in range(element.count):
            if self._lines:  # words after the row are ignored
                words, at = self._lines[line + number].split(), 0
            row = []
            for kind in kinds:
                first = at
                if kind is not None:
                    first += 1
                    (count,) = integers_of(words[at : at + 1]).tolist() or (0,)
                    if count < 0:
                        raise MeshError(f"a list has {count} numbers")
                    at += count  # beyond the end if it is too long
                at += 1
                row.append(words[first:at])
            if at > len(words):
                check_complete(element.count, number, f"rows of {element.name!r}")
            yield row
        self._at = line + element.count if self._lines else at

    def check_end(self) -> None:
        """Raise ValueError if words follow the rows that the header declares."""
        if not self._lines and self._at < len(self._words):
            raise MeshError(f"it holds more than it declares: {text_of(self._words[self._at])}")


class _Bytes:
    """The body of a binary file."""

    def __init__(self, body: bytes, order: str) -> None:
        self._body, self._order, self._at = body, order, 0

    def check(self, element: Element) -> None:
        """Raise ValueError if too few bytes are left for the rows of an element."""
        size = sum(int((prop.length or prop.code)[1]) for prop in element.properties)
        left = len(self._body) - self._at
        if element.count * size > left:
            check_complete(element.count, left // size, f"rows of {element.name!r}")

    def _take(self, element: Element, lengths: list[int]) -> Any:
        """Return the rows of an element with lists of these lengths; None if lengths differ."""
        layout: list[tuple[Any, ...]] = []
        for number, (prop, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if prop.length:
                layout.append((f"n{number}", self._order + prop.length))
            layout.append((f"p{number}", self._order + prop.code, (length,)))
        kind = np.dtype(layout)
        end = self._at + element.count * kind.itemsize
        if end > len(self._body):
            return None
        rows = np.frombuffer(self._body, kind, element.count, self._at)
        for number, (prop, length) in enumerate(zip(element.properties, lengths, strict=True)):
            if prop.length and not (rows[f"n{number}"] == length).all():
                return None
        self._at = end
        return rows

    def numbers(self, element: Element, names: tuple[str, ...]) -> Floats:
        """Return the properties ``names`` of an element as columns (count, k)."""
        columns = _columns(element, names)
        if any(prop.length for prop in element.properties):
            values = [[row[column][0] for column in columns] for row in self._rows(element)]
            return np.array(values, np.float64).reshape(-1, len(names))
        rows = self._take(element, [1] * len(element.properties)) if element.count else None
        if rows is None:
            return np.empty((0, len(names)))
        return np.hstack([rows[f"p{column}"] for column in columns]).astype(np.float64)

    def lists(self, element: Element, name: str | None) -> tuple[Triangles, Triangles]:
        """Return all numbers of a list property, and how many each row has."""
        if not element.count or not element.properties:
            return NO_CORNERS, NO_CORNERS
        column = -1 if name is None else _columns(element, (name,))[0]
        start = self._at
        first = next(self._rows(element, 1), [])
        self._at = start
        rows = self._take(element, [*map(len, first)]) if first else None  # all as the first?
        if rows is not None:
            values = rows[f"p{column}"] if column >= 0 else np.empty((0, 0))
            return values.astype(np.int64).reshape(-1), np.full(len(values), values.shape[1])
        lists = [row[column] for row in self._rows(element)]
        if column < 0:
            return NO_CORNERS, NO_CORNERS
        counts = np.fromiter(map(len, lists), np.int64, len(lists))
        return np.fromiter(map(int, chain(*lists)), np.int64, int(counts.sum())), counts

    def _rows(self, element: Element, most: int | None = None) -> Iterator[list[tuple[Any, ...]]]:
        """Yield the numbers of rows, by property."""
        body, order, at = self._body, self._order, self._at
        kinds = [
            (prop.length and struct.Struct(order + LETTERS[prop.length]), LETTERS[prop.code],
             int(prop.code[1]))
            for prop in element.properties
        ]  # fmt: skip
        number = 0
        try:
            for number in range(element.count if most is None else most):  # noqa: B007
                row = []
                for length, letter, size in kinds:
                    count = 1
                    if length:
                        count = int(length.unpack_from(body, at)[0])
                        at += length.size
                    if not 0 <= count * size <= len(body) - at:
                        raise struct.error
                    row.append(struct.unpack_from(f"{order}{count}{letter}", body, at))
                    at += count * size
                yield row
        except struct.error:
            check_complete(element.count, number, f"rows of {element.name!r}")
        self._at = at

    def check_end(self) -> None:
        """Raise ValueError for bytes after the declared rows; zeros at the end are accepted."""
        rest = self._body[self._at :].strip(b"\0 \t\r\n")
        if rest:
            raise MeshError(f"it holds {len(rest)} bytes more than it declares")

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

"""What readers of mesh files share: parts within limits, numbers of tokens, and errors."""

from __future__ import annotations

import json
from collections.abc import Sequence
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.typing import Floats

Triangles = NDArray[np.int64]

#: Maximum number of characters of a path or message in an error.
SHOWN = 200
#: Maximum number of vertices per triangle of the limit: more are unused.
MOST_VERTICES = 3
#: Maximum number of nodes of a scene that are visited: one that places others counts each time.
MOST_NODES = 100_000
#: Maximum levels of nodes below one another.
MOST_LEVELS = 200
#: Why a whole file without triangles and points is refused.
NOTHING = "it has no triangles"
#: Characters of numbers and between them.
PLAIN, DIGITS = b"0123456789+-.eE,", b"0123456789 \t\n"
NO_FACES: Triangles = np.empty((0, 3), np.int64)
NO_CORNERS: Triangles = np.empty(0, np.int64)


class MeshError(ValueError):
    """A mesh file can't be read whole; the text says why, in the words of its format."""


class TooManyError(MeshError):
    """A mesh has more triangles than the limit."""


class EmptyMeshError(MeshError):
    """A mesh has no triangles and no points."""


def is_empty(error: ValueError) -> bool:
    """Return whether an error, also one of the process that builds, says that a mesh is empty."""
    return isinstance(error, EmptyMeshError) or str(error).endswith(NOTHING)


def check_nodes(visited: int, level: int) -> None:
    """Raise MeshError for too many nodes of a scene, or too many levels of them."""
    if visited > MOST_NODES or level > MOST_LEVELS:
        raise MeshError(f"it has more than {MOST_NODES} nodes or {MOST_LEVELS} levels of them")


def check_corners(corners: Triangles, vertices: int) -> None:
    """Raise MeshError unless the corners of faces are from 0 to vertices - 1."""
    if len(corners) and not (corners.min() >= 0 and corners.max() < vertices):
        bad = corners[(corners < 0) | (corners >= vertices)].flat[0]
        raise MeshError(f"a face names vertex {bad}, there are 0 to {vertices - 1}")


def shortened(text: str) -> str:
    """Return a text, its middle left out where it is too long to be shown."""
    half = SHOWN // 2
    return text if len(text) <= SHOWN else f"{text[:half]}...{text[-half:]}"


def text_of(token: bytes | str) -> str:
    """Return a token of a file in quotes, for errors."""
    text = token if isinstance(token, str) else token.decode("utf-8", "replace")
    return repr(shortened(text))


def check_complete(declared: int, held: int, what: str) -> None:
    """Raise ValueError where a file holds less, or more, than it declares."""
    if held != declared:
        cut = ": it is cut or damaged" if held < declared else ""
        raise MeshError(f"it declares {declared} {what} and holds {held}{cut}")


def floats_of(tokens: list[bytes]) -> Floats:
    """Return tokens as numbers (n,). ValueError for a token such as ``0,5``."""
    joined = b",".join(tokens)
    if not joined.translate(None, PLAIN):  # a parser of JSON takes two thirds of the time
        try:
            numbers = json.loads(b"[%b]" % joined)
            if len(numbers) == len(tokens):
                return np.fromiter(numbers, np.float64, len(tokens))
        except (ValueError, OverflowError):  # such as 1. or +1
            pass
    return np.asarray(_numbers(tokens, float, "number"))


def integers_of(tokens: list[bytes]) -> Triangles:
    """Return tokens as whole numbers (n,). ValueError for any other token."""
    numbers = integers_in(b" ".join(tokens))
    if numbers is not None and len(numbers) == len(tokens):
        return numbers
    return np.asarray(_numbers(tokens, int, "whole number"))


def integers_in(text: bytes) -> Triangles | None:
    """Return the whole numbers (n,) of a text, None where it has other characters."""
    if text.translate(None, DIGITS):
        return None
    return np.fromstring(text, np.int64, sep=" ") if text.strip() else np.empty(0, np.int64)


def lists_in(lines: list[bytes]) -> tuple[Triangles, Triangles] | None:
    """Return all numbers of lines, and the count of each line, which is its first number.

    None where counts differ, or lines hold anything else; the caller then reads line by line.
    """
    numbers = integers_in(b" ".join(lines)) if lines else None
    count = 0 if numbers is None else int(numbers[0])
    if numbers is None or len(numbers) != len(lines) * (count + 1):
        return None
    rows = numbers.reshape(-1, count + 1)
    if not (rows[:, 0] == count).all():
        return None
    return rows[:, 1:].reshape(-1), np.full(len(rows), count)


def joined_lists(lists: Sequence[Sequence[bytes]]) -> tuple[Triangles, Triangles]:
    """Return all whole numbers of lists of tokens, and how many each list has."""
    counts = np.fromiter(map(len, lists), np.int64, len(lists))
    return integers_of([*chain(*lists)]), counts


def _numbers(tokens: list[bytes], kind: Any, what: str) -> NDArray[Any]:
    try:
        numbers = map(kind, tokens)
        return np.fromiter(numbers, np.float64 if kind is float else np.int64, len(tokens))
    except (ValueError, OverflowError):
        bad = next(token for token in tokens if not _is_number(token, kind))
        raise MeshError(f"{text_of(bad)} stands where a {what} is expected") from None


def _is_number(token: bytes, kind: Any) -> bool:
    try:
        number = kind(token)
    except ValueError:
        return False
    return kind is float or abs(number) < 1 << 63


class Parts:
    """Vertices and triangles of a file, part after part. most: limit of triangles."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._vertices: list[Floats] = []
        self._faces: list[Triangles] = []
        self._triangles = self._count = 0

    def check_room(self, triangles: int = 0, vertices: int = 0) -> None:
        """Raise TooManyError if further triangles and vertices would exceed the limits."""
        if self._triangles + triangles > self._most:
            count = self._triangles + triangles
            raise TooManyError(f"it has {count} triangles, {self._most} is the limit")
        if self._count + vertices > MOST_VERTICES * self._most:
            limit = MOST_VERTICES * self._most
            raise TooManyError(f"it has {self._count + vertices} vertices, {limit} is the limit")

    def add(self, vertices: Floats, faces: Triangles, matrix: Floats | None = None) -> None:
        """Add a part: vertices (n, 3), and faces (m, 3) as indices of these vertices.

        A matrix (4, 4) moves the vertices. If it mirrors them, faces are reversed: their outer
        sides stay outside.
        """
        self.check_room(len(faces), len(vertices))
        check_corners(faces, len(vertices))
        if matrix is not None:
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            if np.linalg.det(matrix[:3, :3]) < 0.0:
                faces = faces[:, ::-1]
        self._vertices.append(np.asarray(vertices, np.float64))
        self._faces.append(np.asarray(faces, np.int64) + self._count)
        self._count += len(vertices)
        self._triangles += len(faces)

    def joined(self, unit: float = 1.0) -> tuple[Floats, Triangles]:
        """Return all vertices (n, 3), times a unit, and all faces (m, 3)."""
        vertices = np.concatenate([np.empty((0, 3)), *self._vertices])
        faces = np.concatenate([NO_FACES, *self._faces])
        return (vertices if unit == 1.0 else vertices * unit), faces


def strip_faces(corners: Triangles) -> Triangles:
    """Return the triangles (n - 2, 3) of a strip of corners (n,); every second is reversed."""
    if len(corners) < 3:
        return NO_FACES
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2, ::-1]
    return faces


def fan_faces(corners: Triangles) -> Triangles:
    """Return the triangles (n - 2, 3) of a fan of corners (n,) about the first."""
    if len(corners) < 3:
        return NO_FACES
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)


#: Faults that parsers of ROS ignore, by their names in lxml.
HARMLESS = {
    "NS_ERR_UNDEFINED_NAMESPACE": "a prefix is not declared",
    "ERR_UNKNOWN_VERSION": "its version of XML is unknown",
    "WAR_UNKNOWN_VERSION": "its version of XML is unknown",
    "ERR_RESERVED_XML_NAME": "its declaration is not at the start",
}


def first_fault(log: Any) -> Any:
    """Return the first entry of a parser's log that is not harmless, None without one."""
    return next((entry for entry in log if entry.type_name not in HARMLESS), None)

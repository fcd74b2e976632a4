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

"""What a mesh file holds: its parts, within limits, and the words for what is missing."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.typing import Floats

Triangles = NDArray[np.int64]

#: Maximum number of characters of a path or message in an error.
SHOWN = 200
#: Maximum number of vertices per triangle that there may be: more of them are unused.
MOST_VERTICES = 3
#: Maximum number of nodes of a scene that are visited: one that places others counts each time.
MOST_NODES = 100_000
#: Maximum levels of nodes below one another.
MOST_LEVELS = 200
#: Why a file is refused that is whole, but shows nothing.
NOTHING = "it has no triangles"
#: Characters of numbers, with the one between them.
PLAIN, DIGITS = b"0123456789+-.eE,", b"0123456789 \t\n"
NO_FACES: Triangles = np.empty((0, 3), np.int64)


class MeshError(ValueError):
    """A mesh file can't be read whole; says why in the words of who made it."""


class TooManyError(MeshError):
    """A mesh has more triangles than the limit."""


class EmptyMeshError(MeshError):
    """A mesh has no triangles and no points."""


def is_empty(error: ValueError) -> bool:
    """Return whether an error, also one of the process that builds, says that a mesh is empty."""
    return isinstance(error, EmptyMeshError) or str(error).endswith(NOTHING)


def check_triangles(count: int, most: int) -> None:
    """Raise TooManyError for more triangles than there may be."""
    if count > most:
        raise TooManyError(f"it has {count} triangles, {most} is the limit")


def shortened(text: str) -> str:
    """Return a text with its middle left out where it is too long to be shown."""
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


def floats_of(given: list[bytes]) -> Floats:
    """Return tokens as numbers (n,). ValueError for one that is none, such as ``0,5``."""
    joined = b",".join(given)
    if not joined.translate(None, PLAIN):  # a parser of JSON takes two thirds of the time
        try:
            numbers = json.loads(b"[%b]" % joined)
            if len(numbers) == len(given):
                return np.fromiter(numbers, np.float64, len(given))
        except (ValueError, OverflowError):  # such as 1. or +1
            pass
    return np.asarray(_numbers(given, float, "number"))


def integers_of(given: list[bytes]) -> Triangles:
    """Return tokens as whole numbers (n,). ValueError for one that is none."""
    found = integers_in(b" ".join(given))
    if found is not None and len(found) == len(given):
        return found
    return np.asarray(_numbers(given, int, "whole number"))


def integers_in(text: bytes) -> Triangles | None:
    """Return the whole numbers of a text, None where it has a character that they have not."""
    if text.translate(None, DIGITS):
        return None
    return np.fromstring(text, np.int64, sep=" ") if text.strip() else np.empty(0, np.int64)


def lists_in(lines: list[bytes]) -> tuple[Triangles, Triangles] | None:
    """Return the numbers of lines, one after another, and how many each line has.

    A line begins with how many follow. None where these are not the same in all lines, or where
    there is something else: that is for whoever reads line by line.
    """
    numbers = integers_in(b" ".join(lines)) if lines else None
    count = 0 if numbers is None else int(numbers[0])
    if numbers is None or len(numbers) != len(lines) * (count + 1):
        return None
    rows = numbers.reshape(-1, count + 1)
    if not (rows[:, 0] == count).all():
        return None
    return rows[:, 1:].reshape(-1), np.full(len(rows), count)


def _numbers(given: list[bytes], kind: Any, what: str) -> NDArray[Any]:
    try:
        return np.fromiter(map(kind, given), np.float64 if kind is float else np.int64, len(given))
    except (ValueError, OverflowError):
        bad = next(token for token in given if not _is_number(token, kind))
        raise MeshError(f"{text_of(bad)} stands where a {what} is expected") from None


def _is_number(token: bytes, kind: Any) -> bool:
    try:
        number = kind(token)
    except ValueError:
        return False
    return kind is float or abs(number) < 1 << 63


class Parts:
    """Vertices and triangles of a file, part after part. most: triangles that there may be."""

    def __init__(self, most: int) -> None:
        self._most = most
        self._vertices: list[Floats] = []
        self._faces: list[Triangles] = []
        self._triangles = self._count = 0

    def check_room(self, triangles: int = 0, vertices: int = 0) -> None:
        """Raise TooManyError where so many more would be too many."""
        check_triangles(self._triangles + triangles, self._most)
        if self._count + vertices > MOST_VERTICES * self._most:
            limit = MOST_VERTICES * self._most
            raise TooManyError(f"it has {self._count + vertices} vertices, {limit} is the limit")

    def add(self, vertices: Floats, faces: Triangles, matrix: Floats | None = None) -> None:
        """Add a part: vertices (n, 3), faces (m, 3) that name them, and (4, 4) its place.

        A place that mirrors also turns the faces round, so that they face as before.
        """
        self.check_room(len(faces), len(vertices))
        if len(faces):
            self._check(faces, len(vertices))
        if matrix is not None:
            vertices = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            if np.linalg.det(matrix[:3, :3]) < 0.0:
                faces = faces[:, ::-1]
        self._vertices.append(np.asarray(vertices, np.float64))
        self._faces.append(np.asarray(faces, np.int64) + self._count)
        self._count += len(vertices)
        self._triangles += len(faces)

    @staticmethod
    def _check(faces: Triangles, count: int) -> None:
        if faces.min() >= 0 and faces.max() < count:
            return
        bad = faces[(faces < 0) | (faces >= count)][0]
        raise MeshError(f"a face names vertex {bad}, there are 0 to {count - 1}")

    def joined(self, unit: float = 1.0) -> tuple[Floats, Triangles]:
        """Return all vertices (n, 3), times a unit, and all faces (m, 3)."""
        vertices = np.concatenate([np.empty((0, 3)), *self._vertices])
        faces = np.concatenate([NO_FACES, *self._faces])
        return (vertices if unit == 1.0 else vertices * unit), faces


def strip_faces(corners: Triangles) -> Triangles:
    """Return the triangles (n - 2, 3) of a strip of corners (n,): every other one is turned."""
    if len(corners) < 3:
        return NO_FACES
    faces = np.stack([corners[:-2], corners[1:-1], corners[2:]], axis=1)
    faces[1::2] = faces[1::2, ::-1]
    return faces


def fan_faces(corners: Triangles) -> Triangles:
    """Return the triangles (n - 2, 3) of corners (n,), all with the first one."""
    if len(corners) < 3:
        return NO_FACES
    return np.stack([np.full(len(corners) - 2, corners[0]), corners[1:-1], corners[2:]], axis=1)

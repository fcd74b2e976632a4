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

"""OFF, as text: its variants with weights, normals, colours and texture coordinates."""

from __future__ import annotations

import re
from itertools import chain

from obb_collision.geometry.formats.parts import (
    MeshError,
    Parts,
    Triangles,
    check_complete,
    floats_of,
    integers_of,
    joined_lists,
    lists_in,
    text_of,
)
from obb_collision.geometry.formats.polygons import triangulated

COMMENT = re.compile(rb"#[^\n]*")
#: Texture coordinates, colours, normals, weights, dimensions.
KEYWORD = re.compile(rb"(ST)?(C)?(N)?(4)?(n)?OFF")


def read(data: bytes, parts: Parts) -> None:
    """Add the polygons of a file. ValueError where it is cut, damaged or of another variant."""
    text = COMMENT.sub(b"", data.replace(b"\r", b"\n"))
    lines = [line for line in text.split(b"\n") if line.strip()]
    head = lines[0].split() if lines else [b""]
    keyword = KEYWORD.match(head[0])
    if keyword is None:
        raise MeshError(
            "it is not an OFF file: its first word must be OFF, COFF, NOFF, STOFF or 4OFF"
        )
    if keyword[5] or b"BINARY" in head:
        raise MeshError(f"it is {'nOFF' if keyword[5] else 'binary OFF'}: export it as plain OFF")
    lines[0] = lines[0].lstrip()[keyword.end() :]  # a number may follow at once
    lines = lines if lines[0].strip() else lines[1:]
    head = lines[0].split() if lines else []
    if len(head) < 2:
        raise MeshError("the numbers of its vertices and faces are missing")
    vertices, faces = (int(number) for number in integers_of(head[:2]))
    if min(vertices, faces) < 0:
        raise MeshError(f"it declares {vertices} vertices and {faces} faces")
    parts.check_room(faces, vertices)
    width = 4 if keyword[4] else 3
    if len(lines) - 1 >= vertices + faces:
        check_complete(vertices + faces, len(lines) - 1, "lines of vertices and faces")
        numbers = floats_of(_first(lines[1 : vertices + 1], width)).reshape(-1, width)
        corners, counts = lists_in(lines[vertices + 1 :]) or _corners(lines[vertices + 1 :])
    else:
        extra = 2 * bool(keyword[1]) + 4 * bool(keyword[2]) + 3 * bool(keyword[3])
        words = b" ".join(lines).split()[3:]
        numbers = floats_of(_first_words(words, vertices, width, extra)).reshape(-1, width)
        corners, counts = _corner_words(words[vertices * (width + extra) :], faces)
    if width == 4:
        numbers = numbers[:, :3] / numbers[:, 3:]  # infinite ones are refused later
    parts.add(numbers, triangulated(numbers, corners, counts))


def _first(lines: list[bytes], width: int) -> list[bytes]:
    """Return the first ``width`` words of lines; a normal or a colour may follow."""
    words = b" ".join(lines).split()
    if len(words) == width * len(lines):
        return words
    rows = [line.split()[:width] for line in lines]
    short = next((row for row in rows if len(row) < width), None)
    if short is not None:
        raise MeshError(f"{text_of(b' '.join(short))} stands where {width} numbers are expected")
    return [*chain(*rows)]


def _corners(lines: list[bytes]) -> tuple[Triangles, Triangles]:
    """Return the corners of faces, and how many each has, line by line; colours may follow."""
    faces = []
    for line in lines:
        words = line.split()
        count = _count(words[0])
        check_complete(count, min(count, len(words) - 1), "corners of a face")
        faces.append(words[1 : count + 1])
    return joined_lists(faces)


def _first_words(words: list[bytes], vertices: int, width: int, extra: int) -> list[bytes]:
    """Return the words of vertex positions, in a file without a line per vertex and face."""
    step = width + extra
    if len(words) < vertices * step:
        check_complete(vertices, len(words) // step, "vertices")
    starts = range(0, vertices * step, step)
    return [word for start in starts for word in words[start : start + width]]


def _corner_words(words: list[bytes], faces: int) -> tuple[Triangles, Triangles]:
    """Return the corners of faces, and how many each has, in a file without lines or colours."""
    lists: list[list[bytes]] = []
    at = 0
    while len(lists) < faces:
        end = at + 1 + _count(words[at]) if at < len(words) else len(words) + 1
        if end > len(words):
            check_complete(faces, len(lists), "faces")
        lists.append(words[at + 1 : end])
        at = end
    if at < len(words):
        raise MeshError(
            "its lines do not match its vertices and faces: write one vertex or face per line"
        )
    return joined_lists(lists)


def _count(word: bytes) -> int:
    (count,) = integers_of([word]).tolist()
    if count < 0:
        raise MeshError(f"a face has {count} corners")
    return int(count)

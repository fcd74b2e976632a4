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

"""OBJ, as text: polygons; free-form surfaces are refused."""

from __future__ import annotations

import codecs
import re

import numpy as np

from obb_collision.geometry.formats.parts import (
    MeshError,
    Parts,
    Triangles,
    floats_of,
    integers_in,
    integers_of,
    text_of,
)
from obb_collision.geometry.formats.polygons import triangulated
from obb_collision.typing import Floats

#: Byte order marks, and the encodings that they stand for.
BOMS = {codecs.BOM_UTF8: "utf-8", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
CONTINUED, COMMENT = re.compile(rb"\\[ \t]*\n"), re.compile(rb"#[^\n]*")
#: Beginnings of lines: vertices, faces, and frequent others that do not matter.
VERTEX, FACE, NORMALS = b"v ", b"f ", (b"vn ", b"vt ")
OFTEN = VERTEX, FACE
#: Texture coordinates and normal, after the vertex of a corner.
REST = re.compile(rb"/\S*")
#: First words of lines without surface: appearance, names, groups, points, lines and curves.
NO_SURFACE = frozenset(
    b"vt vn vp g o s mtllib usemtl maplib usemap bevel c_interp d_interp lod shadow_obj trace_obj "
    b"l p curv curv2 sp mg cstype deg bmat step parm trim hole scrv end con ctech stech mtl".split()
)
#: First words of surfaces that are not read.
SURFACES = frozenset(b"surf bzp bsp cdc cdp res".split())
#: First words of lines that stand for the content of another file.
ELSEWHERE = frozenset(b"call csh".split())


def read(data: bytes, parts: Parts) -> None:
    """Add the polygons of a file. MeshError for a bad file."""
    for start, encoding in BOMS.items():
        if data.startswith(start):
            data = data.decode(encoding, "replace").lstrip("\ufeff").encode()
    text = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    if b"\\" in text:
        text = CONTINUED.sub(b" ", text)
    if b"#" in text:
        text = COMMENT.sub(b"", text)
    lines = text.split(b"\n")
    others = _first_words(lines)
    if others & {b"v", b"f"}:  # of lines that are indented, or have tabs
        lines = [b" ".join(line.split()) + b" " for line in lines]
        others = _first_words(lines)
    _check(others - NO_SURFACE)
    vertices = [line for line in lines if line[:2] == VERTEX]
    faces = [line for line in lines if line[:2] == FACE]
    parts.check_room(len(faces), len(vertices))
    points = _positions(vertices)
    corners, counts = _corners(faces, lines)
    parts.add(points, triangulated(points, corners, counts))


def _first_words(lines: list[bytes]) -> set[bytes]:
    """Return the first words of lines that are not vertices, faces or normals."""
    others = [line for line in lines if line[:2] not in OFTEN and line[:3] not in NORMALS]
    return {line.split(None, 1)[0] for line in others if line.strip()}


def _check(others: set[bytes]) -> None:
    for word in sorted(others):
        if word in SURFACES:
            raise MeshError(f"it has free-form surfaces ({word.decode()}): export it as polygons")
        if word in ELSEWHERE:
            raise MeshError(f"it has {word.decode()}: other files are not read")
        raise MeshError(f"a line begins with {text_of(word)}, which OBJ does not know")


def _positions(lines: list[bytes]) -> Floats:
    """Return the first three numbers (n, 3) of vertices; a weight or a colour may follow."""
    if not lines:
        return np.empty((0, 3))
    words = b" ".join(lines).split()
    step = len(words) // len(lines)
    if len(words) == step * len(lines) and words[::step].count(b"v") == len(lines) and step > 3:
        columns = [words[column::step] for column in (1, 2, 3)]  # all as long as the first
    else:
        rows = [line.split() for line in lines]
        short = next((row for row in rows if len(row) < 4), None)
        if short is not None:
            raise MeshError(f"three numbers are expected in {text_of(b' '.join(short))}")
        columns = [[row[column] for row in rows] for column in (1, 2, 3)]
    return np.stack([floats_of(column) for column in columns], axis=1)


def _corners(faces: list[bytes], lines: list[bytes]) -> tuple[Triangles, Triangles]:
    """Return the indices of vertices, face after face, and how many each face has."""
    joined = REST.sub(b"", b" ".join(faces))
    numbers = integers_in(joined.replace(b"f", b"0"))  # no vertex is 0
    if numbers is None:
        words = joined.split()
        numbers = integers_of([b"0" if word == b"f" else word for word in words])
    starts = np.flatnonzero(numbers == 0)
    if len(starts) != len(faces):
        raise MeshError("a face names vertex 0: they are counted from 1")
    counts = np.diff(starts, append=len(numbers)) - 1
    numbers = numbers[numbers != 0]
    back = numbers < 0
    if back.any():  # counted back from the vertices that stand before the face
        kinds = [line[:2] for line in lines if line[:2] in OFTEN]
        is_face = np.array(kinds) == FACE
        before = np.cumsum(~is_face)[is_face]
        numbers = numbers + np.where(back, np.repeat(before + 1, counts), 0)
        if (numbers[back] < 1).any():
            raise MeshError("a face counts back to a vertex before the first one")
    return numbers - 1, counts

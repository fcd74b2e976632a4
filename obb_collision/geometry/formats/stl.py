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

"""STL, as text and binary."""

from __future__ import annotations

import re

import numpy as np

from obb_collision.geometry.formats.parts import (
    NO_FACES,
    MeshError,
    Parts,
    check_complete,
    floats_of,
    text_of,
)
from obb_collision.typing import Floats

#: Bytes before the first record of a binary file: text, and the number of records.
HEADER = 84
RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
#: Counts of records written by programs that do not know the count yet.
UNKNOWN = (0, 0xFFFFFFFF)
#: How far the length of a normal may be from 1.
SKEW = 0.01
SOLID = re.compile(rb"solid[^\n]*")
#: The words of a facet, None for a number.
FACET: tuple[bytes | None, ...] = (
    *(b"facet", b"normal", None, None, None, b"outer", b"loop"),
    *(b"vertex", None, None, None) * 3,
    *(b"endloop", b"endfacet"),
)


def read(data: bytes, parts: Parts) -> None:
    """Add the triangles of a file. ValueError where it is cut or damaged."""
    count = int.from_bytes(data[HEADER - 4 : HEADER], "little")
    is_binary = len(data) == HEADER + count * RECORD.itemsize
    if not is_binary and data.lstrip()[:5].lower() == b"solid":
        text = data.lower().replace(b"\r", b"\n")
        if b"facet" in text or b"endsolid" in text:
            corners = _from_text(text, parts)
            return _add(corners, parts)
    if len(data) < HEADER:
        raise MeshError("it is not an STL file: it has neither text nor a header of 84 bytes")
    _add(_from_records(data, count, parts), parts)


def _add(corners: Floats, parts: Parts) -> None:
    count = len(corners)
    faces = np.arange(3 * count).reshape(-1, 3) if count else NO_FACES
    parts.add(corners.reshape(-1, 3), faces)


def _from_text(text: bytes, parts: Parts) -> Floats:
    """Return corners (n, 3, 3); text: in lower case."""
    solids, ends, inside = _without_names(text)
    if ends < solids:
        raise MeshError(f"it begins {solids} solids and ends {ends}: it is cut or damaged")
    words = inside.split()
    count, rest = divmod(len(words), len(FACET))
    parts.check_room(count, 3 * count)
    for column, word in enumerate(FACET):
        if word is not None and words[column :: len(FACET)].count(word) != count + (column < rest):
            other = next(other for other in words[column :: len(FACET)] if other != word)
            raise MeshError(f"{text_of(other)} stands where {text_of(word)} is expected")
    if rest:
        raise MeshError("its last facet has no end: it is cut or damaged")
    columns = [column for column, word in enumerate(FACET[7:], 7) if word is None]
    numbers = [floats_of(words[column :: len(FACET)]) for column in columns]
    return np.stack(numbers, axis=1).reshape(-1, 3, 3)


def _without_names(text: bytes) -> tuple[int, int, bytes]:
    """Return how many solids begin and end, and the text without these lines."""
    solids = ends = at = 0
    pieces = []
    for match in SOLID.finditer(text):
        start = text.rfind(b"\n", 0, match.start()) + 1
        before = text[start : match.start()].strip()
        if before in (b"", b"end"):
            solids, ends = solids + (not before), ends + bool(before)
            pieces.append(text[at:start])
            at = match.end()
    return solids, ends, b"".join([*pieces, text[at:]])


def _from_records(data: bytes, count: int, parts: Parts) -> Floats:
    """Return corners (n, 3, 3) of a binary file whose header says how many there are."""
    whole, rest = divmod(len(data) - HEADER, RECORD.itemsize)
    if count > whole and count not in UNKNOWN:
        check_complete(count, whole, "triangles")
    records = np.frombuffer(data, RECORD, whole, HEADER)
    if count not in UNKNOWN and (rest or not _are_records(records[count:])):
        records = records[:count]  # other bytes follow
    elif rest:
        raise MeshError("the number of triangles is missing, and the file ends within a triangle")
    parts.check_room(len(records), 3 * len(records))
    return records["corners"].astype(np.float64)


def _are_records(records: np.ndarray) -> bool:
    """Return whether bytes are triangles: with normals of length 1 or 0."""
    corners, normals = records["corners"], records["normal"].astype(np.float64)
    length = np.sqrt(np.square(normals).sum(axis=1))
    fits = (np.abs(length - 1.0) < SKEW) | (length == 0.0)
    return bool(fits.all() and np.isfinite(corners).all() and corners.any(axis=(1, 2)).all())

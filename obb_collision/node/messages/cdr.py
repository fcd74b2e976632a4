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

"""Reading serialised messages without Python message objects.

rclpy makes 100,000 transforms in 1.8 s and 13,000 markers in one, and drops a message that is cut
short without a word. Here the bytes (plain little-endian CDR, OMG DDS-RTPS, 10.5) are read
directly. Every length and count is checked against what is left of the message before it is used,
in 64 bits, where none of them can wrap. A message that is cut short or contradicts itself is
refused whole: where one length is wrong, the rest can't be trusted either.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import MultiDOFJointState, PointCloud2
from visualization_msgs.msg import MarkerArray

from obb_collision._jit import njit
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats, Mask

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The first bytes of every message: plain, little-endian."""
ORIGIN = len(ENCAPSULATION)
"""Numbers are aligned to their size, counted from here."""
LIST, TEXT, PAIRS = -1, -2, -3
"""In place of a count: fields whose length stands before them; a text ends with a zero, and the
items of PAIRS are the two fields that follow."""
STRING = (TEXT, 1, 1)
TIME = np.dtype([("sec", "<i4"), ("nanosec", "<u4")])

Bytes = npt.NDArray[np.uint8]
Span = tuple[int, int, int]
"""A field: its count, or LIST or TEXT; bytes of each element, and their alignment."""


@njit
def aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of ``size``, a power of two."""
    return at + ((ORIGIN - at) & (size - 1))


@njit
def walk(
    data: Bytes,
    at: int,
    layout: npt.NDArray[np.int64],
    spans: npt.NDArray[np.int64],
    fixed: Bytes,
) -> tuple[int, int]:
    """Go through items of a layout; return how many are sound, and where the last of them ends.

    spans (n, fields, 3): filled with where each field begins, its length, and whether it is a text
    that is the same in the item before; fixed (n, bytes): with the fields of fixed size, but for
    single elements of several bytes, which are skipped.
    """
    for n in range(len(spans)):
        place, column, k, pairs, first = at, 0, 0, 0, 0
        while k < len(layout):
            count, size = layout[k, 0], layout[k, 1]
            kind = count
            if kind < 0:
                place = aligned(place, 4)
                if place + 4 > len(data):
                    return n, at
                count = 0
                for byte in range(4):
                    count |= np.int64(data[place + byte]) << (8 * byte)
                place += 4
            if count:
                place = aligned(place, layout[k, 2])
            if place > len(data) or count > (len(data) - place) // size:
                return n, at
            end = place + count * size
            if kind == PAIRS:
                end, pairs, first = place, count, k + 1
                k += 0 if count else 2
            elif kind >= 0 and size == 1:
                for byte in range(place, end):
                    fixed[n, column] = data[byte]
                    column += 1
            elif kind == TEXT and count:  # none is not by the standard, but some write it
                if data[end - 1] != 0:
                    return n, at
                count -= 1
            spans[n, k, 0], spans[n, k, 1], spans[n, k, 2] = place, count, 0
            if kind == TEXT and n > 0 and spans[n - 1, k, 1] == count:
                same, last = True, spans[n - 1, k, 0]
                for byte in range(count):
                    same &= data[place + byte] == data[last + byte]
                spans[n, k, 2] = same
            place = end
            k += 1
            if pairs and k == first + 2:
                pairs -= 1
                k = first if pairs else k
        at = place
    return len(spans), at


MALFORMED = "malformed message"
"""Reason: the bytes are no message of the topic's type."""
TOO_MANY_POINTS = "too many points"
"""Reason: a message or a marker has more of them than the limit."""
NO_LIMIT = sys.maxsize
LONGEST_TAIL = 7
"""Bytes that may follow the last field: payloads are padded, typically to four bytes."""
MAX_FIELDS = 1000
"""Maximum number of fields of a cloud."""
LONGEST_KNOWN = 4096
"""Maximum bytes of a list of fields that is remembered."""
WHOLE, STAMP, SIZE = Struct("<I"), Struct("<iI"), Struct("<II")
LAYOUT, FLAG = Struct("<BxxxII"), Struct("<B")


class Stamp(NamedTuple):
    """A builtin_interfaces/Time."""

    sec: int
    nanosec: int


class Header(NamedTuple):
    """A std_msgs/Header."""

    stamp: Stamp
    frame_id: str


class NamedPose(NamedTuple):
    """A geometry_msgs/TransformStamped; pose: (1, 7)."""

    header: Header
    name: str
    pose: Floats


class NamedStates(NamedTuple):
    """A sensor_msgs/MultiDOFJointState; poses: (n, 7), twists: (m, 6)."""

    header: Header
    names: list[str]
    poses: Floats
    twists: Floats


@dataclass(frozen=True, slots=True)
class Field:
    """A sensor_msgs/PointField."""

    name: str
    offset: int
    datatype: int
    count: int


class CloudMessage(NamedTuple):
    """A sensor_msgs/PointCloud2, with the names of its attributes."""

    header: Header
    height: int
    width: int
    fields: list[Field]
    is_bigendian: bool
    point_step: int
    row_step: int
    data: memoryview


def pose_from_bytes(data: bytes) -> NamedPose:
    """Return the pose in a serialised TransformStamped; RefusedError ("malformed message")."""
    reader = Reader(data, TransformStamped)
    header, name = reader.header(), reader.text()
    pose = reader.doubles(1, 7)
    reader.end()
    return NamedPose(header, name, pose)


def states_from_bytes(data: bytes) -> NamedStates:
    """Return the states in a serialised MultiDOFJointState; RefusedError ("malformed message")."""
    reader = Reader(data, MultiDOFJointState)
    header = reader.header()
    names = reader.texts()
    poses, twists = reader.doubles(reader.count(), 7), reader.doubles(reader.count(), 6)
    reader.doubles(reader.count(), 6)  # wrench
    reader.end()
    return NamedStates(header, names, poses, twists)


def cloud_from_bytes(data: bytes) -> CloudMessage:
    """Return the cloud in a PointCloud2; RefusedError ("malformed message", "field layout")."""
    reader = Reader(data, PointCloud2)
    header = reader.header()
    height, width = reader.numbers(SIZE)
    fields = next((fields for content, fields in _known_fields if reader.skip(content)), None)
    if fields is None:
        start, items = reader.at, reader.items(FIELD)
        if len(items) > MAX_FIELDS:
            raise RefusedError("field layout", f"{len(items)} fields, {MAX_FIELDS} is the limit")
        named = zip(items.texts("name"), items.numbers["numbers"].tolist(), strict=True)
        fields = [Field(name, *numbers) for name, numbers in named]
        if reader.at - start <= LONGEST_KNOWN:
            _known_fields.append((items.data[start : reader.at], fields))
    order, point_step, row_step = reader.numbers(LAYOUT)
    content = reader.content()
    (dense,) = reader.numbers(FLAG, 1)
    if max(order, dense) > 1:
        raise RefusedError(MALFORMED, f"is_bigendian is {order}, is_dense {dense}")
    reader.end()
    return CloudMessage(header, height, width, fields, bool(order), point_step, row_step, content)


_known_fields: deque[tuple[bytes, list[Field]]] = deque(maxlen=8)
"""Fields of the last clouds, and how they are written: a sender's are the same in all messages."""


def as_plain(data: bytes, kind: type) -> bytes:
    """Return a message of another encoding in plain little-endian CDR, by way of rclpy."""
    if data[:2] == ENCAPSULATION[:2]:
        return data
    try:
        message: Any = deserialize_message(data, kind)
        result: bytes = serialize_message(message)
    except Exception as error:
        raise RefusedError(MALFORMED, f"encoding {data[:2].hex()!r}: {error}") from error
    if result[:2] != ENCAPSULATION[:2]:
        raise RefusedError(MALFORMED, "no little-endian encoding here")
    return result


class Layout:
    """The fields of an item of a list, in order: numbers side by side, texts and lists."""

    def __init__(self, **fields: np.dtype[Any] | Span) -> None:
        fixed = {name: kind for name, kind in fields.items() if isinstance(kind, np.dtype)}
        self.dtype = np.dtype(list(fixed.items()))
        """The fields of fixed size, side by side."""
        self.columns = {name: column for column, name in enumerate(fields)}
        spans = [
            kind if isinstance(kind, tuple) else (kind.itemsize, 1, kind[0].base.itemsize)
            for kind in fields.values()
        ]
        self.spans = np.array(spans, np.int64)
        counts = [count for count, _, _ in spans]
        lengths = sum(count < 0 for count in counts) - 2 * counts.count(PAIRS)
        self.smallest = self.dtype.itemsize + 4 * lengths
        """Bytes of an item, at least."""


@dataclass(frozen=True, eq=False)
class Items:
    """Items of a list: the bytes of their message, and what ``walk`` fills in."""

    layout: Layout
    data: bytes
    spans: npt.NDArray[np.int64]
    fixed: Bytes

    def __len__(self) -> int:
        return len(self.spans)

    @property
    def numbers(self) -> npt.NDArray[Any]:
        """Return the fields of fixed size (n,), by name."""
        return self.fixed.view(self.layout.dtype)[:, 0]

    def of(self, name: str) -> npt.NDArray[np.int64]:
        """Return (n, 3) where a field begins, its length, whether it repeats the item before."""
        return self.spans[:, self.layout.columns[name]]

    def text(self, name: str, row: int) -> bytes:
        """Return the raw bytes of a text, or of a list of bytes."""
        at, size, _ = self.of(name)[row].tolist()
        return self.data[at : at + size]

    def texts(self, name: str, rows: slice | Mask = slice(None)) -> list[str]:
        """Return a text of all items or some; bytes that are not UTF-8 are replaced."""
        data, spans = self.data, self.of(name)[rows].tolist()
        return [str(data[at : at + size], "utf-8", "replace") for at, size, _ in spans]

    def points(self, name: str, row: int) -> Floats:
        """Return a list of points (k, 3), as a view of the message."""
        at, count, _ = self.of(name)[row].tolist()
        return np.frombuffer(self.data, "<f8", 3 * count, at if count else 0).reshape(-1, 3)


NAMES = Layout(text=STRING)
NUMBERS = np.dtype([("offset", "<u4"), ("datatype", "u1"), ("count", "<u4")], align=True)
FIELD = Layout(name=STRING, numbers=NUMBERS)
"""Of a sensor_msgs/PointField."""
MARKER = Layout(
    stamp=TIME,
    frame=STRING,
    ns=STRING,
    head=np.dtype([("id", "<i4"), ("type", "<i4"), ("action", "<i4")]),
    body=np.dtype(
        [
            *(("pose", "<f8", (7,)), ("scale", "<f8", (3,)), ("color", "<f4", (4,))),
            *(("lifetime", TIME), ("locked", "u1")),
        ]
    ),
    points=(LIST, 24, 8),
    colors=(LIST, 16, 4),
    texture_resource=STRING,
    texture_stamp=TIME,
    texture_frame=STRING,
    texture_format=STRING,
    texture=(LIST, 1, 1),
    uv_coordinates=(LIST, 8, 4),
    text=STRING,
    mesh=STRING,
    file=STRING,
    content=(LIST, 1, 1),
    materials=np.dtype([("embedded", "u1")]),
)
"""Of a visualization_msgs/Marker."""


def markers_from_bytes(data: bytes) -> Items:
    """Return the markers of a serialised MarkerArray; RefusedError ("malformed message")."""
    reader = Reader(data, MarkerArray)
    markers = reader.items(MARKER)
    reader.end()
    flags = markers.numbers["body"]["locked"], markers.numbers["materials"]["embedded"]
    if np.max(flags, initial=0) > 1:
        raise RefusedError(MALFORMED, "invalid boolean: neither 0 nor 1")
    return markers


class Reader:
    """Reads a serialised message field by field, each only after a look at what is left.

    kind: the type of the message.
    """

    def __init__(self, data: bytes, kind: type) -> None:
        self._data = as_plain(data, kind)
        self.at = ORIGIN
        """The byte to be read next."""

    def numbers(self, layout: Struct, alignment: int = 4) -> tuple[Any, ...]:
        """Return numbers side by side."""
        start = self._reserve(layout.size, alignment)
        return layout.unpack_from(self._data, start)

    def skip(self, content: bytes) -> bool:
        """Go on behind bytes, and return whether they are next."""
        is_next = self._data.startswith(content, self.at)
        self.at += len(content) if is_next else 0
        return is_next

    def count(self, item: int = 1) -> int:
        """Return the length of a list whose items have at least ``item`` bytes each."""
        (number,) = self.numbers(WHOLE)
        if number * item > len(self._data) - self.at:
            raise self._malformed(f"a list of {number} items")
        return int(number)

    def header(self) -> Header:
        """Return a header."""
        return Header(Stamp(*self.numbers(STAMP)), self.text())

    def text(self) -> str:
        """Return a text; bytes that are not UTF-8 are replaced."""
        size = self.count()
        start = self._reserve(size)
        if size and self._data[start + size - 1]:
            raise self._malformed("a text without an end")
        return str(self._data[start : start + max(0, size - 1)], "utf-8", "replace")

    def texts(self) -> list[str]:
        """Return a list of texts; bytes that are not UTF-8 are replaced."""
        return self.items(NAMES).texts("text")

    def items(self, layout: Layout, most: int = NO_LIMIT) -> Items:
        """Return a list of items; RefusedError ("too many points") for more than ``most``."""
        count = self.count(layout.smallest)
        if count > most:
            raise RefusedError(TOO_MANY_POINTS, f"{count} items, {most} is the limit")
        spans = np.zeros((count, len(layout.spans), 3), np.int64)
        fixed = np.empty((count, layout.dtype.itemsize), np.uint8)
        content: Bytes = np.frombuffer(self._data, np.uint8)
        sound, self.at = walk(content, self.at, layout.spans, spans, fixed)
        if sound < count:
            raise self._malformed(f"item {sound} of a list of {count}")
        return Items(layout, self._data, spans, fixed)

    def doubles(self, count: int, columns: int) -> Floats:
        """Return numbers (count, columns)."""
        if count == 0:
            return np.empty((0, columns))
        start = self._reserve(8 * count * columns, 8)
        numbers = np.frombuffer(self._data, "<f8", count * columns, start)
        return numbers.reshape(count, columns).astype(np.float64)  # a copy: aligned and writable

    def singles(self, count: int) -> npt.NDArray[np.float32]:
        """Return numbers (count,) of four bytes each, as a view of the message."""
        start = self._reserve(4 * count, 4) if count else 0
        return np.frombuffer(self._data, "<f4", count, start)

    def content(self) -> memoryview:
        """Return a list of bytes, as a view of the message."""
        size = self.count()
        start = self._reserve(size)
        return memoryview(self._data)[start : start + size]

    def end(self) -> None:
        """Refuse a message that goes on."""
        rest = len(self._data) - self.at
        if rest > LONGEST_TAIL:
            raise RefusedError(MALFORMED, f"{rest} bytes behind the last field")

    def _reserve(self, size: int, alignment: int = 1) -> int:
        """Return where the next bytes begin, and go on behind them."""
        start = self.at + ((ORIGIN - self.at) & (alignment - 1))
        if start + size > len(self._data):
            raise self._malformed(f"{size} more bytes")
        self.at = start + size
        return start

    def _malformed(self, what: str) -> RefusedError:
        return RefusedError(
            MALFORMED, f"{what} at byte {self.at} of {len(self._data)}: it is cut short"
        )


def padded(text: str) -> bytes:
    """Return the bytes of a text in a message, padded to a multiple of 4 for the next text."""
    data = written_text(text)
    return data + bytes(-len(data) % 4)


def written_text(text: str) -> bytes:
    """Return the bytes of a text in a message."""
    data = text.encode() + b"\x00"
    return WHOLE.pack(len(data)) + data


def namespace_bytes(names: Mapping[int, str]) -> bytes:
    """Return the serialised table of namespaces by number, as ``namespaces_to_ros`` makes it.

    A table of 20,000 takes rclpy 0.2 s, and this a tenth of it.
    """
    head = b"\x00" + bytes(3)  # level OK
    texts = ["namespaces", f"{len(names)} namespaces", ""]
    parts = [ENCAPSULATION, head, *map(padded, texts), WHOLE.pack(len(names))]
    for number, name in names.items():
        parts += padded(str(number)), padded(name)
    return b"".join(parts)

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

"""Reading serialised messages without Python message objects: poses, states and clouds.

rclpy makes 100,000 transforms in 1.8 s, and drops a message that is cut short without a word. Here
the bytes (plain little-endian CDR, OMG DDS-RTPS, 10.5) are read directly. Every length and count is
checked against what is left of the message before it is used, in 64 bits, where none of them can
wrap; a message that is cut short or contradicts itself is refused whole. ``marker_scan`` does the
same for markers.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt
from geometry_msgs.msg import TransformStamped
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import MultiDOFJointState, PointCloud2

from obb_collision._jit import njit
from obb_collision.node.messages.errors import RefusedError
from obb_collision.typing import Floats

ENCAPSULATION = b"\x00\x01\x00\x00"
"""The first bytes of every message: plain, little-endian."""
ORIGIN = len(ENCAPSULATION)
"""Numbers are aligned to their size, counted from here."""
HALF = 1 << 31
"""Of the numbers that four bytes can be."""

Bytes = npt.NDArray[np.uint8]


@njit
def whole(data: Bytes, at: int) -> int:
    """Return the unsigned number of four bytes."""
    low = np.int64(data[at]) | (np.int64(data[at + 1]) << 8)
    high = np.int64(data[at + 2]) | (np.int64(data[at + 3]) << 8)
    return int(low | (high << 16))


@njit
def signed(data: Bytes, at: int) -> int:
    """Return the number of four bytes."""
    number = whole(data, at)
    return number - 2 * HALF if number >= HALF else number


@njit
def aligned(at: int, size: int) -> int:
    """Return the next place that is a multiple of ``size``, a power of two."""
    return at + ((ORIGIN - at) & (size - 1))


@njit
def text(data: Bytes, at: int) -> tuple[int, int, int]:
    """Return where a text begins, its length, and where it ends: -1 if it is none."""
    at = aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    size = whole(data, at)
    at += 4
    if size == 0:  # not by the standard, but some write it
        return at, 0, at
    if size > len(data) - at or data[at + size - 1] != 0:
        return 0, 0, -1
    return at, size - 1, at + size


@njit
def items(data: Bytes, at: int, item: int, alignment: int) -> tuple[int, int, int]:
    """Return where a list of items of some bytes begins, its length, and where it ends, or -1."""
    at = aligned(at, 4)
    if at + 4 > len(data):
        return 0, 0, -1
    count = whole(data, at)
    at += 4
    if count == 0:
        return at, 0, at
    at = aligned(at, alignment)
    if at > len(data) or count > (len(data) - at) // item:
        return 0, 0, -1
    return at, count, at + count * item


@njit
def equal(data: Bytes, a: int, b: int, size: int) -> bool:
    """Return whether the bytes from two places on are the same."""
    same = True
    for k in range(size):
        same &= data[a + k] == data[b + k]
    return same


@njit
def doubles(data: Bytes, at: int, bits: npt.NDArray[np.uint64]) -> None:
    """Copy the bits of numbers of eight bytes; the caller sees to it that they are there."""
    for k in range(len(bits)):
        value = np.uint64(0)
        for byte in range(8):
            value |= np.uint64(data[at + 8 * k + byte]) << np.uint64(8 * byte)
        bits[k] = value


@njit
def texts(data: Bytes, at: int, spans: npt.NDArray[np.int64]) -> tuple[int, int]:
    """Write where each text of a list begins and ends; return how many are sound, and their end."""
    for n in range(len(spans)):
        start, size, end = text(data, at)
        if end < 0:
            return n, at
        spans[n, 0], spans[n, 1] = start, start + size
        at = end
    return len(spans), at


T = TypeVar("T")
MALFORMED = "malformed message"
"""Reason: the bytes are no message of the topic's type."""
LONGEST_TAIL = 7
"""Bytes that may follow the last field: payloads are padded, typically to four bytes."""
MAX_FIELDS = 1000
"""Maximum number of fields of a cloud."""
SMALLEST_FIELD = 16
"""Bytes of a field of a cloud, at least."""
KNOWN, LONGEST_KNOWN = 8, 4096
"""Lists of fields that are remembered, and their maximum bytes."""
WHOLE, STAMP, SIZE, FIELD = Struct("<I"), Struct("<iI"), Struct("<II"), Struct("<IBxxxI")
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
    data: bytearray


def pose_from_bytes(data: bytes) -> NamedPose:
    """Return a serialised TransformStamped; RefusedError ("malformed message")."""
    reader = Reader(data, TransformStamped)
    header, name = reader.header(), reader.text()
    pose = reader.doubles(1, 7)
    reader.end()
    return NamedPose(header, name, pose)


def states_from_bytes(data: bytes) -> NamedStates:
    """Return a serialised MultiDOFJointState; RefusedError ("malformed message")."""
    reader = Reader(data, MultiDOFJointState)
    header = reader.header()
    names = reader.texts()
    poses, twists = reader.doubles(reader.count(), 7), reader.doubles(reader.count(), 6)
    reader.doubles(reader.count(), 6)  # wrench
    reader.end()
    return NamedStates(header, names, poses, twists)


def cloud_from_bytes(data: bytes) -> CloudMessage:
    """Return a serialised PointCloud2; RefusedError ("malformed message", "field layout")."""
    reader = Reader(data, PointCloud2)
    header = reader.header()
    height, width = reader.numbers(SIZE)
    fields = reader.known(_known_fields)
    if fields is None:
        start = reader.place
        fields = [Field(reader.text(), *reader.numbers(FIELD)) for _ in _number_of_fields(reader)]
        written = reader.since(start)
        if len(written) <= LONGEST_KNOWN:
            _known_fields.append((written, fields))
    order, point_step, row_step = reader.numbers(LAYOUT)
    content = reader.content()
    (dense,) = reader.numbers(FLAG, 1)
    if max(order, dense) > 1:
        raise RefusedError(MALFORMED, f"is_bigendian is {order}, is_dense {dense}")
    reader.end()
    return CloudMessage(header, height, width, fields, bool(order), point_step, row_step, content)


_known_fields: deque[tuple[bytes, list[Field]]] = deque(maxlen=KNOWN)
"""Fields of the last clouds, and how they are written: a sender's are the same in all messages."""


def _number_of_fields(reader: Reader) -> range:
    number = reader.count(SMALLEST_FIELD)
    if number > MAX_FIELDS:
        raise RefusedError("field layout", f"{number} fields, {MAX_FIELDS} is the limit")
    return range(number)


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


class Reader:
    """Reads a serialised message field by field, each only after a look at what is left.

    kind: the type of the message.
    """

    def __init__(self, data: bytes, kind: type) -> None:
        self._data = as_plain(data, kind)
        self._at = ORIGIN

    def numbers(self, layout: Struct, alignment: int = 4) -> tuple[Any, ...]:
        """Return numbers side by side."""
        start = self._reserve(layout.size, alignment)
        return layout.unpack_from(self._data, start)

    @property
    def place(self) -> int:
        """The byte to be read next."""
        return self._at

    def since(self, start: int) -> bytes:
        """Return the bytes read since a place."""
        return bytes(self._data[start : self._at])

    def known(self, several: Iterable[tuple[bytes, T]]) -> T | None:
        """Go on behind what is written here if it is known; return what it is."""
        for written, meaning in several:
            if self._data.startswith(written, self._at):
                self._at += len(written)
                return meaning
        return None

    def count(self, item: int = 1) -> int:
        """Return the length of a list whose items have at least so many bytes."""
        (number,) = self.numbers(WHOLE)
        if number * item > len(self._data) - self._at:
            raise self._malformed(f"a list of {number} items")
        return int(number)

    def header(self) -> Header:
        """Return a header."""
        return Header(Stamp(*self.numbers(STAMP)), self.text())

    def text(self) -> str:
        """Return a text; what is no UTF-8 in it is replaced."""
        size = self.count()
        start = self._reserve(size)
        if size and self._data[start + size - 1]:
            raise self._malformed("a text without an end")
        return str(self._data[start : start + max(0, size - 1)], "utf-8", "replace")

    def texts(self) -> list[str]:
        """Return a list of texts."""
        spans = np.empty((self.count(4), 2), np.int64)
        self.walk(texts, spans)
        return self.texts_at(spans)

    def walk(self, kernel: Callable[..., tuple[int, int]], *rows: npt.NDArray[Any]) -> None:
        """Read a list by a kernel that fills arrays, which have a row for each item.

        It is given all bytes and where the list begins, and returns how many items are sound, and
        where the last one ends.
        """
        content: Bytes = np.frombuffer(self._data, np.uint8)
        sound, self._at = kernel(content, self._at, *rows)
        if sound < len(rows[0]):
            raise self._malformed(f"item {sound} of a list of {len(rows[0])}")

    def texts_at(self, spans: npt.NDArray[np.int64]) -> list[str]:
        """Return the texts that begin and end at some places (n, 2)."""
        data = self._data
        return [str(data[at:end], "utf-8", "replace") for at, end in spans.tolist()]

    def doubles(self, count: int, columns: int) -> Floats:
        """Return numbers (count, columns)."""
        if count == 0:
            return np.empty((0, columns))
        start = self._reserve(8 * count * columns, 8)
        found = np.frombuffer(self._data, "<f8", count * columns, start)
        return found.reshape(count, columns).astype(np.float64)  # a copy: aligned and writable

    def content(self) -> bytearray:
        """Return a list of bytes."""
        size = self.count()
        start = self._reserve(size)
        return bytearray(memoryview(self._data)[start : start + size])

    def end(self) -> None:
        """Refuse a message that goes on."""
        rest = len(self._data) - self._at
        if rest > LONGEST_TAIL:
            raise RefusedError(MALFORMED, f"{rest} bytes behind the last field")

    def _reserve(self, size: int, alignment: int = 1) -> int:
        """Return where the next bytes begin, and go on behind them."""
        start = self._at + ((ORIGIN - self._at) & (alignment - 1))
        if start + size > len(self._data):
            raise self._malformed(f"{size} more bytes")
        self._at = start + size
        return start

    def _malformed(self, what: str) -> RefusedError:
        return RefusedError(
            MALFORMED, f"{what} at byte {self._at} of {len(self._data)}: it is cut short"
        )


def padded(text: str) -> bytes:
    """Return a text as it stands where it begins, and the next one does, at a multiple of 4."""
    data = written_text(text)
    return data + bytes(-len(data) % 4)


def written_text(text: str) -> bytes:
    """Return a text as it stands in a message."""
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

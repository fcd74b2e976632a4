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

"""Names from outside: how long they may be, and the tables of those that are in use.

What is stored of names is bounded in number and bytes, so that no sender can exhaust memory. A
name that is no longer used makes room for the next one, so a full table recovers.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Callable, Iterable

from obb_collision.node.messages.errors import RefusedError
from obb_collision.words import printable, text_fault

MAX_NAME_BYTES = 255
"""Longest namespace or frame in bytes of UTF-8: as much as the name of a ROS topic may have."""
MAX_NAMESPACES = 20_000
"""Namespaces in use at a time: as many as objects may be by default."""
MAX_NAMESPACE_BYTES = 1 << 20
"""Of the names of all namespaces, in UTF-8: the latched table is sent whole when it changes."""
MAX_FRAMES = 1000
"""Frames in use at a time."""
SHOWN_CHARACTERS = 20
"""Characters shown of a name that is too long to be stored, before its checksum."""
_SIGN = 1 << 31
WHOLE = re.compile("0|-?[1-9][0-9]{0,9}")
"""Numbers of namespaces and ids as texts: an int32 has 10 digits at most."""


def namespace_number(name: str) -> int:
    """Return the number of a namespace in the clouds: the CRC-32 of its UTF-8 name as int32.

    The same in every node and every run. ValueError for a name that has no UTF-8.
    """
    number = zlib.crc32(name.encode())
    return number - 2 * _SIGN if number >= _SIGN else number


def stand_in(number: int) -> str:
    """Return the name of a namespace of which only the number has been received."""
    return f"#{number}"


def whole_from_text(text: str) -> int | None:
    """Return the whole number that a text is, None for any other text, such as 01."""
    return int(text) if WHOLE.fullmatch(text) else None


def check_name(name: str, what: str, most: int = MAX_NAME_BYTES) -> None:
    """Raise RefusedError ("bad name") for an invalid name; ``what``: the kind of name.

    most: bytes of UTF-8.
    """
    fault = text_fault(name, most) if name else None
    if fault is None and len(name.encode()) > most:
        fault = f"must have at most {most} bytes of UTF-8"
    if fault is not None:
        raise RefusedError("bad name", f"{what} {fault}")


def shortened(name: str) -> str:
    """Return a name of limited length: itself, or its beginning and its checksum."""
    data = name.encode(errors="backslashreplace")
    if len(data) <= MAX_NAME_BYTES:
        name = printable(name)
        return name if len(name.encode()) <= MAX_NAME_BYTES else f"{zlib.crc32(data):08x}"
    return f"{printable(name[:SHOWN_CHARACTERS])}...{zlib.crc32(data):08x}"


class NamespaceTable:
    """The namespaces by number, and how many objects are in each."""

    def __init__(self) -> None:
        self.max_bytes = MAX_NAME_BYTES
        """Of a name, in UTF-8."""
        self.names: dict[int, str] = {}
        self.version = 0
        """Changes with ``names``."""
        self._numbers: dict[str, int] = {}  # by name
        self._used: dict[int, int] = {}
        self._unused: dict[int, None] = {}  # the one longest unused first
        self._bytes = 0
        self.named: Callable[[int], None] = lambda number: None
        """Called when the name of a number is received whose objects had a stand-in."""

    def __len__(self) -> int:
        return len(self.names)

    def find(self, name: str) -> int | None:
        """Return the number of a namespace in the table, None if it is not there.

        A namespace with a stand-in name is found by both names.
        """
        listed = self._numbers.get(name)
        if listed is not None:
            return listed
        try:
            number = namespace_number(name)
        except UnicodeEncodeError:
            return None
        return number if self.names.get(number) == stand_in(number) else None

    def admit(self, name: str) -> int:
        """Return the number of a namespace; a new one takes its place in the table.

        Objects of which only that number was known so far have the name from then on. Raises
        RefusedError ("bad name", "namespace number taken", "too many namespaces").
        """
        check_name(name, "namespace", self.max_bytes)
        number = namespace_number(name)
        present = self.names.get(number)
        if present == name:
            return number
        if number in self._used and present != stand_in(number):
            detail = f"{name!r} and {present!r} have the same CRC-32: rename one"
            raise RefusedError("namespace number taken", detail)
        self._refuse_twin(name)
        used = self._used.pop(number, 0)
        if present is not None:
            self._unused[number] = None
            self._forget(number)
        try:
            self._take_place(number, name)
        except RefusedError:
            if used and present is not None:
                self._take_place(number, present)
                self.use(number, used)
            raise
        if used:
            self.use(number, used)
            self.named(number)
        return number

    def admit_number(self, number: int) -> int:
        """Admit a namespace of which only the number is known: a stand-in is its name till then.

        Raises RefusedError ("namespace number taken", "too many namespaces").
        """
        if number not in self.names:
            name = stand_in(number)
            self._refuse_twin(name)
            self._take_place(number, name)
        return number

    def _refuse_twin(self, name: str) -> None:
        """Refuse a name if another number has it: a name and an id are one object."""
        if name in self._numbers:
            raise RefusedError("namespace number taken", f"{name!r} stands for another number")

    def _take_place(self, number: int, name: str) -> None:
        size = len(name.encode())
        while self._unused and self._is_full(size):
            self._forget(next(iter(self._unused)))
        if self._is_full(size):
            limits = f"{MAX_NAMESPACES} with {MAX_NAMESPACE_BYTES} bytes in all"
            raise RefusedError("too many namespaces", f"{limits} is the limit")
        self.names[number] = name
        self._numbers[name] = number
        self._unused[number] = None
        self._bytes += size
        self.version += 1

    def _is_full(self, size: int) -> bool:
        most = len(self.names) >= MAX_NAMESPACES
        return most or self._bytes + size > MAX_NAMESPACE_BYTES

    def use(self, number: int, count: int = 1) -> None:
        """Count new objects of an admitted namespace."""
        self._used[number] = self._used.get(number, 0) + count
        self._unused.pop(number, None)

    def leave(self, number: int, count: int = 1) -> None:
        """Count objects that left; one without objects stays until its place is needed."""
        self._used[number] -= count
        if self._used[number] == 0:
            del self._used[number]
            self._unused[number] = None

    def forget_unused(self) -> None:
        """Remove all namespaces without objects."""
        for number in list(self._unused):
            self._forget(number)

    def _forget(self, number: int) -> None:
        del self._unused[number]
        name = self.names.pop(number)
        del self._numbers[name]
        self._bytes -= len(name.encode())
        self.version += 1


class FrameTable:
    """Frames by index; 0 is the fixed frame, others are added and removed."""

    def __init__(self, fixed_frame: str) -> None:
        self.max_bytes = MAX_NAME_BYTES
        """Of a name, in UTF-8."""
        self._names: dict[int, str] = {0: fixed_frame}
        self._indices: dict[str, int] = {"": 0, fixed_frame: 0}

    def __len__(self) -> int:
        return len(self._names)

    def __contains__(self, frame: str) -> bool:
        return frame in self._indices

    @property
    def is_full(self) -> bool:
        """Whether a new frame needs the place of another one: see ``keep_only``."""
        return len(self._names) >= MAX_FRAMES

    def is_fixed(self, frame: str) -> bool:
        """Whether a frame is the fixed one."""
        return self._indices.get(frame) == 0

    def name(self, index: int) -> str:
        """Return the name of a frame."""
        return self._names[index]

    def index(self, frame: str) -> int:
        """Return the index of a frame; an empty name means the fixed frame.

        Raises RefusedError ("bad name", "too many frames").
        """
        present = self._indices.get(frame)
        if present is not None:
            return present
        check_name(frame, "frame", self.max_bytes)
        if self.is_full:
            raise RefusedError("too many frames", f"{MAX_FRAMES} in use is the limit")
        new = next(number for number in range(len(self._names) + 1) if number not in self._names)
        self._names[new] = frame
        self._indices[frame] = new
        return new

    def keep_only(self, used: Iterable[int]) -> None:
        """Remove the frames that are not in use."""
        kept = {0, *used}
        for index in [index for index in self._names if index not in kept]:
            del self._indices[self._names.pop(index)]

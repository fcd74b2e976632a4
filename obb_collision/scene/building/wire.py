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

"""Messages between a process and the one that builds for it: values and arrays through pipes.

A message is a header (its length, then JSON) and the bytes of its arrays. Nothing in it can run.
"""

from __future__ import annotations

import fcntl
import json
import math
import os
import select
import struct
import sys
from contextlib import suppress
from time import monotonic
from typing import Any

import numpy as np

BAD_SHAPE = "bad shape"
NO_MEMORY = "not enough memory"
TOO_SLOW = "building took too long"
NO_BUILDER = "shape builder failed"
TOO_MANY = "too many shapes waiting"


class BuildError(ValueError):
    """``reason`` is a short fixed phrase, one of the above or a job's own; ``detail`` says more."""

    def __init__(self, reason: str, detail: str = "") -> None:
        super().__init__(f"{reason}: {detail}" if detail else reason)
        self.reason = reason
        self.detail = detail


#: Values of JSON, and arrays of numbers.
Message = dict[str, Any]

LENGTH = struct.Struct("<Q")
#: Bytes of a header at most: values are paths and reasons.
LONGEST_HEADER = 1 << 20
#: Bytes that a pipe holds, if the system lets it: each time it is full costs a change of threads.
PIPE_SIZE = 1 << 20
KINDS = "biuf"


class Pipe:
    """One end of a pipe each way.

    seconds: how long ``send`` and ``receive`` may take (TimeoutError); None: no limit.
    """

    def __init__(self, reading: int, writing: int) -> None:
        self._reading, self._writing = reading, writing
        for descriptor in (reading, writing):
            os.set_blocking(descriptor, False)
            if sys.platform == "linux":
                with suppress(OSError, AttributeError):  # Python 3.10 has no name for it on 3.9's
                    fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, PIPE_SIZE)

    def send(self, message: Message, seconds: float | None = None) -> None:
        """Send a message. OSError where the other end is closed."""
        values: Message = {}
        arrays: list[np.ndarray[Any, Any]] = []
        layout = []
        for name, value in message.items():
            if isinstance(value, np.ndarray):
                array = np.ascontiguousarray(value)
                layout.append((name, array.dtype.str, array.shape))
                arrays.append(array)
            else:
                values[name] = value
        header = json.dumps({"values": values, "arrays": layout}).encode()
        views: list[Any] = [
            LENGTH.pack(len(header)) + header,
            *(a.reshape(-1).view(np.uint8) for a in arrays),
        ]
        end = _end(seconds)
        for view in views:
            self._write(memoryview(view), end)

    def receive(self, seconds: float | None = None) -> Message | None:
        """Return the next message, None where the other end is closed. ValueError for junk."""
        end = _end(seconds)
        start = self._read(LENGTH.size, end)
        if start is None:
            return None
        (length,) = LENGTH.unpack(start)
        if length > LONGEST_HEADER:
            raise ValueError(f"a header of {length} bytes")
        text = self._read(length, end)
        if text is None:
            return None
        try:
            header = json.loads(bytes(text))
            message: Message = dict(header["values"])
            layout = [(name, _dtype(kind), tuple(shape)) for name, kind, shape in header["arrays"]]
        except (KeyError, TypeError) as error:
            raise ValueError(f"a header that is none: {error}") from error
        for name, dtype, shape in layout:
            data = self._read(dtype.itemsize * math.prod(shape), end)
            if data is None:
                return None
            message[name] = data.view(dtype).reshape(shape)
        return message

    def _write(self, view: memoryview, end: float | None) -> None:
        while len(view):
            _wait(self._writing, select.POLLOUT, end)
            with suppress(BlockingIOError):
                view = view[os.write(self._writing, view) :]

    def _read(self, size: int, end: float | None) -> np.ndarray[Any, np.dtype[np.uint8]] | None:
        buffer = np.empty(size, np.uint8)
        view = memoryview(buffer)
        while len(view):
            _wait(self._reading, select.POLLIN, end)
            with suppress(BlockingIOError):
                count = os.readv(self._reading, [view])
                if count == 0:
                    return None
                view = view[count:]
        return buffer


def _dtype(kind: str) -> np.dtype[Any]:
    dtype = np.dtype(kind)
    if dtype.kind not in KINDS:
        raise ValueError(f"an array of {kind}")
    return dtype


def _end(seconds: float | None) -> float | None:
    return None if seconds is None else monotonic() + seconds


def _wait(descriptor: int, event: int, end: float | None) -> None:
    """Wait until something can be read or written; TimeoutError if the time for that is over."""
    poll = select.poll()
    poll.register(descriptor, event)
    left = None if end is None else max(0.0, 1e3 * (end - monotonic()))
    if left == 0.0 or not poll.poll(left):
        raise TimeoutError

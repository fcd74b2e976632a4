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

"""Processes that do what a program must not wait for: what starts one, and what both sides say.

What a process says is plain, since it may read what strangers sent: nothing of it is unpickled. A
message is None, a number, a text, an array of numbers, or a tuple of these: JSON, and the numbers
of each array after it.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from multiprocessing import BufferTooShort
from multiprocessing.connection import Connection
from pkgutil import resolve_name
from typing import Any

import numpy as np
from numpy.typing import NDArray

#: It finds the package where this process did, whatever the current folder is.
CODE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from obb_collision._child import run; run(int(sys.argv[2]), *json.loads(sys.argv[3]))"
)
#: Libraries reserve memory for each thread, and one thing is done at a time.
SINGLE = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
#: Seconds that a process may take to end: longer where a file system blocks it.
ENDING = 1.0
#: Bytes of the JSON: a thousand times what the deepest message has.
MOST_TEXT = 1 << 20
#: Kinds of numbers in arrays: no objects, and no texts.
NUMBERS = "biuf"
TYPE, SHAPE = "type", "shape"


class MessageError(ValueError):
    """A message is not like those above."""


class Child:
    """A process that calls a function, ``module:name``, with its connection and plain arguments.

    Raises OSError where it can't be started. Signals of a terminal are not meant for it.
    """

    def __init__(self, function: str, *arguments: Any) -> None:
        if not sys.executable:
            raise OSError("no Python interpreter: sys.executable is empty")
        here, there = socket.socketpair()
        self.connection = Connection(here.detach())
        path, call = json.dumps([*map(str, sys.path)]), json.dumps((function, *arguments))
        try:
            with there:
                self._process = subprocess.Popen(
                    [sys.executable, "-c", CODE, path, str(there.fileno()), call],
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    env=os.environ | SINGLE,
                    pass_fds=[there.fileno()],
                    start_new_session=True,
                )
        except BaseException:
            self.connection.close()
            raise

    @property
    def number(self) -> int:
        """The number of the process."""
        return self._process.pid

    def code(self, patience: float = 0.0) -> int | None:
        """Return its exit code, as subprocess has it; None where it has not ended."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        return self._process.poll()

    def how(self, patience: float = 0.2) -> str:
        """Return how it ended, in words."""
        code = self.code(patience)
        if code is None:
            return "it does not answer"
        if code >= 0:
            return f"it ended with exit code {code}"
        name = str(-code)
        with suppress(ValueError):
            name = signal.Signals(-code).name
        return f"it was ended by {name}"

    def kill(self) -> None:
        """End it; also from another thread, which may read meanwhile."""
        with suppress(OSError):
            self._process.kill()

    def end(self) -> None:
        """End it, and the connection."""
        self.connection.close()
        self.kill()
        self.code(ENDING)


def run(descriptor: int, function: str, *arguments: Any) -> None:
    """Call a function: what the process runs."""
    resolve_name(function)(Connection(descriptor), *arguments)


def send(connection: Connection, message: Any) -> None:
    """Send a message; TypeError for anything else."""
    arrays: list[NDArray[Any]] = []
    connection.send_bytes(json.dumps(_described(message, arrays)).encode())
    for array in arrays:
        connection.send_bytes(array.data.cast("B") if array.size else b"")


def _described(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return a message as JSON, and add its arrays to a list."""
    if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
        arrays.append(np.ascontiguousarray(value))
        return {TYPE: value.dtype.str, SHAPE: value.shape}
    if isinstance(value, tuple):
        return [_described(item, arrays) for item in value]
    if value is None or isinstance(value, (int, float, str)):
        return value
    raise TypeError(f"a message has no {type(value).__name__}")


def receive(connection: Connection) -> Any:
    """Return a message; MessageError where it is none.

    MemoryError, OSError and EOFError as a connection raises them.
    """
    try:
        return _received(json.loads(connection.recv_bytes(MOST_TEXT)), connection)
    except (ValueError, TypeError, KeyError, RecursionError, BufferTooShort) as error:
        raise MessageError(f"its reply is not understood: {error}") from error


def _received(value: Any, connection: Connection) -> Any:
    """Return a message from its JSON, and the arrays that come after that."""
    if isinstance(value, list):
        return tuple(_received(item, connection) for item in value)
    if not isinstance(value, dict):
        return value
    kind = np.dtype(value[TYPE])
    if kind.kind not in NUMBERS:
        raise ValueError(f"{kind} are no numbers")
    array = np.empty(value[SHAPE], kind)
    room = array.data.cast("B") if array.size else bytearray()
    if connection.recv_bytes_into(room) < array.nbytes:
        raise ValueError("an array is too short")
    return array

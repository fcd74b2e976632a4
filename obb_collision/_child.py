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

"""Child processes, for work that a program must not wait for, and messages from them.

A child may read files of strangers, so nothing that it sends is unpickled. A message is None, a
number, a text, an array of numbers, or a tuple of these: JSON, and the numbers of each array after
it.
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

#: What a child runs: it finds the package where its parent did, whatever the current folder is.
CODE = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from obb_collision._child import run; run(int(sys.argv[2]), *json.loads(sys.argv[3]))"
)
#: A child needs one thread: libraries reserve memory for each.
SINGLE = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"), "1"
)
#: Seconds that a process may take to end: longer where a file system blocks it.
ENDING = 1.0
#: Limit of bytes of the JSON: a thousand times the largest message.
MOST_TEXT = 1 << 20
#: Kinds of numbers in arrays: no objects, and no texts.
NUMBERS = "biuf"
TYPE, SHAPE = "type", "shape"


class MessageError(ValueError):
    """A message from a child that is not understood."""


class Child:
    """A process that calls a function, ``module:name``, with its connection and plain arguments.

    Raises OSError where it can't be started. Signals of the terminal do not reach it.
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
        """The process id."""
        return self._process.pid

    def code(self, patience: float = 0.0) -> int | None:
        """Return its exit code, as subprocess has it; None while it runs."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(patience)
        return self._process.poll()

    def how(self, patience: float = 0.2) -> str:
        """Return in words how it ended."""
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
        """Kill it, also from another thread, which may read meanwhile."""
        with suppress(OSError):
            self._process.kill()

    def end(self) -> None:
        """Kill it and close the connection."""
        self.connection.close()
        self.kill()
        self.code(ENDING)


def run(descriptor: int, function: str, *arguments: Any) -> None:
    """Call a function; runs in the child."""
    resolve_name(function)(Connection(descriptor), *arguments)


def send(connection: Connection, message: Any) -> None:
    """Send a message; TypeError for anything else."""
    arrays: list[NDArray[Any]] = []
    connection.send_bytes(json.dumps(_described(message, arrays)).encode())
    for array in arrays:
        connection.send_bytes(array.data.cast("B") if array.size else b"")


def _described(value: Any, arrays: list[NDArray[Any]]) -> Any:
    if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
        arrays.append(np.ascontiguousarray(value))
        return {TYPE: value.dtype.str, SHAPE: value.shape}
    if isinstance(value, tuple):
        return [_described(item, arrays) for item in value]
    if value is None or isinstance(value, (int, float, str)):
        return value
    raise TypeError(f"a message has no {type(value).__name__}")


def receive(connection: Connection) -> Any:
    """Receive a message; MessageError if it is not understood.

    MemoryError, OSError and EOFError as the connection raises them.
    """
    try:
        return _received(json.loads(connection.recv_bytes(MOST_TEXT)), connection)
    except (ValueError, TypeError, KeyError, RecursionError, BufferTooShort) as error:
        raise MessageError(f"its reply is not understood: {error}") from error


def _received(value: Any, connection: Connection) -> Any:
    """Return a message from its JSON; receives the arrays after it."""
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

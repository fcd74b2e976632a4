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

"""What the process that builds sends back: JSON, and the numbers of each array after it.

That process reads what strangers sent, so nothing of its replies is unpickled. A reply is None, a
number, a text, an array of numbers, or a tuple of these; or a BuildError by its two texts.
"""

from __future__ import annotations

import json
from multiprocessing import BufferTooShort
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

from obb_collision.scene.building.jobs import BuildError

#: Bytes of the JSON: a thousand times what the deepest reply has.
MOST_TEXT = 1 << 20
#: Kinds of numbers in arrays: no objects, and no texts.
NUMBERS = "biuf"
VALUE, ERROR, TYPE, SHAPE = "value", "error", "type", "shape"


class BadReplyError(ValueError):
    """A reply is none."""


def send_reply(connection: Connection, reply: Any) -> None:
    """Send a result or a BuildError."""
    arrays: list[NDArray[Any]] = []
    if isinstance(reply, BuildError):
        head = {ERROR: [reply.reason, reply.detail]}
    else:
        head = {VALUE: _described(reply, arrays)}
    connection.send_bytes(json.dumps(head).encode())
    for array in arrays:
        connection.send_bytes(array.data.cast("B") if array.size else b"")


def _described(value: Any, arrays: list[NDArray[Any]]) -> Any:
    """Return a result as JSON, and add its arrays to a list."""
    if isinstance(value, np.ndarray) and value.dtype.kind in NUMBERS:
        arrays.append(np.ascontiguousarray(value))
        return {TYPE: value.dtype.str, SHAPE: value.shape}
    if isinstance(value, tuple):
        return [_described(each, arrays) for each in value]
    if value is None or isinstance(value, (int, float, str)):
        return value
    raise TypeError(f"a reply has no {type(value).__name__}")


def receive_reply(connection: Connection) -> Any:
    """Return a result; BuildError as the process says, BadReplyError where it says nothing known.

    MemoryError, OSError and EOFError as a connection raises them.
    """
    try:
        head = json.loads(connection.recv_bytes(MOST_TEXT))
        if ERROR in head:
            reason, detail = head[ERROR]
            if not (isinstance(reason, str) and isinstance(detail, str)):
                raise BadReplyError("an error is no text")
        else:
            return _received(head[VALUE], connection)
    except (ValueError, TypeError, KeyError, RecursionError, BufferTooShort) as error:
        raise BadReplyError(f"its reply is none: {error}") from error
    raise BuildError(reason, detail)


def _received(value: Any, connection: Connection) -> Any:
    """Return a result from its JSON, and the arrays that come after that."""
    if isinstance(value, list):
        return tuple(_received(each, connection) for each in value)
    if not isinstance(value, dict):
        return value
    kind = np.dtype(value[TYPE])
    if kind.kind not in NUMBERS:
        raise BadReplyError(f"{kind} are no numbers")
    array = np.empty(value[SHAPE], kind)
    room = array.data.cast("B") if array.size else bytearray()
    if connection.recv_bytes_into(room) < array.nbytes:
        raise BadReplyError("an array is too short")
    return array

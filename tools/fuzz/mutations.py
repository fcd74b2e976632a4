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

"""Hostile values in the fields of a message, and damage to its bytes or those of a file."""

from __future__ import annotations

import math
import re
from array import array
from random import Random
from typing import Any

FLOATS = (
    *(math.nan, math.inf, -math.inf, 0.0, -0.0, 1.0, -1.0, 0.5, 1e9, 1e300, -1e300),
    *(1e308, -1e308, 1.7e308, 1e-300, 5e-324, 1e19, 2.0**53 + 1.0),
)
TEXTS = (
    *("", "/", "a", "a/1", "map", "odom", "nowhere", "*", "..", "\u00e9\U0001f600", "a\nb", "%00"),
    *("x" * 300, "y" * 5000, "file:///dev/zero", "file:///%00", "file:///etc/passwd", "file://"),
    *("package://nobody/mesh.stl", "package://", "http://localhost/a.stl", "file:///dev/stdin"),
)
LONG_TEXT = 1_000_000
"""Characters of the longest text, which is rare."""
BITS = {"int8": 8, "uint8": 8, "octet": 8, "byte": 8, "char": 8, "int16": 16, "uint16": 16}
BITS |= {"int32": 32, "uint32": 32, "int64": 64, "uint64": 64}
LONGEST_SEQUENCE = 200
"""Entries to which a mutation lets a sequence grow."""


def hostile_integer(kind: str, random: Random) -> int:
    """Return an integer of a kind ("int32"), most often near a bound."""
    bits = BITS[kind]
    signed = kind.startswith("int")
    low, high = (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if signed else (0, (1 << bits) - 1)
    near = random.choice((low, low + 1, -1, 0, 1, 2, 3, 8, 11, high // 2, high - 7, high - 1, high))
    value = near if random.random() < 0.8 else random.randint(low, high)
    return min(max(value, low), high)


def hostile_value(kind: str, random: Random) -> Any:
    """Return a value of a primitive type as ROS names it."""
    if kind in BITS:
        value = hostile_integer(kind, random)
        return bytes([value & 255]) if kind in ("octet", "byte") else value
    if kind in ("float", "double"):
        return random.choice(FLOATS)
    if kind == "boolean":
        return random.random() < 0.5
    if random.random() < 0.002:
        return "z" * LONG_TEXT
    return random.choice(TEXTS)


def mutate(message: Any, random: Random) -> None:
    """Spoil one field of a message in place, at any depth."""
    name, kind = random.choice(list(message.get_fields_and_field_types().items()))
    value = getattr(message, name)
    match = re.fullmatch(r"sequence<([^,>]+)(?:, *\d+)?>|([^\[]+)\[\d+\]", kind)
    if match is not None:
        _mutate_sequence(message, name, match[1] or match[2], bool(match[1]), random)
    elif hasattr(value, "get_fields_and_field_types"):
        mutate(value, random)
    else:
        setattr(message, name, hostile_value(kind.partition("<")[0], random))


def _mutate_sequence(message: Any, name: str, kind: str, grows: bool, random: Random) -> None:
    values = getattr(message, name)
    if isinstance(values, array) and values.typecode == "B":
        _mutate_bytes(values, random)
        return
    choice = random.random()
    if len(values) and (choice < 0.6 or not grows):
        row = random.randrange(len(values))
        if hasattr(values[row], "get_fields_and_field_types"):
            mutate(values[row], random)
        else:
            values[row] = hostile_value(kind, random)
    elif choice < 0.75:
        del values[random.randrange(len(values) + 1) :]
    elif len(values):
        more = min(random.choice((1, 2, 100)), LONGEST_SEQUENCE - len(values))
        values.extend([values[random.randrange(len(values))]] * max(0, more))


def _mutate_bytes(values: Any, random: Random) -> None:
    """Spoil an array of bytes in place."""
    if not len(values) or random.random() < 0.2:
        values.extend(random.randbytes(random.choice((1, 8, 64))))
    elif random.random() < 0.4:
        del values[random.randrange(len(values)) :]
    else:
        start = random.randrange(len(values))
        fresh = random.randbytes(min(8, len(values) - start))
        values[start : start + len(fresh)] = array("B", fresh)


LENGTHS = (0, 1, 2, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1)
"""What stands in place of a length."""


def damaged(data: bytes, random: Random) -> bytes:
    """Return the bytes of a serialised message with changed, lost or added ones."""
    spoiled = bytearray(data)
    for _ in range(random.randint(1, 4)):
        place = random.randrange(min(4, len(spoiled)), len(spoiled) + 1)
        choice = random.random()
        if choice < 0.3 and place < len(spoiled):
            spoiled[place] = random.randrange(256)
        elif choice < 0.5 and place < len(spoiled):
            spoiled[place] ^= 1 << random.randrange(8)
        elif choice < 0.7:
            place -= place % 4  # where a length may be
            spoiled[place : place + 4] = random.choice(LENGTHS).to_bytes(4, "little")
        elif choice < 0.85:
            del spoiled[place:]
        else:
            spoiled[place:place] = random.randbytes(random.randint(1, 16))
    return bytes(spoiled)


def raw(data: bytes, other: bytes, random: Random) -> bytes:
    """Return bytes instead of a serialised message: cut, changed, of another type, or any.

    data: a valid message; other: one of another topic. At least one byte: with none Fast DDS's
    writer fails, and everything that it sends from then on is lost.
    """
    choice = random.random()
    if choice < 0.2:
        return data[: random.randint(1, len(data))]
    if choice < 0.3:
        return data[:4] + other[4:]
    if choice < 0.35:
        return random.randbytes(random.choice((1, 2, 3, 4, 5, 8, 100, 1000)))
    if choice < 0.4:
        return data[:4] + random.randbytes(random.randrange(300))
    if choice < 0.45:  # other encodings, most of which are none
        return bytes((random.choice((0, 0, 0, 1, 255)), random.randrange(32))) + data[2:]
    return damaged(data, random)

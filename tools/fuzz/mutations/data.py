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

"""Damage to the bytes of a serialised message, or of a file."""

from __future__ import annotations

from random import Random

LENGTHS = (0, 1, 2, 255, 2**16, 2**24, 2**31 - 1, 2**31, 2**32 - 8, 2**32 - 1)
"""What stands in place of a length."""


def damaged(data: bytes, random: Random) -> bytes:
    """Return the bytes of a serialised message with some changed, lost or added."""
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

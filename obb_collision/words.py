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

"""Text from outside: names that can be printed, sent and matched, and values shown in messages.

A name reaches messages, logs and patterns. One with a lone surrogate can't be encoded, one with a
control character breaks the line of a log, and an enormous one is copied with every message.
"""

from __future__ import annotations

import os
import re
import reprlib
import shutil
from collections.abc import Sequence

#: Maximum characters of a name or namespace.
MAX_NAME = 255
#: Maximum characters of an object's name in a scene: a namespace, a slash and an id, with room.
MAX_OBJECT_NAME = 300
#: Maximum characters of a pattern: a name with every character in brackets, and room.
MAX_PATTERN = 1000
#: Maximum characters of a path or URI: the limit of Linux for a path.
MAX_PATH = 4096
#: Maximum characters of a value shown in a message.
MAX_SHOWN = 80

#: Control characters, separators of lines, and halves of surrogate pairs (no UTF-8 holds them).
UNPRINTABLE = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff]")

_repr = reprlib.Repr()
_repr.maxstring = _repr.maxother = MAX_SHOWN


def command_line(words: str) -> str:
    """Return how a user starts a command here: its words, or these after ``ros2 run``.

    The latter where only ros2 finds it: colcon puts executables into ``lib``, not on PATH.
    """
    program = words.partition(" ")[0]
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    by_ros = (os.path.exists(os.path.join(p, "lib", "obb_collision", program)) for p in prefixes)
    return f"ros2 run obb_collision {words}" if not shutil.which(program) and any(by_ros) else words


def text_fault(text: str, most: int) -> str | None:
    """Return why a text is no valid name, as the end of a sentence; None for a valid one."""
    if not text:
        return "must not be empty"
    if len(text) > most:
        return f"must have at most {most} characters, got {len(text)}"
    bad = UNPRINTABLE.search(text)
    if bad is not None:
        return f"must not hold the character U+{ord(bad[0]):04X}, got {shown(text)}"
    return None


def check_name(value: object, what: str, most: int = MAX_NAME) -> str:
    """Return a valid name unchanged; else ValueError, which begins with ``what``."""
    if not isinstance(value, str):
        raise ValueError(f"{what} must be a string, got {shown(value)}")
    fault = text_fault(value, most)
    if fault is not None:
        raise ValueError(f"{what} {fault}")
    return value


def check_names(values: Sequence[str], what: str, most: int = MAX_NAME) -> None:
    """Raise ValueError for the first invalid name; many are tested together."""
    try:
        good = all(values) and max(map(len, values), default=0) <= most
        good = good and UNPRINTABLE.search("".join(values)) is None
    except TypeError:  # not all are strings
        good = False
    if not good:
        for value in values:
            check_name(value, what, most)


def printable(text: str) -> str:
    """Return a text with escapes for characters that cannot be printed or encoded."""
    return UNPRINTABLE.sub(lambda match: repr(match[0])[1:-1], text)


def shown(value: object) -> str:
    """Return a value for a message: like ``repr``, but short, printable and never failing."""
    try:
        text = _repr.repr(value)
    except Exception:  # its own repr fails, or it is an integer of too many digits
        text = f"a value of type {type(value).__name__}"
    text = printable(" ".join(text.split("\n")))
    return text if len(text) <= MAX_SHOWN else text[: MAX_SHOWN - 3] + "..."

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

"""When this machine stood still: a process that only sleeps, and says how late it woke.

``python -m tools.fuzz.process.canary`` prints when it should have woken and when it
did (s since 1970). Whatever keeps it from running keeps others from it, too: other programs, a
hypervisor that gives the processor away, memory that is being freed.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time

NAP = 0.005
"""Seconds of a sleep."""
LATE = 0.01
"""Seconds by which it wakes late that count."""


class Canary:
    """Such a process, and what it has said."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", __file__], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self._process.stdout is not None
        self._process.stdout.readline()
        os.set_blocking(self._process.stdout.fileno(), False)
        self._rest = b""

    def stalls(self) -> list[tuple[float, float]]:
        """Return since when and until when (s since 1970) it stood still, since the last call."""
        assert self._process.stdout is not None
        *lines, self._rest = (self._rest + (self._process.stdout.read() or b"")).split(b"\n")
        return [(float(start), float(end)) for start, end in (line.split() for line in lines)]

    @property
    def number(self) -> int:
        """Number of the process."""
        return self._process.pid

    def close(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.communicate()


def main() -> None:
    """Sleep and say so, until the process that reads it is gone."""
    parent = os.getppid()
    os.write(1, b"awake\n")
    while os.getppid() == parent:
        wanted = time.time() + NAP
        time.sleep(NAP)
        if (woken := time.time()) > wanted + LATE:
            os.write(1, f"{wanted} {woken}\n".encode())


if __name__ == "__main__":
    main()

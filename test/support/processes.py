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

"""Processes that a test talks to, each with a limit."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Timer

PATIENCE = 1200.0
"""Seconds that a process may take on a loaded machine, compiling kernels included."""


@contextmanager
def limited(process: subprocess.Popen[str]) -> Iterator[subprocess.Popen[str]]:
    """Yield a process that is killed at the end, or after ``PATIENCE``: what it says ends then."""
    limit = Timer(PATIENCE, process.kill)
    limit.start()
    try:
        yield process
    finally:
        limit.cancel()
        process.kill()
        process.communicate(timeout=PATIENCE)


def output_until(process: subprocess.Popen[str], word: str) -> str:
    """Return the output up to a line with a word, without which the process must not end."""
    assert process.stdout is not None
    lines: list[str] = []
    while word not in (lines or [""])[-1]:
        lines.append(process.stdout.readline())
        assert lines[-1], f"ended without {word!r}: {lines}"
    return "".join(lines)

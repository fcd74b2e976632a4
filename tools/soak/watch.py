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

"""What a process holds: memory, descriptors, threads, and what its children hold (Linux)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

MB = 1e6
WINDOW = 0.1
"""Share of the samples at each end that are compared: their medians."""


class Sample(NamedTuple):
    """What a process holds at a time."""

    seconds: float
    memory: float
    """Resident memory (MB)."""
    children: float
    """Resident memory of its children (MB)."""
    descriptors: int
    threads: int


def sample(number: int, seconds: float) -> Sample:
    """Return what process ``number`` holds; OSError once it has ended."""
    folder = Path(f"/proc/{number}")
    memory, threads = _status(folder)
    children = 0.0
    for task in (folder / "task").iterdir():
        for child in (task / "children").read_text().split():
            children += _status(Path(f"/proc/{child}"))[0]
    descriptors = sum(1 for _ in (folder / "fd").iterdir())
    return Sample(seconds, memory, children, descriptors, threads)


def _status(folder: Path) -> tuple[float, int]:
    """Return resident memory (MB) and threads of a process; nothing of one that has ended."""
    lines = (folder / "status").read_text().splitlines()
    values = dict(line.split(":", 1) for line in lines if ":" in line)
    return 1024 * int(values.get("VmRSS", "0 kB").split()[0]) / MB, int(values["Threads"])


def ends(samples: Sequence[Sample], name: str) -> tuple[float, float]:
    """Return the medians of a figure over the first and the last part of the samples."""
    values = np.array([getattr(one, name) for one in samples], dtype=np.float64)
    count = max(1, round(WINDOW * len(values)))
    return float(np.median(values[:count])), float(np.median(values[-count:]))

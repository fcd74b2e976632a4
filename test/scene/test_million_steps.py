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

"""A scene in use for a million steps takes no more memory than after the first ones."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scenes import random_poses

import obb_collision as oc

STEPS, FIRST = 1_000_000, 100_000
COUNT = 10
NEXT = 20
"""Steps after which one object leaves for another of a new name."""
GROWTH = 1e6
"""Bytes that a process may take for what has nothing to do with the steps."""


def resident() -> int:
    """Return the resident memory of this process (bytes)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * 4096


@pytest.mark.slow  # minutes; test_memory_does_not_grow_with_the_steps shows it for fewer
@pytest.mark.skipif(sys.platform != "linux", reason="/proc is of Linux")
def test_memory_is_reused_for_a_million_steps() -> None:
    rng = np.random.default_rng(1)
    frames = [random_poses(COUNT, rng, 1.0) for _ in range(16)]
    scene = oc.Scene()
    scene.add_boxes([f"box/{k}" for k in range(COUNT)], np.ones((COUNT, 3)), frames[0])
    before = pairs = 0
    for step in range(STEPS):
        if step % NEXT == 0:
            scene.remove(f"box/{step // NEXT}")
            scene.add(f"box/{step // NEXT + COUNT}", oc.shapes.Box((1.0, 1.0, 1.0)))
        scene.move_indices(scene.indices, frames[step % 16])
        pairs += len(scene.check("separations").pairs)
        if step == FIRST:
            before = resident()
    assert len(scene) == COUNT
    assert pairs > STEPS
    assert resident() - before < GROWTH

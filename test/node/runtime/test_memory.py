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

"""Memory that a cycle frees is kept for the next one, in the node's own process only."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys

import pytest

pytest.importorskip("rclpy")
from processes import PATIENCE

#: Steps of 20,000 boxes, some 10 MB each, and the page faults of the last five.
STEPS = """
import resource, sys
import numpy as np
import obb_collision as oc

oc.set_threads(1)
rng = np.random.default_rng(0)
poses = np.concatenate([30 * rng.random((20_000, 3)), rng.normal(size=(20_000, 4))], axis=1)
poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
sizes = rng.uniform(0.05, 0.5, (20_000, 3))
if len(sys.argv) > 1:
    from obb_collision.node.runtime.running import keep_freed_memory
    keep_freed_memory()
for step in range(12):
    if step == 7:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    oc.find_pairs(oc.Boxes.from_poses(poses, sizes))
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def pages(*arguments: str) -> int:
    """Return the page faults of steps; with an argument, of those in a node's process."""
    done = subprocess.run(
        [sys.executable, "-c", STEPS, *arguments],
        capture_output=True,
        text=True,
        check=True,
        timeout=PATIENCE,
    )
    return int(done.stdout)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's memory")
def test_a_node_keeps_what_it_frees_and_the_library_leaves_the_process_as_it_is() -> None:
    all_of_them = 5 * 10e6 / resource.getpagesize()
    assert pages("node") < all_of_them / 20 < pages()

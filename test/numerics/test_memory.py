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

"""Steps take the memory that the step before has freed."""

from __future__ import annotations

import platform
import resource
import subprocess
import sys

import pytest

#: Steps of 20,000 boxes, some 10 MB each, and the page faults of the last ones.
STEPS = """
import resource
import numpy as np
import obb_collision as oc

oc.set_threads(1)
rng = np.random.default_rng(0)
poses = np.concatenate([30 * rng.random((20_000, 3)), rng.normal(size=(20_000, 4))], axis=1)
poses[:, 3:] /= np.linalg.norm(poses[:, 3:], axis=1)[:, None]
sizes = rng.uniform(0.05, 0.5, (20_000, 3))
for step in range(20):
    if step == 10:
        before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    oc.find_pairs(oc.Boxes.from_poses(poses, sizes))
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="glibc's memory")
def test_steps_take_no_new_pages() -> None:
    done = subprocess.run(
        [sys.executable, "-c", STEPS], capture_output=True, text=True, check=True, timeout=300
    )
    pages = 10 * 10e6 / resource.getpagesize()  # of 10 steps that give all back: 8000 were seen
    assert int(done.stdout) < pages / 20

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

"""Memory that a step frees is kept for the next one."""

from __future__ import annotations

import numpy as np

#: Bytes of the largest block after which glibc raises its thresholds (mallopt(3), 32 MB at most).
LARGEST_BLOCK = 31 << 20


def keep_freed_memory() -> None:
    """Let the process keep some 60 MB of what it frees, and not give it back at every step.

    Taking it again costs a page fault per 4 kB: a sixth of the time of steps of 10,000 to 100,000
    boxes. By what glibc does by itself once a block of that size is freed; nothing is written to
    it, so that it takes no memory. Other libraries of C do as they do.
    """
    np.empty(LARGEST_BLOCK, np.uint8)

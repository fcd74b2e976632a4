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

"""Python's garbage collector, kept from stopping the cycles of a node's process.

A full collection looks at every object that holds others: numba, scipy and rclpy bring some hundred
thousand of them, and a collection took 0.08 to 0.3 s, once a second where diagnostics are heard.
What is there when the node is ready stays till its end, so it is put out of the collector's sight.
"""

from __future__ import annotations

import gc

_settled = False


def settle() -> None:
    """Keep all that is there now out of further collections; for a process that is the node's."""
    global _settled
    gc.collect()
    gc.freeze()
    _settled = True


def settle_more() -> None:
    """Keep what was loaded since out, too, where the process has settled; it takes no time."""
    if _settled:
        gc.freeze()

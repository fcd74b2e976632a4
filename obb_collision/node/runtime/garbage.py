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

"""Settings of Python's garbage collector that avoid long pauses of the node's cycles.

A full collection visits all container objects: numba, scipy and rclpy create several hundred
thousand of them, and a collection took 0.08 to 0.3 s, once per second with diagnostics subscribed.
Objects that exist when the node is ready live as long as it does, so the collector ignores them.
"""

from __future__ import annotations

import gc

_settled = False


def settle() -> None:
    """Exclude all present objects from further collections; only in the node's own process."""
    global _settled
    gc.collect()
    gc.freeze()
    _settled = True


def settle_more() -> None:
    """Exclude objects loaded since then, too, if ``settle`` was called; takes no time."""
    if _settled:
        gc.freeze()

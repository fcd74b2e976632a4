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


"""The node from message to message, for ``obb_collision speed --goals``: needs ROS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from obb_collision.benchmarks.latency import MOVING, NEW, Latency

#: Numbers of objects that move by each input, and that are others in every frame.
SIZES, OTHERS = (100, 1_000, 10_000), 500
#: Seconds of each measurement.
SECONDS = 4.0


def measure_node(show: Callable[[str], None]) -> list[dict[str, Any]]:
    """Return a row per way of sending; one in which a frame has no answer has no times."""
    rows: list[dict[str, Any]] = []
    ways = [(way, objects) for way in MOVING for objects in SIZES]
    for way, objects in [*ways, *((way, OTHERS) for way in NEW)]:
        show(f"node: {objects:,} by {way}")
        latency = Latency(seed=1)
        try:
            rows.append(latency.measure(way, objects, SECONDS).row)
        except TimeoutError:
            rows.append({"way": way, "objects": objects})
        finally:
            latency.close()
    return rows

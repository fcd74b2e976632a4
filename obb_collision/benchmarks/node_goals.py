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


"""What the node is meant to reach, from message to message: needs ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from obb_collision.benchmarks.latency import NEW, Latency

#: Ways and numbers of objects, and milliseconds: the median, and what 99 % are below.
GOALS = (
    ("object_poses", 1_000, 1.0, 3.0),
    ("object_poses", 10_000, 8.0, None),
    (NEW[0], 500, 3.0, None),
    *((way, 500, 40.0, None) for way in NEW[1:]),
)
#: Seconds of each measurement.
SECONDS = 6.0


def node_goals(tell: Callable[[str], None]) -> Iterator[tuple[str, str, str, bool]]:
    """Yield what, what is wanted, what was measured, and whether that is enough."""
    latency = Latency(seed=1)
    try:
        for way, objects, most, most_99 in GOALS:
            tell(f"node: {objects:,} by {way}")
            row = latency.measure(way, objects, SECONDS).row
            median, late = row["median"], row["99 %"]
            late_goal = f", 99 % below {most_99:g} ms" if most_99 else ""
            met = median < most and (most_99 is None or late < most_99)
            wanted = f"median below {most:g} ms{late_goal}"
            told = f"median {median:.2f} ms, 99 % {late:.2f} ms"
            yield f"node, {objects:,} by {way}", wanted, told, met
    finally:
        latency.close()

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

import numpy as np

from obb_collision.benchmarks.latency import Latency

#: Objects by ``object_poses``, and milliseconds: the median, and what 99 % are below.
POSES = ((1_000, 1.0, 3.0), (10_000, 8.0, None))
#: Seconds of each measurement.
SECONDS = 6.0


def node_goals(tell: Callable[[str], None]) -> Iterator[tuple[str, str, str, bool]]:
    """Yield what, what is wanted, what was measured, and whether that is enough."""
    for objects, most, most_99 in POSES:
        tell(f"node: {objects:,} by object_poses")
        latency = Latency(objects, seed=1)
        try:
            samples, _ = latency.measure(SECONDS)
        finally:
            latency.close()
        median, late = np.percentile(1e3 * samples, (50, 99))
        wanted = f"median below {most:g} ms" + (f", 99 % below {most_99:g} ms" if most_99 else "")
        met = bool(median < most and (most_99 is None or late < most_99))
        told = f"median {median:.2f} ms, 99 % {late:.2f} ms"
        yield f"node, {objects:,} by object_poses", wanted, told, met

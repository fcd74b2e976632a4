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

"""The console scripts ``obb_collision_node`` and ``obb_collision_latency``.

They import what needs ROS only after they know that it is there.
"""

from __future__ import annotations

from collections.abc import Sequence

from obb_collision.node.environment import is_ros_here, set_defaults


def node(args: Sequence[str] | None = None) -> int:
    """Run the collision node until SIGINT or SIGTERM; returns the exit code."""
    if not is_ros_here("obb_collision_node"):
        return 1
    set_defaults()
    from obb_collision.node.node import main

    return main(args)


def latency(args: Sequence[str] | None = None) -> int:
    """Measure from the publication of poses to the collisions; returns the exit code."""
    if not is_ros_here("obb_collision_latency"):
        return 1
    set_defaults()
    from obb_collision.node.latency import main

    return main(args)

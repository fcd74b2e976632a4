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

"""The console script ``obb_collision_fuzz``; it imports ROS only where it is there."""

from __future__ import annotations

from collections.abc import Sequence

from obb_collision.node.environment import is_ros_here, set_defaults


def fuzz(args: Sequence[str] | None = None) -> int:
    """Attack a node with hostile messages; returns the exit code."""
    if not is_ros_here("obb_collision_fuzz"):
        return 1
    set_defaults()
    from obb_collision.checks.fuzz.command import main

    return main(args)

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

"""A rig whose node others manage, and what it says of its state."""

from __future__ import annotations

from typing import Any

from lifecycle_msgs.msg import Transition
from rig import STATUS, Rig, cube

A1, A2, B1 = ("a", 1), ("a", 2), ("b", 1)
PAIR = (cube(A1), cube(A2, (0.5, 0, 0)))
NAMED = {("a/1", "a/2")}
CONFIGURE, ACTIVATE = Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE
DEACTIVATE, CLEANUP = Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP
SHUTDOWN = {
    "unconfigured": Transition.TRANSITION_UNCONFIGURED_SHUTDOWN,
    "inactive": Transition.TRANSITION_INACTIVE_SHUTDOWN,
    "active": Transition.TRANSITION_ACTIVE_SHUTDOWN,
}
WAYS = {"unconfigured": (), "inactive": (CONFIGURE,), "active": (CONFIGURE, ACTIVATE)}
MARKERS = "obb_collision/markers"
SCENE = """
padding: {padding}
objects:
  - {{name: part/1, shape: box, size: [1, 1, 1], position: [0, 0, 0]}}
"""


def managed(*transitions: int, **parameters: Any) -> Rig:
    """Return a rig with a node that others manage, after some transitions."""
    rig = Rig(deaf=True, autostart=False, given=parameters)
    rig.listen("collisions", "in_collision", "namespaces", STATUS)
    for transition in transitions:
        assert rig.change(transition)
    return rig

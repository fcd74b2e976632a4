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

"""Positions and orientations as scene files give them."""

from __future__ import annotations

from obb_collision.scene.files.motion import Quaternion, from_rpy
from obb_collision.scene.files.values import Value

NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)


def quaternion_of(fields: dict[str, Value], default: Quaternion = NO_TURN) -> Quaternion:
    """Return the quaternion of the keys ``rpy`` (radians) or ``quaternion`` (x y z w).

    It is as given, of any length but zero.
    """
    if "quaternion" in fields and "rpy" in fields:
        fields["rpy"].refuse("there is a quaternion already; one of them is enough")
    if "rpy" in fields:
        roll, pitch, yaw = fields["rpy"].numbers(3)
        return from_rpy(roll, pitch, yaw)
    if "quaternion" not in fields:
        return default
    x, y, z, w = fields["quaternion"].numbers(4)
    if x == y == z == w == 0.0:
        fields["quaternion"].refuse("must not be zero: without a rotation it is [0, 0, 0, 1]")
    return x, y, z, w

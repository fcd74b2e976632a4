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

"""Positions and orientations in scene files."""

from __future__ import annotations

from math import pi

from obb_collision.geometry.poses import Quaternion, unit_quaternions
from obb_collision.geometry.validation import is_far_from_unit
from obb_collision.scene_files.yaml_values import Value

NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)
#: Maximum angle (rad): a full turn, and what rounding it to 6.3 adds. More must be degrees.
MAX_ANGLE = 6.3


def quaternion_of(fields: dict[str, Value], default: Quaternion = NO_TURN) -> Quaternion:
    """Return the quaternion of the keys ``rpy`` (radians) or ``quaternion`` (x y z w).

    One of about length 1 is returned as it is. Others, except zero, are normalised, with a note.
    """
    if "quaternion" in fields and "rpy" in fields:
        fields["rpy"].refuse("there is a quaternion already; one of them is enough")
    if "rpy" in fields:
        roll, pitch, yaw = fields["rpy"].numbers(3)
        check_angles(fields["rpy"], roll, pitch, yaw)
        return from_rpy(roll, pitch, yaw)
    if "quaternion" not in fields:
        return default
    x, y, z, w = fields["quaternion"].numbers(4)
    if x == y == z == w == 0.0:
        fields["quaternion"].refuse("must not be zero: without a rotation it is [0, 0, 0, 1]")
    return settled(fields["quaternion"], (x, y, z, w))


def check_angles(value: Value, *angles: float) -> None:
    """Refuse angles that can only be degrees."""
    largest = max(abs(angle) for angle in angles)
    if largest > MAX_ANGLE:
        hint = f"{largest:g} degrees are {largest * pi / 180.0:.6g}"
        value.refuse(f"angles are in radians, at most a turn; {hint}, got {value.shown()}")


def settled(value: Value, quaternion: Quaternion) -> Quaternion:
    """Return a quaternion that is not zero as it is; far from length 1, normalised, with a note."""
    if not is_far_from_unit(quaternion):
        return quaternion
    value.doubt(f"a quaternion far from unit length, taken as normalised, got {value.shown()}")
    return unit(quaternion)


def unit(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion of length 1."""
    x, y, z, w = unit_quaternions(quaternion).tolist()
    return x, y, z, w


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of rotations about the fixed axes x, then y, then z (ROS REP 103)."""
    from scipy.spatial.transform import Rotation  # here, as it takes 0.2 s

    x, y, z, w = Rotation.from_euler("xyz", (roll, pitch, yaw)).as_quat().tolist()
    return x, y, z, w

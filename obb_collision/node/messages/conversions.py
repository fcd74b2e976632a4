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

"""Messages <-> arrays: poses, stamps and names.

Pairs of pure functions ``x_from_ros`` / ``x_to_ros``. Poses are float64 rows
``x y z qx qy qz qw`` (metres, quaternion x y z w), exactly the doubles of the message.
Stamps are whole nanoseconds. Clouds are in ``clouds``, shapes in ``marker_shapes``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from builtin_interfaces.msg import Duration, Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Pose, Quaternion, Transform, Twist, Vector3
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import MultiDOFJointState

from obb_collision._jit import njit
from obb_collision.geometry.validation import UNIT_TOLERANCE
from obb_collision.geometry.values import read_only_view
from obb_collision.node.messages.cdr import Stamp, namespace_bytes
from obb_collision.node.messages.errors import RefusedError
from obb_collision.node.messages.names import namespace_number
from obb_collision.typing import Floats, Mask

Key = tuple[str, int]
"""What names an object: marker namespace and marker id."""

NANOSECONDS = 1_000_000_000
LARGEST_COORDINATE = 1e300
"""Magnitudes above this are refused by the library, for sums must not overflow."""
GOOD, UNUSABLE, ZERO, FAR = range(4)
"""Kinds of poses from outside, see ``pose_kinds``."""
Kinds = npt.NDArray[np.int8]
"""(n,) of n poses."""
SMALLEST_MEANT = float(np.finfo(np.float64).tiny)
"""Sizes and quaternions below this count as zero. rclpy does not check what Python code assigns to
a float field: an int there arrives as the bits of its object header, a subnormal number."""


def stamp_from_ros(stamp: Time | Stamp) -> int:
    """Return the nanoseconds of a Time.

    Raises RefusedError ("bad stamp") for one before 1970 or with a second of nanoseconds or more,
    which no clock gives.
    """
    seconds, rest = int(stamp.sec), int(stamp.nanosec)
    if seconds < 0 or not 0 <= rest < NANOSECONDS:
        raise RefusedError("bad stamp", f"sec {seconds}, nanosec {rest}")
    return seconds * NANOSECONDS + rest


def stamp_to_ros(nanoseconds: int) -> Time:
    """Return the Time of whole nanoseconds."""
    seconds, rest = divmod(int(nanoseconds), NANOSECONDS)
    return Time(sec=seconds, nanosec=rest)


def duration_to_ros(seconds: float) -> Duration:
    """Return the Duration of seconds."""
    whole, rest = divmod(round(seconds * NANOSECONDS), NANOSECONDS)
    return Duration(sec=whole, nanosec=rest)


def name_from_key(key: Key) -> str:
    """Return the object's name, ``ns/id``; an empty namespace gives ``/id``."""
    return f"{key[0]}/{key[1]}"


def pose_to_ros(pose: Sequence[float] | Floats) -> Pose:
    """Return the Pose of an array (7,)."""
    position, orientation = _position_and_quaternion(pose)
    return Pose(position=Point(**position), orientation=orientation)


def transform_from_ros(transform: Transform) -> Floats:
    """Return the pose (7,) of a Transform."""
    p, q = transform.translation, transform.rotation
    return np.array((p.x, p.y, p.z, q.x, q.y, q.z, q.w))


def transform_to_ros(pose: Sequence[float] | Floats) -> Transform:
    """Return the Transform of a pose (7,)."""
    position, rotation = _position_and_quaternion(pose)
    return Transform(translation=Vector3(**position), rotation=rotation)


def _position_and_quaternion(
    pose: Sequence[float] | Floats,
) -> tuple[dict[str, float], Quaternion]:
    x, y, z, qx, qy, qz, qw = (float(value) for value in pose)
    return {"x": x, "y": y, "z": z}, Quaternion(x=qx, y=qy, z=qz, w=qw)


def twist_to_ros(twist: Sequence[float] | Floats) -> Twist:
    """Return the Twist of an array (6,): linear (m/s), angular (rad/s)."""
    x, y, z, wx, wy, wz = (float(value) for value in twist)
    return Twist(linear=Vector3(x=x, y=y, z=z), angular=Vector3(x=wx, y=wy, z=wz))


def states_to_ros(
    names: Sequence[str], poses: Floats, header: Any = None, twists: Floats | None = None
) -> MultiDOFJointState:
    """Return the MultiDOFJointState of names, poses (n, 7) and twists (n, 6)."""
    message = MultiDOFJointState(joint_names=list(names))
    message.transforms = [transform_to_ros(pose) for pose in poses]
    if twists is not None:
        message.twist = [twist_to_ros(twist) for twist in twists]
    if header is not None:
        message.header = header
    return message


def namespaces_to_ros(namespaces: Mapping[int, str] | Iterable[str]) -> DiagnosticStatus:
    """Return the table of the ``ns`` numbers: key is the number, value the namespace.

    namespaces: by number, or just their names.
    """
    data = namespace_bytes(namespace_table(namespaces))
    message: DiagnosticStatus = deserialize_message(data, DiagnosticStatus)
    return message


def namespace_table(
    namespaces: DiagnosticStatus | Mapping[int, str] | Iterable[str],
) -> Mapping[int, str]:
    """Return namespaces by number, from a message of ``namespaces``, a mapping, or names.

    Tables of several nodes can be merged: ``{**namespace_table(a), **namespace_table(b)}``.
    """
    if isinstance(namespaces, Mapping):
        return namespaces
    if hasattr(namespaces, "values"):  # a message, of whatever library has read it
        return {int(pair.key): pair.value for pair in namespaces.values}
    return {namespace_number(name): name for name in namespaces}


def are_unusable(kinds: Kinds) -> Mask:
    """Return whether poses of these kinds (n,) cannot be used."""
    return (kinds == UNUSABLE) | (kinds == ZERO)


def unusable_poses(poses: Floats) -> Mask:
    """Return which poses (n, 7) cannot be used (n,)."""
    return are_unusable(pose_kinds(poses))


def pose_kinds(poses: Floats) -> Kinds:
    """Return the kind of each pose (n, 7): GOOD, UNUSABLE, ZERO or FAR.

    UNUSABLE: not finite or too large. ZERO: a quaternion of length zero. FAR: a quaternion far from
    unit length; it is normalised, but doubtful. GOOD: none of these.
    """
    kinds = np.empty(len(poses), np.int8)
    _fill_kinds(read_only_view(np.ascontiguousarray(poses)), kinds)
    return kinds


@njit
def _fill_kinds(poses: Floats, kinds: Kinds) -> None:
    for row in range(len(poses)):
        pose, usable = poses[row], True
        for value in pose:
            usable &= abs(value) <= LARGEST_COORDINATE
        zero, squares = True, 0.0
        for part in pose[3:]:
            zero &= abs(part) < SMALLEST_MEANT
            squares += part * part
        far = abs(np.sqrt(squares) - 1.0) > UNIT_TOLERANCE
        kinds[row] = (ZERO if zero else FAR if far else GOOD) if usable else UNUSABLE

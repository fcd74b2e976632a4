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

"""Motions of a scene file's objects: pose and twist at a time, for demos and measurements.

A pose is x y z qx qy qz qw, a twist linear x y z (m/s) and angular x y z (rad/s) of the object's
origin, both in the scene's frame. Scalars, for a scene moves a few objects at a time.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, fmod, sin, sqrt

Pose = tuple[float, float, float, float, float, float, float]
Twist = tuple[float, float, float, float, float, float]
Place = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
State = tuple[Pose, Twist]

AT_REST: Twist = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Steady:
    """A steady twist from where the object stands; with ``period`` (s) it starts again there."""

    twist: Twist
    period: float | None = None

    def state(self, start: Pose, time: float) -> State:
        """Return pose and twist at a time (s)."""
        passed = time if self.period is None else fmod(time, self.period)
        return moved(start, self.twist, passed), self.twist


@dataclass(frozen=True)
class Loop:
    """Through poses and back to the first, straight and at a steady speed from one to the next.

    times (n,): when it is at each, seconds, ascending from 0; period: when it is back at the first.
    """

    poses: tuple[Pose, ...]
    times: tuple[float, ...]
    period: float

    def state(self, start: Pose, time: float) -> State:
        """Return pose and twist at a time (s); the poses say all, ``start`` is not needed."""
        passed = fmod(time, self.period)
        leg = bisect_right(self.times, passed) - 1
        begin, end = self.poses[leg], self.poses[(leg + 1) % len(self.poses)]
        until = (*self.times, self.period)[leg + 1]
        twist = twist_between(begin, end, until - self.times[leg])
        return moved(begin, twist, passed - self.times[leg]), twist


@dataclass(frozen=True)
class Follow:
    """Carried by another object, where it stands relative to it at the start.

    loop: how it moves relative to the other, in the frame of whose pose; None: not at all.
    """

    name: str
    loop: Loop | None = None


Motion = Steady | Loop | Follow


def carried(leader: State, inner: State) -> State:
    """Return the state of what has the state ``inner`` in the frame of a leader."""
    place, twist = leader
    pose = compose(place, inner[0])
    arm = (pose[0] - place[0], pose[1] - place[1], pose[2] - place[2])
    parts = zip(twist[:3], _cross(twist[3:], arm), rotate(place[3:], inner[1][:3]), strict=True)
    x, y, z = (sum(part) for part in parts)
    turn = rotate(place[3:], inner[1][3:])
    return pose, (x, y, z, twist[3] + turn[0], twist[4] + turn[1], twist[5] + turn[2])


def moved(pose: Pose, twist: Twist, seconds: float) -> Pose:
    """Return where a steady twist takes a pose."""
    x, y, z = (a + v * seconds for a, v in zip(pose[:3], twist[:3], strict=True))
    if twist[3:] == (0.0, 0.0, 0.0):
        return (x, y, z, *pose[3:])
    rate = sqrt(sum(w * w for w in twist[3:]))
    half = 0.5 * rate * seconds
    share = sin(half) / rate
    turn = (twist[3] * share, twist[4] * share, twist[5] * share, cos(half))
    return (x, y, z, *multiply(turn, pose[3:]))


def twist_between(begin: Pose, end: Pose, seconds: float) -> Twist:
    """Return the steady twist from a pose to another, turning the shorter way."""
    linear = [(b - a) / seconds for a, b in zip(begin[:3], end[:3], strict=True)]
    x, y, z, w = multiply(end[3:], _conjugate(begin[3:]))
    sign = -1.0 if w < 0.0 else 1.0
    length = sqrt(x * x + y * y + z * z)
    rate = 2.0 * atan2(length, abs(w)) / (length * seconds) * sign if length > 0.0 else 0.0
    return (linear[0], linear[1], linear[2], rate * x, rate * y, rate * z)


def compose(outer: Pose, inner: Pose) -> Pose:
    """Return ``inner``, given in the frame ``outer``, in the frame ``outer`` is given in."""
    x, y, z = rotate(outer[3:], inner[:3])
    return (outer[0] + x, outer[1] + y, outer[2] + z, *multiply(outer[3:], inner[3:]))


def inverse(pose: Pose) -> Pose:
    """Return the pose that undoes a pose."""
    back = _conjugate(pose[3:])
    x, y, z = rotate(back, pose[:3])
    return (-x, -y, -z, *back)


def rotate(quaternion: Quaternion, vector: Place) -> Place:
    """Return a vector turned by a unit quaternion."""
    axis, w = quaternion[:3], quaternion[3]
    once = _cross(axis, vector)
    twice = _cross(axis, once)
    x, y, z = (v + 2.0 * (w * a + b) for v, a, b in zip(vector, once, twice, strict=True))
    return (x, y, z)


def multiply(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the unit quaternion of turning by b, then by a."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return unit(
        (
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
            aw * bw - ax * bx - ay * by - az * bz,
        )
    )


def unit(quaternion: Sequence[float]) -> Quaternion:
    """Return a quaternion of length 1; ZeroDivisionError for one of length 0."""
    largest = max(abs(part) for part in quaternion)
    x, y, z, w = (part / largest for part in quaternion)
    length = sqrt(x * x + y * y + z * z + w * w)
    return (x / length, y / length, z / length, w / length)


def from_rpy(roll: float, pitch: float, yaw: float) -> Quaternion:
    """Return the quaternion of turns about the fixed axes x, then y, then z (ROS REP 103)."""
    about_x = (sin(roll / 2), 0.0, 0.0, cos(roll / 2))
    about_y = (0.0, sin(pitch / 2), 0.0, cos(pitch / 2))
    about_z = (0.0, 0.0, sin(yaw / 2), cos(yaw / 2))
    return multiply(about_z, multiply(about_y, about_x))


def _conjugate(quaternion: Quaternion) -> Quaternion:
    x, y, z, w = quaternion
    return (-x, -y, -z, w)


def _cross(a: Place, b: Place) -> Place:
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])

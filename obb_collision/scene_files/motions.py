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

"""The key ``motion`` of an object: a twist, waypoints, or the object it follows."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise

import numpy as np

from obb_collision.geometry.poses import Pose, Quaternion
from obb_collision.scene_files.description import SceneObject
from obb_collision.scene_files.errors import Problems
from obb_collision.scene_files.places import check_angles, from_rpy, quaternion_of, unit
from obb_collision.scene_files.simulate.motion import Follow, Loop, Motion, Steady
from obb_collision.scene_files.yaml_values import Value

#: Metres, m/s and rad/s: limits of what moves, far from where sums overflow.
MAX_MOVING = 1e9
#: Seconds per round, minimum and maximum.
MIN_PERIOD, MAX_PERIOD = 1e-3, 1e9
#: Maximum length of a chain of objects that follow one another.
MAX_CHAIN = 50
#: The key that identifies a kind of motion, and all its keys.
KINDS = {
    "follow": ("follow", "waypoints", "period"),
    "waypoints": ("waypoints", "period"),
    "twist": ("twist", "period"),
}


def read_motion(value: Value, turn: Quaternion) -> Motion:
    """Return a motion; turn: the orientation of the object, for waypoints without one."""
    fields = value.fields(("twist", "waypoints", "follow", "period"))
    kind = next((kind for kind in KINDS if kind in fields), None)
    if kind is None:
        value.expected("a mapping with twist, waypoints or follow")
    for key in fields:
        if key not in KINDS[kind]:
            fields[key].refuse(f"a motion by {kind} has no {key}")
    period = read_period(fields["period"]) if "period" in fields else None
    if kind == "twist":
        x, y, z, about_x, about_y, about_z = _within(fields["twist"], 6)
        return Steady((x, y, z, about_x, about_y, about_z), period)
    loop = None
    if "waypoints" in fields:
        if period is None:
            value.refuse("needs period, the seconds of one round")
        loop = _read_loop(fields["waypoints"], turn, period)
    elif period is not None:
        fields["period"].refuse("without waypoints there is no round")
    if "follow" in fields:
        return Follow(fields["follow"].text("the name of an object"), loop)
    assert loop is not None
    return loop


def _read_loop(value: Value, turn: Quaternion, period: float) -> Loop:
    points = value.items()
    if len(points) < 2:
        value.expected("at least 2 waypoints")
    read = [_read_waypoint(point, turn) for point in points]
    times = read_times(value, [time for _, time in read], period)
    loop = Loop(tuple(pose for pose, _ in read), times, period)
    for time, speed in zip(times, np.abs(loop.twists).max(axis=1), strict=True):
        if not speed <= MAX_MOVING:
            value.refuse(f"from {time:g} s on it moves at more than {MAX_MOVING:g} m/s or rad/s")
    return loop


def read_times(value: Value, given: Sequence[float | None], period: float) -> tuple[float, ...]:
    """Return the times of waypoints, evenly spaced where none are given."""
    times = [time for time in given if time is not None]
    if not times:
        times = [period * k / len(given) for k in range(len(given))]
    elif len(times) < len(given):
        value.refuse("all waypoints need a time, or none")
    ascending = all(a < b for a, b in pairwise([*times, period]))
    if times[0] != 0.0 or not ascending:
        value.refuse(f"times must ascend from 0 and stay below the period {period:g}, got {times}")
    return tuple(times)


def _read_waypoint(value: Value, turn: Quaternion) -> tuple[Pose, float | None]:
    """Return pose and time of [x, y, z], [x, y, z, yaw] or a mapping."""
    if value.is_mapping:
        fields = value.fields(("position", "rpy", "quaternion", "time"), ("position",))
        x, y, z = _within(fields["position"], 3)
        time = fields["time"].not_negative() if "time" in fields else None
        return (x, y, z, *unit(quaternion_of(fields, turn))), time
    if value.is_list and len(value.items()) == 4:
        x, y, z, yaw = _within(value, 4)
        check_angles(value, yaw)
        return (x, y, z, *from_rpy(0.0, 0.0, yaw)), None
    if not value.is_list:
        value.expected("[x, y, z], [x, y, z, yaw], or a mapping with position")
    x, y, z = _within(value, 3)
    return (x, y, z, *unit(turn)), None


def read_period(value: Value) -> float:
    """Return the seconds of one round."""
    return value.number(
        f"seconds from {MIN_PERIOD:g} to {MAX_PERIOD:g}", lambda x: MIN_PERIOD <= x <= MAX_PERIOD
    )


def _within(value: Value, count: int) -> tuple[float, ...]:
    """Return numbers of what moves."""
    numbers = value.numbers(count)
    if max(map(abs, numbers)) > MAX_MOVING:
        value.expected(f"{count} numbers up to {MAX_MOVING:g}")
    return numbers


def check_followers(
    objects: Sequence[SceneObject],
    named: Collection[str],
    motions: Mapping[str, Value],
    problems: Problems,
) -> None:
    """Refuse objects that follow none, or, along a chain, themselves or too many.

    named: all objects that there are, with those that are refused already.
    """
    leaders = {o.name: o.motion.name for o in objects if isinstance(o.motion, Follow)}
    circling: set[str] = set()
    for name, leader in leaders.items():
        with problems.kept():
            if leader not in named:
                motions[name].refuse(f"follows {leader}, which is no object here")
            passed = [name]
            while passed[-1] in leaders and len(passed) <= MAX_CHAIN:
                passed.append(leaders[passed[-1]])
                if passed[-1] == name and name not in circling:
                    circling.update(passed)
                    motions[name].refuse(f"follows itself: {' > '.join(passed)}")
                if passed[-1] in passed[:-1]:
                    break  # reported for another one in the circle
            if len(passed) > MAX_CHAIN:
                motions[name].refuse(f"follows more than {MAX_CHAIN} others in a row")

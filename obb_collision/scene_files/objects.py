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

"""Objects of a scene file: name, shape, place, motion, and properties of their own."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise
from math import pi
from typing import Any

import numpy as np

from obb_collision import shapes
from obb_collision.accuracy import ALL_LEVELS, Accuracy, as_accuracy
from obb_collision.geometry.poses import Pose, Quaternion, quaternion_from_rpy, unit_quaternions
from obb_collision.geometry.shapes.primitives import NO_SCALE, Triple
from obb_collision.geometry.validation import is_far_from_unit
from obb_collision.scene_files.description import Color, SceneDescription, SceneObject
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.motion import Follow, Loop, Motion, Steady
from obb_collision.scene_files.yaml_values import Problems, Reader, Value

NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)
#: Maximum angle (rad): a full turn, and what rounding it to 6.3 adds. More must be degrees.
MAX_ANGLE = 6.3


def quaternion_of(fields: dict[str, Value], default: Quaternion = NO_TURN) -> Quaternion:
    """Return the quaternion of the keys ``rpy`` (radians) or ``quaternion`` (x y z w).

    One of about length 1 is returned as it is. Others, except zero, are normalised, with a note.
    """
    if "quaternion" in fields and "rpy" in fields:
        fields["rpy"].refuse("give either rpy or a quaternion, not both")
    if "rpy" in fields:
        angles = fields["rpy"].numbers(3)
        check_angles(fields["rpy"], *angles)
        return quaternion_from_rpy(*angles)
    if "quaternion" not in fields:
        return default
    numbers = fields["quaternion"].numbers(4)
    if not any(numbers):
        fields["quaternion"].refuse("must not be zero: without a rotation it is [0, 0, 0, 1]")
    return settled(fields["quaternion"], numbers)


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
    return tuple(unit_quaternions(quaternion).tolist())


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
        return Steady(_within(fields["twist"], 6), period)
    loop = None
    if "waypoints" in fields:
        if period is None:
            value.refuse("needs period, the time of one round in seconds")
        loop = _read_loop(fields["waypoints"], turn, period)
    elif period is not None:
        fields["period"].refuse("has no effect without waypoints")
    if "follow" in fields:
        return Follow(fields["follow"].text("the name of an object"), loop)
    assert loop is not None
    return loop


def _read_loop(value: Value, turn: Quaternion, period: float) -> Loop:
    read = [_read_waypoint(point, turn) for point in value.several("waypoints")]
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
        value.refuse("give a time to all waypoints or to none")
    ascending = all(a < b for a, b in pairwise([*times, period]))
    if times[0] != 0.0 or not ascending:
        value.refuse(f"times must ascend from 0 and stay below the period {period:g}, got {times}")
    return tuple(times)


def _read_waypoint(value: Value, turn: Quaternion) -> tuple[Pose, float | None]:
    """Return pose and time of [x, y, z], [x, y, z, yaw] or a mapping."""
    if value.is_mapping:
        fields = value.fields(("position", "rpy", "quaternion", "time"), ("position",))
        place = _within(fields["position"], 3)
        time = fields["time"].not_negative() if "time" in fields else None
        return (*place, *unit(quaternion_of(fields, turn))), time
    if value.is_list and len(value.items()) == 4:
        x, y, z, yaw = _within(value, 4)
        check_angles(value, yaw)
        return (x, y, z, *quaternion_from_rpy(0.0, 0.0, yaw)), None
    if not value.is_list:
        value.expected("[x, y, z], [x, y, z, yaw], or a mapping with position")
    return (*_within(value, 3), *unit(turn)), None


def read_period(value: Value) -> float:
    """Return the seconds of one round."""
    return value.number(
        f"seconds from {MIN_PERIOD:g} to {MAX_PERIOD:g}", lambda x: MIN_PERIOD <= x <= MAX_PERIOD
    )


def _within(value: Value, count: int) -> tuple[Any, ...]:
    """Return numbers of what moves."""
    numbers = value.numbers(count)
    if max(map(abs, numbers)) > MAX_MOVING:
        value.expected(f"{count} numbers up to {MAX_MOVING:g}")
    return numbers


def check_followers(
    objects: Sequence[SceneObject],
    named: Collection[str],
    values: Mapping[str, Value],
    problems: Problems,
) -> None:
    """Refuse objects that follow none, or, along a chain, themselves or too many.

    named: all objects that there are, with those that are refused already; values: by name.
    """
    leaders = {o.name: o.motion.name for o in objects if isinstance(o.motion, Follow)}
    circling: set[str] = set()
    for name, leader in leaders.items():
        with problems.kept():
            motion = values[name].peek("motion") or values[name]
            if leader not in named:
                motion.refuse(f"follows {leader}, which is not an object here")
            passed = [name]
            while passed[-1] in leaders and len(passed) <= MAX_CHAIN:
                passed.append(leaders[passed[-1]])
                if passed[-1] == name and name not in circling:
                    circling.update(passed)
                    motion.refuse(f"follows itself: {' > '.join(passed)}")
                if passed[-1] in passed[:-1]:
                    break  # reported for another one in the circle
            if len(passed) > MAX_CHAIN:
                motion.refuse(f"follows a chain of more than {MAX_CHAIN} objects")


Fields = dict[str, Value]

TURNED: dict[str, Reader] = {"radius": Value.positive, "length": Value.positive}
#: What makes a shape of its sizes, all required, their keys, and what reads them; a mesh is read
#: from its file.
SHAPES: dict[str, tuple[Callable[..., shapes.Shape], dict[str, Reader]]] = {
    "box": (shapes.Box.trusted, {"size": Value.sizes}),
    "sphere": (shapes.Sphere, {"radius": Value.positive}),
    "ellipsoid": (shapes.Ellipsoid, {"radii": Value.sizes}),
    "cylinder": (shapes.Cylinder, TURNED),
    "cone": (shapes.Cone, TURNED),
    "capsule": (shapes.Capsule, TURNED),
    "hull": (shapes.Hull, {"points": lambda value: _read_points(value)}),
    "mesh": (shapes.Mesh.from_file, {"file": lambda value: value}),
}
#: Properties of an object itself.
OWN: dict[str, Reader] = {
    "padding": Value.not_negative,
    "accuracy": lambda value: read_accuracy(value),
    "color": lambda value: _read_color(value),
}
KEYS = ("name", "shape", "position", "rpy", "quaternion", "scale", "motion", *OWN)
ORIGIN: Triple = (0.0, 0.0, 0.0)
#: Characters of patterns; in a name they would match something else.
PATTERN_LETTERS = "*?[]"


def read_objects(
    values: list[Value], files: MeshFiles, problems: Problems
) -> tuple[list[SceneObject], dict[str, None]]:
    """Return the objects, and the names of all, in their order, with those that cannot be used.

    The latter are problems; a rule about one of them is not another problem.
    """
    objects: list[SceneObject] = []
    named: dict[str, None] = {}
    used: dict[str, Value] = {}
    for value in values:
        name = value.peek("name")
        if name is not None and isinstance(name.node.value, str):
            named[name.node.value] = None
        with problems.kept():
            thing = _read_object(value, files)
            if used.setdefault(thing.name, value) is not value:
                first = f"first in line {used[thing.name].line}"
                (name or value).refuse(f"the name {thing.name} stands twice, {first}")
            objects.append(thing)
    check_followers(objects, named, used, problems)
    return (objects if problems.found else _placed(objects)), named


def read_accuracy(value: Value) -> Accuracy:
    """Return a level by its name."""
    word = value.text(f"one of {', '.join(ALL_LEVELS)}")
    try:
        return as_accuracy(word)
    except ValueError as error:
        value.refuse(str(error).removeprefix("accuracy "))


def _read_object(value: Value, files: MeshFiles) -> SceneObject:
    kind = value.peek("shape")
    if kind is None:
        sizes = [key for _, keys in SHAPES.values() for key in keys]
        value.fields((*KEYS, *sizes), ("name", "shape"))  # says what is missing
        value.refuse("needs shape")
    word = kind.choice(SHAPES)
    make, readers = SHAPES[word]
    fields = value.fields((*KEYS, *readers), ("name", "shape", *readers))
    name = fields["name"].text("a name")
    if any(letter in PATTERN_LETTERS for letter in name):
        fields["name"].refuse(f"must not hold any of {PATTERN_LETTERS}, got {name}")
    pose, motion = _read_place(fields)
    scale = read_scale(fields["scale"]) if "scale" in fields else NO_SCALE
    with value.reasons():
        given = {key: read(fields[key]) for key, read in readers.items()}
        shape = files.mesh(given["file"], scale) if word == "mesh" else make(**given, scale=scale)
        _ = shape.local_box  # fitted here, where a shape that has none can be refused
    own = {key: read(fields[key]) for key, read in OWN.items() if key in fields}
    return SceneObject(name, shape, pose, motion=motion, **own)


def _read_place(fields: Fields) -> tuple[Pose, Motion | None]:
    turn = quaternion_of(fields)
    motion = read_motion(fields["motion"], turn) if "motion" in fields else None
    loop = motion.loop if isinstance(motion, Follow) else motion
    if isinstance(loop, Loop):
        if "position" in fields:
            fields["position"].refuse("the waypoints of the motion say where it is")
        return loop.poses[0], motion
    place = fields["position"].triple() if "position" in fields else ORIGIN
    if motion is not None and max(map(abs, place)) > MAX_MOVING:
        fields["position"].refuse(f"a moving object must stay within {MAX_MOVING:g} m")
    return (*place, *turn), motion


def _read_points(value: Value) -> list[Triple]:
    points = [point.triple() for point in value.items()]
    if not points:
        value.expected("points [x, y, z], at least one")
    return points


def _read_color(value: Value) -> Color:
    """Return a colour of red, green, blue and, where it is not 1, opacity."""
    count = 4 if value.is_list and len(value.items()) == 4 else 3
    parts = value.numbers(count)
    if not all(0.0 <= part <= 1.0 for part in parts):
        value.expected("3 or 4 numbers from 0 to 1")
    return (*parts, 1.0)[:4]


def read_scale(value: Value) -> Triple:
    """Return a scale: one positive number, or three."""
    if value.is_list:
        return value.sizes()
    number = value.positive()
    return number, number, number


def _placed(objects: list[SceneObject]) -> list[SceneObject]:
    """Return the objects with the start poses of those that move relative to others."""
    poses, _ = SceneDescription("", tuple(objects)).states(0.0)
    return [
        replace(thing, pose=tuple(pose))
        if isinstance(thing.motion, Follow) and thing.motion.loop is not None
        else thing
        for thing, pose in zip(objects, poses.tolist(), strict=True)
    ]

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

"""The objects of a scene file: name, shape, pose, and what is particular to each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from obb_collision.geometry.shapes import (
    Box,
    Capsule,
    Cone,
    Cylinder,
    Ellipsoid,
    Hull,
    Mesh,
    Shape,
    Sphere,
)
from obb_collision.queries.accuracy import ALL_RUNGS, Accuracy, as_accuracy
from obb_collision.scene.files.description import Color, SceneDescription, SceneObject, Triple
from obb_collision.scene.files.errors import Problems
from obb_collision.scene.files.motion import Follow, Loop, Motion, Pose
from obb_collision.scene.files.motions import read_motion
from obb_collision.scene.files.places import quaternion_of
from obb_collision.scene.files.values import Value

Fields = dict[str, Value]

#: Keys that say how large a shape is, all of them needed.
SIZES = {
    "box": ("size",),
    "sphere": ("radius",),
    "ellipsoid": ("radii",),
    "cylinder": ("radius", "length"),
    "cone": ("radius", "length"),
    "capsule": ("radius", "length"),
    "hull": ("points",),
    "mesh": ("file",),
}
ALL_SIZES = frozenset(key for keys in SIZES.values() for key in keys)
KEYS = (
    *("name", "shape", "position", "rpy", "quaternion", "scale"),
    *("padding", "accuracy", "color", "motion"),
)
TURNED: dict[str, Callable[..., Shape]] = {"cylinder": Cylinder, "cone": Cone, "capsule": Capsule}
#: What patterns are made of; in a name they would match something else.
PATTERN_LETTERS = "*?[]"
NO_SCALE: Triple = (1.0, 1.0, 1.0)


def read_objects(values: list[Value], folder: Path, problems: Problems) -> list[SceneObject]:
    """Return the objects; those that can't be used are problems, then the list is not complete."""
    objects: list[SceneObject] = []
    lines: dict[str, int] = {}
    meshes: dict[tuple[str, Triple], Mesh] = {}
    motions: dict[str, Value] = {}
    for value in values:
        with problems.kept():
            thing = _read_object(value, folder, meshes)
            if thing.name in lines:
                first = f"the name {thing.name} stands twice, first in line {lines[thing.name]}"
                (value.peek("name") or value).refuse(first)
            lines[thing.name] = value.line
            objects.append(thing)
            if thing.motion is not None:
                motions[thing.name] = value.peek("motion") or value
    _check_followers(objects, motions, problems)
    return objects if problems.found else _placed(objects)


def read_accuracy(value: Value) -> Accuracy:
    """Return a rung by its name."""
    return as_accuracy(value.choice(ALL_RUNGS))


def _read_object(value: Value, folder: Path, meshes: dict[tuple[str, Triple], Mesh]) -> SceneObject:
    kind = value.peek("shape")
    if kind is None:
        value.fields((*KEYS, *ALL_SIZES), ("name", "shape"))  # says what is missing
        value.refuse("needs shape")
    word = kind.choice(tuple(SIZES))
    sizes = SIZES[word]
    fields = value.fields((*KEYS, *sizes), ("name", "shape", *sizes))
    name = fields["name"].text("a name")
    if any(letter in PATTERN_LETTERS for letter in name):
        fields["name"].refuse(f"must not hold any of {PATTERN_LETTERS}, got {name}")
    pose, motion = _read_place(fields)
    with value.reasons():
        shape = _read_shape(word, fields, folder, meshes)
        _ = shape.local_box  # fitted here, where a shape that has none can be refused
    return SceneObject(
        name,
        shape,
        pose,
        padding=fields["padding"].not_negative() if "padding" in fields else None,
        accuracy=read_accuracy(fields["accuracy"]) if "accuracy" in fields else None,
        color=_read_color(fields["color"]) if "color" in fields else None,
        motion=motion,
    )


def _read_place(fields: Fields) -> tuple[Pose, Motion | None]:
    turn = quaternion_of(fields)
    motion = read_motion(fields["motion"], turn) if "motion" in fields else None
    loop = motion.loop if isinstance(motion, Follow) else motion
    if isinstance(loop, Loop):
        if "position" in fields:
            fields["position"].refuse("the waypoints of the motion say where it is")
        return loop.poses[0], motion
    x, y, z = fields["position"].numbers(3) if "position" in fields else (0.0, 0.0, 0.0)
    return (x, y, z, *turn), motion


def _read_shape(
    word: str, fields: Fields, folder: Path, meshes: dict[tuple[str, Triple], Mesh]
) -> Shape:
    scale = _read_scale(fields["scale"]) if "scale" in fields else NO_SCALE
    if word == "box":
        return Box(fields["size"].numbers(3, positive=True), scale)
    if word == "sphere":
        return Sphere(fields["radius"].positive(), scale)
    if word == "ellipsoid":
        return Ellipsoid(fields["radii"].numbers(3, positive=True), scale)
    if word in TURNED:
        return TURNED[word](fields["radius"].positive(), fields["length"].positive(), scale)
    if word == "hull":
        points = [point.numbers(3) for point in fields["points"].items()]
        if not points:
            fields["points"].expected("points [x, y, z], at least one")
        return Hull(points, scale)
    file = fields["file"].text("a path or a file:// or package:// URI")
    key = (file, scale)
    if key not in meshes:
        with fields["file"].reasons():
            path = file if "://" in file else folder / file
            meshes[key] = Mesh.from_file(path, scale)
    return meshes[key]


def _read_color(value: Value) -> Color:
    """Return a colour of red, green, blue and, where it is not 1, opacity."""
    count = 4 if value.is_list and len(value.items()) == 4 else 3
    parts = value.numbers(count)
    if not all(0.0 <= part <= 1.0 for part in parts):
        value.expected("3 or 4 numbers from 0 to 1")
    red, green, blue, opacity = (*parts, 1.0)[:4]
    return red, green, blue, opacity


def _read_scale(value: Value) -> Triple:
    if value.is_list:
        x, y, z = value.numbers(3, positive=True)
        return x, y, z
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


def _check_followers(
    objects: list[SceneObject], motions: dict[str, Value], problems: Problems
) -> None:
    """Refuse who follows nobody, or, along a chain, itself."""
    things = {thing.name: thing for thing in objects}
    for thing in objects:
        passed = [thing.name]
        motion = thing.motion
        with problems.kept():
            while isinstance(motion, Follow):
                if motion.name not in things:
                    reason = f"follows {motion.name}, which is no object here"
                    motions[passed[-1]].refuse(reason)
                if motion.name in passed:
                    motions[thing.name].refuse(f"follows itself: {' > '.join(passed)}")
                passed.append(motion.name)
                motion = things[motion.name].motion

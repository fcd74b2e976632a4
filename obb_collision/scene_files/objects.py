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

"""The objects of a scene file: name, shape, pose, and properties of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from obb_collision import shapes
from obb_collision.accuracy import ALL_LEVELS, Accuracy, as_accuracy
from obb_collision.geometry.poses import Pose
from obb_collision.scene_files.description import Color, SceneDescription, SceneObject, Triple
from obb_collision.scene_files.errors import Problems
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.motions import MAX_MOVING, check_followers, read_motion
from obb_collision.scene_files.places import quaternion_of
from obb_collision.scene_files.simulate.motion import Follow, Loop, Motion
from obb_collision.scene_files.yaml_values import Value

Fields = dict[str, Value]

#: Keys for the size of a shape, all required.
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
TURNED: dict[str, Callable[..., shapes.Shape]] = {
    "cylinder": shapes.Cylinder,
    "cone": shapes.Cone,
    "capsule": shapes.Capsule,
}
#: Characters of patterns; in a name they would match something else.
PATTERN_LETTERS = "*?[]"
NO_SCALE: Triple = (1.0, 1.0, 1.0)


def read_objects(
    values: list[Value], files: MeshFiles, problems: Problems
) -> tuple[list[SceneObject], dict[str, None]]:
    """Return the objects, and the names of all, in their order, with those that cannot be used.

    The latter are problems; a rule about one of them is not another problem.
    """
    objects: list[SceneObject] = []
    named: dict[str, None] = {}
    lines: dict[str, int] = {}
    motions: dict[str, Value] = {}
    for value in values:
        name = value.peek("name")
        if name is not None and isinstance(name.node.value, str):
            named[name.node.value] = None
        with problems.kept():
            thing = _read_object(value, files)
            if thing.name in lines:
                first = f"the name {thing.name} stands twice, first in line {lines[thing.name]}"
                (name or value).refuse(first)
            lines[thing.name] = value.line
            objects.append(thing)
            if thing.motion is not None:
                motions[thing.name] = value.peek("motion") or value
    check_followers(objects, named, motions, problems)
    return (objects if problems.found else _placed(objects)), named


def read_accuracy(value: Value) -> Accuracy:
    """Return a level by its name."""
    return as_accuracy(value.choice(ALL_LEVELS))


def _read_object(value: Value, files: MeshFiles) -> SceneObject:
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
        shape = _read_shape(word, fields, files)
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
    if motion is not None and max(abs(x), abs(y), abs(z)) > MAX_MOVING:
        fields["position"].refuse(f"what moves must be within {MAX_MOVING:g} m")
    return (x, y, z, *turn), motion


def _read_shape(word: str, fields: Fields, files: MeshFiles) -> shapes.Shape:
    scale = read_scale(fields["scale"]) if "scale" in fields else NO_SCALE
    if word == "box":
        x, y, z = fields["size"].numbers(3, positive=True)
        return shapes.Box.trusted((x, y, z), scale)
    if word == "sphere":
        return shapes.Sphere(fields["radius"].positive(), scale)
    if word == "ellipsoid":
        return shapes.Ellipsoid(fields["radii"].numbers(3, positive=True), scale)
    if word in TURNED:
        return TURNED[word](fields["radius"].positive(), fields["length"].positive(), scale)
    if word == "hull":
        points = [point.numbers(3) for point in fields["points"].items()]
        if not points:
            fields["points"].expected("points [x, y, z], at least one")
        return shapes.Hull(points, scale)
    return files.mesh(fields["file"], scale)


def _read_color(value: Value) -> Color:
    """Return a colour of red, green, blue and, where it is not 1, opacity."""
    count = 4 if value.is_list and len(value.items()) == 4 else 3
    parts = value.numbers(count)
    if not all(0.0 <= part <= 1.0 for part in parts):
        value.expected("3 or 4 numbers from 0 to 1")
    red, green, blue, opacity = (*parts, 1.0)[:4]
    return red, green, blue, opacity


def read_scale(value: Value) -> Triple:
    """Return a scale: one positive number, or three."""
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

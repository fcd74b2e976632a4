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

"""Objects of a scene file: name, shape, place, and properties of their own."""

from __future__ import annotations

from collections.abc import Callable
from math import hypot, pi

from obb_collision import shapes
from obb_collision.accuracy import ALL_LEVELS, Accuracy, as_accuracy
from obb_collision.geometry.poses import Quaternion, quaternion_from_rpy, unit_quaternions
from obb_collision.geometry.shapes.primitives import NO_SCALE, Triple
from obb_collision.geometry.validation import UNIT_TOLERANCE
from obb_collision.scene_files.description import Color, SceneObject
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.yaml_values import Problems, Reader, Value

NO_TURN: Quaternion = (0.0, 0.0, 0.0, 1.0)
#: Maximum angle (rad): a full turn, and what rounding it to 6.3 adds. More must be degrees.
MAX_ANGLE = 6.3


def quaternion_of(fields: dict[str, Value]) -> Quaternion:
    """Return the quaternion of the keys ``rpy`` (radians) or ``quaternion`` (x y z w).

    A quaternion of about length 1 is returned unchanged. Others are normalised, with a note, or
    refused if they are zero.
    """
    if "quaternion" in fields and "rpy" in fields:
        fields["rpy"].refuse("give either rpy or a quaternion, not both")
    if "rpy" in fields:
        angles = fields["rpy"].numbers(3)
        check_angles(fields["rpy"], *angles)
        return quaternion_from_rpy(*angles)
    if "quaternion" not in fields:
        return NO_TURN
    numbers = fields["quaternion"].numbers(4)
    if not any(numbers):
        fields["quaternion"].refuse("must not be zero: without a rotation it is [0, 0, 0, 1]")
    return settled(fields["quaternion"], numbers)


def check_angles(value: Value, *angles: float) -> None:
    """Refuse angles that are too large for radians."""
    largest = max(abs(angle) for angle in angles)
    if largest > MAX_ANGLE:
        hint = f"{largest:g} degrees are {largest * pi / 180.0:.6g}"
        value.refuse(f"angles are in radians, at most a turn; {hint}, got {value.shown()}")


def settled(value: Value, quaternion: Quaternion) -> Quaternion:
    """Return a quaternion; one far from length 1 is normalised, with a note."""
    if abs(hypot(*quaternion) - 1.0) <= UNIT_TOLERANCE:
        return quaternion
    value.doubt(f"a quaternion far from unit length, taken as normalised, got {value.shown()}")
    return unit(quaternion)


def unit(quaternion: Quaternion) -> Quaternion:
    """Return a quaternion of length 1."""
    return tuple(unit_quaternions(quaternion).tolist())


TURNED: dict[str, Reader] = {"radius": Value.positive, "length": Value.positive}
#: The constructor of each shape, and its required keys with their readers; a mesh has a file.
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
#: Properties of an object that override those of the scene.
OWN: dict[str, Reader] = {
    "padding": Value.not_negative,
    "accuracy": lambda value: read_accuracy(value),
    "color": lambda value: _read_color(value),
}
KEYS = ("name", "shape", "position", "rpy", "quaternion", "scale", *OWN)
ORIGIN: Triple = (0.0, 0.0, 0.0)
#: Characters of patterns, which names must not contain.
PATTERN_LETTERS = "*?[]"


def read_objects(
    values: list[Value], files: MeshFiles, problems: Problems
) -> tuple[list[SceneObject], dict[str, None]]:
    """Return the valid objects, and the names of all objects in their order.

    Invalid objects are problems; a rule that names one of them is not another problem.
    """
    objects: list[SceneObject] = []
    named: dict[str, None] = {}
    used: dict[str, Value] = {}
    for value in values:
        name = value.peek("name")
        if name is not None and isinstance(name.node.value, str):
            named[name.node.value] = None
        with problems.kept():
            obj = _read_object(value, files)
            if used.setdefault(obj.name, value) is not value:
                first = f"first in line {used[obj.name].line}"
                (name or value).refuse(f"the name {obj.name} stands twice, {first}")
            objects.append(obj)
    return objects, named


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
        value.fields((*KEYS, *sizes), ("name", "shape"))  # refuses missing keys
        value.refuse("needs shape")
    word = kind.choice(SHAPES)
    make, readers = SHAPES[word]
    fields = value.fields((*KEYS, *readers), ("name", "shape", *readers))
    name = fields["name"].text("a name")
    if any(letter in PATTERN_LETTERS for letter in name):
        fields["name"].refuse(f"must not hold any of {PATTERN_LETTERS}, got {name}")
    place = fields["position"].triple() if "position" in fields else ORIGIN
    pose = (*place, *quaternion_of(fields))
    scale = read_scale(fields["scale"]) if "scale" in fields else NO_SCALE
    with value.reasons():
        own = {key: read(fields[key]) for key, read in readers.items()}
        shape = files.mesh(own["file"], scale) if word == "mesh" else make(**own, scale=scale)
        _ = shape.local_box  # fitted here, where a shape without a box can be refused
    own = {key: read(fields[key]) for key, read in OWN.items() if key in fields}
    return SceneObject(name, shape, pose, **own)


def _read_points(value: Value) -> list[Triple]:
    points = [point.triple() for point in value.items()]
    if not points:
        value.expected("points [x, y, z], at least one")
    return points


def _read_color(value: Value) -> Color:
    """Return red, green, blue and opacity, which is 1 if it is left out."""
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

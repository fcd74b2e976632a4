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

"""MoveIt planning scenes as YAML: the fields of ``moveit_msgs/PlanningScene``.

Vectors may be lists or mappings (x, y, z, w). The collision objects of the world are read, attached
ones whose pose is in the file, the allowed collision matrix and colours. Such a file has only the
name of the robot; notes say what is ignored for this reason.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

from obb_collision.geometry.poses import IDENTITY, Pose, Quaternion, compose_poses
from obb_collision.geometry.shapes.primitives import NO_SCALE
from obb_collision.scene_files.description import AllowedRule, Color, SceneDescription, SceneObject
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.objects import NO_TURN, read_scale, settled
from obb_collision.scene_files.yaml_values import Reader, Value, items_of
from obb_collision.shapes import Box, Cone, Cylinder, Mesh, Shape, Sphere
from obb_collision.words import printable

MATRIX_KEYS = ("entry_names", "entry_values", "default_entry_names", "default_entry_values")


def read_matrix(value: Value) -> list[AllowedRule]:
    """Return the rules of a matrix, ordered so that the last one that matches a pair is right.

    Entries that forbid pairs that no rule allows are redundant and left out.
    """
    fields = value.fields(MATRIX_KEYS)
    defaults = _read_defaults(fields)
    rules: list[AllowedRule] = []
    for wanted in (True, False):  # where a pair has two defaults, both must allow it
        for name, allowed in defaults.items():
            if allowed == wanted and (allowed or True in defaults.values()):
                rules += [AllowedRule(pattern, "*", allowed) for pattern in patterns_of(name)]
    for (first, second), allowed in _read_entries(fields).items():
        if allowed or defaults.get(first) or defaults.get(second):
            rules += rules_between(first, second, allowed)
    return rules


def rules_between(first: str, second: str, allowed: bool) -> list[AllowedRule]:
    """Return the rules for all objects with two names of MoveIt."""
    pairs = product(patterns_of(first), patterns_of(second))
    rules = [AllowedRule(a, b, allowed) for a, b in pairs]
    if first != second:
        return rules
    return [rule for rule in rules if rule.first.endswith("/*") and rule.second.endswith("/*")]


def patterns_of(name: str) -> tuple[str, str]:
    """Return patterns for a name and for its parts ``name/...``, such as markers of a namespace."""
    exact = "".join(f"[{letter}]" if letter in "*?[" else letter for letter in name)
    return exact, f"{exact}/*"


def _read_defaults(fields: dict[str, Value]) -> dict[str, bool]:
    names = items_of(fields, "default_entry_names")
    values = items_of(fields, "default_entry_values")
    if len(names) != len(values):
        fields[next(key for key in MATRIX_KEYS[2:] if key in fields)].refuse(
            f"there are {len(names)} default_entry_names and {len(values)} default_entry_values"
        )
    return {name.text(): flag.flag() for name, flag in zip(names, values, strict=True)}


def _read_entries(fields: dict[str, Value]) -> dict[tuple[str, str], bool]:
    """Return the entry of the matrix per pair of different names."""
    names = [name.text() for name in items_of(fields, "entry_names")]
    rows = items_of(fields, "entry_values")
    if len(rows) != len(names):
        fields[next(key for key in MATRIX_KEYS[:2] if key in fields)].refuse(
            f"there are {len(names)} entry_names and {len(rows)} rows of entry_values"
        )
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        fields["entry_names"].refuse(f"{twice} stands twice")
    matrix = [_read_row(row, len(names)) for row in rows]
    entries: dict[tuple[str, str], bool] = {}
    for i, first in enumerate(names):
        for j, second in enumerate(names[:i]):
            if matrix[i][j] != matrix[j][i]:
                rows[i].refuse(f"not symmetric: {first} with {second} and the other way round")
            entries[second, first] = matrix[i][j]
    return entries


def _read_row(row: Value, count: int) -> list[bool]:
    """Return a row: a list, or the list ``enabled`` of a message."""
    cells = row.fields(("enabled",), ("enabled",))["enabled"] if row.is_mapping else row
    flags = [cell.flag() for cell in cells.items()]
    if len(flags) != count:
        cells.refuse(f"must have {count} entries, one per name, got {len(flags)}")
    return flags


OBJECT_KEYS = (
    *("header", "pose", "id", "type", "primitives", "primitive_poses", "meshes", "mesh_poses"),
    *("planes", "plane_poses", "subframe_names", "subframe_poses", "operation"),
)
#: Numbers of ``shape_msgs/SolidPrimitive``, that may stand for its types.
TYPES = {"1": "box", "2": "sphere", "3": "cylinder", "4": "cone"}
#: Number of dimensions and constructor of each primitive; in MoveIt the height is the first.
PRIMITIVES: dict[str, tuple[int, Callable[..., Shape]]] = {
    "box": (3, lambda *edges: Box(edges)),
    "sphere": (1, Sphere),
    "cylinder": (2, lambda height, radius: Cylinder(radius, height)),
    "cone": (2, lambda height, radius: Cone(radius, height)),
}
#: The operation ADD, as a number and as the byte that the message has.
ADD = ("0", "\x00")
POSES = {"primitives": "primitive_poses", "meshes": "mesh_poses"}
VECTOR, QUATERNION = ("x", "y", "z"), ("x", "y", "z", "w")


class Frames:
    """The poses of the frames of a file; one without a pose may be the frame of the scene."""

    def __init__(self) -> None:
        self._poses: dict[str, Pose] = {"": IDENTITY}
        self._own: str | None = None

    def add(self, name: str, pose: Pose | None) -> None:
        """Store the pose of a frame."""
        self._poses[name.lstrip("/")] = IDENTITY if pose is None else pose

    def of_world(self, value: Value) -> Pose:
        """Return the pose of the frame of one of the world's objects."""
        header = _frame_id(value)
        name = "" if header is None else header.label().lstrip("/")
        pose = self._poses.get(name)
        if pose is not None or header is None:
            return pose or IDENTITY
        if self._own is None:
            self._own = name  # the frame of the scene
        if name != self._own:
            header.refuse(f"the file has neither the pose of {name} nor that of {self._own}")
        return IDENTITY

    def of_link(self, value: Value, link: str) -> Pose | None:
        """Return the pose of the frame of an object fixed to a link, None if it is missing."""
        header = _frame_id(value)
        name = link if header is None else header.label()
        return self._poses.get(name.lstrip("/"))


def _frame_id(value: Value) -> Value | None:
    header = value.peek("header")
    fields = {} if header is None else header.fields(("seq", "stamp", "frame_id"))
    return fields.get("frame_id")


def read_object(value: Value, base: Pose, files: MeshFiles) -> list[SceneObject]:
    """Return the parts of an object: one by its id, several by id/0, id/1 and so on.

    base: the pose of the frame of the object; files: those of its meshes.
    """
    fields = value.fields(OBJECT_KEYS, ("id",))
    name = fields["id"].text("an id")
    if "operation" in fields and fields["operation"].node.value not in ADD:
        fields["operation"].label()
        fields["operation"].expected("0 (ADD): a file cannot remove or move objects")
    if "planes" in fields and fields["planes"].items():
        fields["planes"].refuse("a plane is infinite and has no box; use a large, flat box instead")
    shapes = _read_shapes(fields, "primitives", _read_primitive)
    shapes += _read_shapes(fields, "meshes", lambda mesh: _read_mesh(mesh, files))
    if not shapes:
        value.refuse("needs primitives or meshes")
    if "pose" in fields:
        base = composed(base, read_pose(fields["pose"]))
    # without a base, poses stay as in the file, bit for bit
    poses = [pose if base == IDENTITY else composed(base, pose) for _, pose in shapes]
    names = [name] if len(shapes) == 1 else [f"{name}/{k}" for k in range(len(shapes))]
    return [
        SceneObject(part, shape, pose)
        for part, (shape, _), pose in zip(names, shapes, poses, strict=True)
    ]


def _read_shapes(
    fields: dict[str, Value], key: str, read: Callable[[Value], Shape]
) -> list[tuple[Shape, Pose]]:
    poses_key = POSES[key]
    shapes = fields[key].items() if key in fields else []
    places = fields[poses_key].items() if poses_key in fields else []
    if places and len(places) != len(shapes):
        fields[poses_key].refuse(f"there are {len(shapes)} {key} and {len(places)} {poses_key}")
    poses = [read_pose(place) for place in places] or [IDENTITY] * len(shapes)
    placed = []
    for value, pose in zip(shapes, poses, strict=True):
        with value.reasons():
            shape = read(value)
            _ = shape.local_box
        placed.append((shape, pose))
    return placed


def _read_primitive(value: Value) -> Shape:
    fields = value.fields(("type", "dimensions", "polygon"), ("type", "dimensions"))
    word = fields["type"].text("a type").lower()
    word = TYPES.get(word, word)
    if word not in PRIMITIVES:
        fields["type"].expected(f"one of {', '.join(PRIMITIVES)}")
    count, make = PRIMITIVES[word]
    return make(*fields["dimensions"].numbers(count, positive=True))


def _read_mesh(value: Value, files: MeshFiles) -> Shape:
    """Return a mesh of a message, or of the file ``resource``, scaled by ``dimensions``.

    Scenes of MotionBenchMaker (robowflex) have ``resource``; messages of ROS do not.
    """
    if value.peek("resource") is not None:
        fields = value.fields(("resource", "dimensions"), ("resource",))
        scale = read_scale(fields["dimensions"]) if "dimensions" in fields else NO_SCALE
        return files.mesh(fields["resource"], scale)
    fields = value.fields(("triangles", "vertices"), ("triangles", "vertices"))
    vertices = [_read_vector(point, VECTOR) for point in fields["vertices"].items()]
    last = len(vertices) - 1
    faces = []
    for triangle in fields["triangles"].items():
        corners = triangle
        if triangle.is_mapping:
            corners = triangle.fields(("vertex_indices",), ("vertex_indices",))["vertex_indices"]
        if len(corners.items()) != 3:
            corners.expected("3 vertices")
        faces.append([corner.whole(0, last) for corner in corners.items()])
    return Mesh(vertices, faces)


def read_pose(value: Value) -> Pose:
    """Return a pose, or a transform, whose keys have other names.

    A quaternion of zeros is no rotation, as in MoveIt.
    """
    place = partial(_read_vector, parts=VECTOR)
    readers: dict[str, Reader] = dict.fromkeys(("position", "translation"), place)
    readers |= dict.fromkeys(("orientation", "rotation"), _read_turn)
    parts = value.read({}, readers)
    place = parts.get("translation", parts.get("position", (0.0, 0.0, 0.0)))
    return (*place, *parts.get("rotation", parts.get("orientation", NO_TURN)))


def _read_turn(value: Value) -> Quaternion:
    turn = _read_vector(value, QUATERNION)
    return settled(value, turn) if any(turn) else NO_TURN


def composed(outer: Pose, inner: Pose) -> Pose:
    """Return the pose ``inner``, which is relative to ``outer``, in the frame of ``outer``."""
    return tuple(compose_poses(outer, inner).tolist())


def _read_vector(value: Value, parts: tuple[str, ...]) -> tuple[Any, ...]:
    if not value.is_mapping:
        return value.numbers(len(parts))
    numbers = value.read(dict.fromkeys(parts, Value.number))
    return tuple(numbers[part] for part in parts)


KEYS = (
    *("name", "robot_state", "robot_model_name", "fixed_frame_transforms"),
    *("allowed_collision_matrix", "link_padding", "link_scale", "object_colors", "world"),
    "is_diff",
)
ROBOT_STATE = ("joint_state", "multi_dof_joint_state", "attached_collision_objects", "is_diff")
ATTACHED = ("link_name", "object", "touch_links", "detach_posture", "weight")
#: Keys that identify a planning scene at the top level of a file.
MARKS = ("world", "allowed_collision_matrix", "robot_state", "robot_model_name")


class PlanningScene:
    """Reads a planning scene."""

    def __init__(self, top: Value, files: MeshFiles) -> None:
        self._problems = top.problems
        self._fields = top.fields(KEYS)
        self._files = files
        self._frames = Frames()
        self._objects: list[SceneObject] = []
        self._own_rules: list[AllowedRule] = []  # of parts and attached objects, beside the matrix
        self._notes: list[str] = []
        self._used: dict[str, Value] = {}

    def description(self, path: Path) -> SceneDescription:
        """Return the description in the scene; SceneFileError with all its problems."""
        readers: dict[str, Reader] = {
            "fixed_frame_transforms": self._read_frames,
            "world": self._read_world,
            "robot_state": self._read_robot_state,
            "allowed_collision_matrix": read_matrix,
            "object_colors": self._read_colors,
            "robot_model_name": self._read_robot,
            "is_diff": self._read_diff,
            "name": Value.label,
        }
        read = self._problems.read(self._fields, readers)
        return SceneDescription(
            read.get("name") or printable(path.stem),
            tuple(self._objects),
            allowed=(*read.get("allowed_collision_matrix", ()), *self._own_rules),
            notes=(*self._problems.doubts(), *self._notes),
        )

    def _read_frames(self, value: Value) -> None:
        for item in value.items():
            with self._problems.kept():
                fields = item.fields(("header", "child_frame_id", "transform"), ("child_frame_id",))
                frame = fields["child_frame_id"].text("the name of a frame")
                self._frames.add(frame, None)  # its name is no problem if its transform is invalid
                if "transform" in fields:
                    self._frames.add(frame, read_pose(fields["transform"]))

    def _read_world(self, value: Value) -> None:
        fields = value.fields(("collision_objects", "octomap"))
        for item in items_of(fields, "collision_objects"):
            with self._problems.kept():
                self._take(item, read_object(item, self._frames.of_world(item), self._files))
        octomap = fields["octomap"].peek("octomap") if "octomap" in fields else None
        data = octomap.peek("data") if octomap is not None else None
        if data is not None and data.is_list and data.items():
            self._notes.append("the octomap is left out: it has no boxes of its own")

    def _take(self, item: Value, parts: list[SceneObject]) -> None:
        """Add the parts of an object, which may touch each other."""
        for part in parts:
            if self._used.setdefault(part.name, item) is not item:
                first = f"first in line {self._used[part.name].line}"
                (item.peek("id") or item).refuse(f"the name {part.name} stands twice, {first}")
        self._objects += parts
        if len(parts) > 1:
            name = parts[0].name.rpartition("/")[0]
            self._own_rules += rules_between(name, name, True)

    def _read_robot_state(self, value: Value) -> None:
        fields = value.fields(ROBOT_STATE)
        for item in items_of(fields, "attached_collision_objects"):
            with self._problems.kept():
                self._read_attached(item)

    def _read_attached(self, item: Value) -> None:
        """Read an attached object. It may touch the links that it names."""
        fields = item.fields(ATTACHED, ("link_name", "object"))
        link = fields["link_name"].text("the name of a link")
        base = self._frames.of_link(fields["object"], link)
        parts = read_object(fields["object"], IDENTITY if base is None else base, self._files)
        name = (fields["object"].peek("id") or item).text()
        links = [link, *(word.text() for word in items_of(fields, "touch_links"))]
        for other in dict.fromkeys(links):
            self._own_rules += rules_between(name, other, True)
        if base is None:
            reason = f"it is fixed to the robot's link {link}, which the file does not place"
            self._notes.append(f"the attached object {name} is left out: {reason}")
        else:
            self._take(fields["object"], parts)

    def _read_colors(self, value: Value) -> None:
        colors: dict[str, Color] = {}
        for item in value.items():
            with self._problems.kept():
                fields = item.fields(("id", "color"), ("id", "color"))
                parts = fields["color"].fields(("r", "g", "b", "a"), ("r", "g", "b"))
                r, g, b, a = (parts[key].number() if key in parts else 1.0 for key in "rgba")
                red, green, blue, opacity = (min(max(part, 0.0), 1.0) for part in (r, g, b, a))
                colors[fields["id"].text("an id")] = red, green, blue, opacity
        for k, obj in enumerate(self._objects):  # named by the id, or by parts of it
            color = colors.get(obj.name, colors.get(obj.name.rpartition("/")[0]))
            self._objects[k] = obj if color is None else replace(obj, color=color)

    def _read_robot(self, value: Value) -> None:
        if value.label():
            self._notes.append(
                f"the robot {value.text()} is left out: its links are in its model, not in the "
                "file; allowed pairs with them are kept"
            )

    def _read_diff(self, value: Value) -> None:
        if value.flag():
            self._notes.append("this file is a difference to a scene that it does not contain")

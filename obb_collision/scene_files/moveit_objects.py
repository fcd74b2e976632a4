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

"""Collision objects of MoveIt: ``moveit_msgs/CollisionObject`` with primitives and meshes."""

from __future__ import annotations

from collections.abc import Callable

from obb_collision.geometry.poses import Pose, compose_poses
from obb_collision.scene_files.description import SceneObject
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.objects import NO_SCALE, read_scale
from obb_collision.scene_files.places import NO_TURN, settled
from obb_collision.scene_files.yaml_values import Value
from obb_collision.shapes import Box, Cone, Cylinder, Mesh, Shape, Sphere

KEYS = (
    *("header", "pose", "id", "type", "primitives", "primitive_poses", "meshes", "mesh_poses"),
    *("planes", "plane_poses", "subframe_names", "subframe_poses", "operation"),
)
#: Numbers of ``shape_msgs/SolidPrimitive``, by which its types may be given, and its dimensions.
TYPES = {"1": "box", "2": "sphere", "3": "cylinder", "4": "cone"}
DIMENSIONS = {"box": 3, "sphere": 1, "cylinder": 2, "cone": 2}
#: The operation ADD, as a number and as the byte that the message has.
ADD = ("0", "\x00")
IDENTITY: Pose = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)
POSES = {"primitives": "primitive_poses", "meshes": "mesh_poses"}
VECTOR, QUATERNION = ("x", "y", "z"), ("x", "y", "z", "w")


class Frames:
    """The poses of the frames of a file. One without a pose may be the frame of everything."""

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
            self._own = name  # the frame that the scene is in
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

    base: the frame in which the object is given; files: those of its meshes.
    """
    fields = value.fields(KEYS, ("id",))
    name = fields["id"].text("an id")
    if "operation" in fields and fields["operation"].node.value not in ADD:
        fields["operation"].label()
        fields["operation"].expected("0 (ADD): a file can't remove or move objects")
    if "planes" in fields and fields["planes"].items():
        fields["planes"].refuse("a plane is infinite and has no box; use a large, flat box instead")
    shapes = _read_shapes(fields, "primitives", _read_primitive)
    shapes += _read_shapes(fields, "meshes", lambda mesh: _read_mesh(mesh, files))
    if not shapes:
        value.refuse("needs primitives or meshes")
    if "pose" in fields:
        base = composed(base, read_pose(fields["pose"]))
    # what is not moved stays as it is given, bit for bit
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
    return [(read(shape), pose) for shape, pose in zip(shapes, poses, strict=True)]


def _read_primitive(value: Value) -> Shape:
    fields = value.fields(("type", "dimensions", "polygon"), ("type", "dimensions"))
    word = fields["type"].text("a type").lower()
    word = TYPES.get(word, word)
    if word not in DIMENSIONS:
        fields["type"].expected(f"one of {', '.join(DIMENSIONS)}")
    sizes = fields["dimensions"].numbers(DIMENSIONS[word], positive=True)
    with value.reasons():
        if word == "box":
            shape: Shape = Box(sizes)
        elif word == "sphere":
            shape = Sphere(sizes[0])
        else:  # MoveIt names the height first
            height, radius = sizes
            shape = Cylinder(radius, height) if word == "cylinder" else Cone(radius, height)
        _ = shape.local_box
    return shape


def _read_mesh(value: Value, files: MeshFiles) -> Shape:
    """Return a mesh of a message, or of the file ``resource``, scaled by ``dimensions``.

    The latter is what MotionBenchMaker's scenes (robowflex) have; no message of ROS does.
    """
    if value.peek("resource") is not None:
        fields = value.fields(("resource", "dimensions"), ("resource",))
        scale = read_scale(fields["dimensions"]) if "dimensions" in fields else NO_SCALE
        shape = files.mesh(fields["resource"], scale)
        with value.reasons():
            _ = shape.local_box
        return shape
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
    with value.reasons():
        shape = Mesh(vertices, faces)
        _ = shape.local_box
    return shape


def read_pose(value: Value) -> Pose:
    """Return a pose, or a transform, which has other names for the same.

    A quaternion of zeros is no rotation, as in MoveIt.
    """
    keys = ("position", "orientation", "translation", "rotation")
    fields = value.fields(keys)
    place, turn = (0.0, 0.0, 0.0), NO_TURN
    for key in ("position", "translation"):
        if key in fields:
            x, y, z = _read_vector(fields[key], VECTOR)
            place = x, y, z
    for key in ("orientation", "rotation"):
        if key in fields:
            x, y, z, w = _read_vector(fields[key], QUATERNION)
            turn = settled(fields[key], (x, y, z, w)) if any((x, y, z, w)) else NO_TURN
    return (*place, *turn)


def composed(outer: Pose, inner: Pose) -> Pose:
    """Return a pose in the frame of ``outer``, given in ``outer``."""
    x, y, z, qx, qy, qz, qw = compose_poses(outer, inner).tolist()
    return x, y, z, qx, qy, qz, qw


def _read_vector(value: Value, parts: tuple[str, ...]) -> tuple[float, ...]:
    if not value.is_mapping:
        return value.numbers(len(parts))
    fields = value.fields(parts, parts)
    return tuple(fields[part].number() for part in parts)

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

Vectors may be lists or mappings (x, y, z, w). Read are the collision objects of the world, the
attached ones whose pose the file has, the allowed collision matrix and the colours. Such a file has
only the name of the robot's model; what is left out because of that is in the notes.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from obb_collision.scene_files.description import AllowedRule, Color, SceneDescription, SceneObject
from obb_collision.scene_files.mesh_files import MeshFiles
from obb_collision.scene_files.moveit_matrix import read_matrix, rules_between
from obb_collision.scene_files.moveit_objects import IDENTITY, Frames, read_object, read_pose
from obb_collision.scene_files.yaml_values import Value, items_of
from obb_collision.words import printable

KEYS = (
    *("name", "robot_state", "robot_model_name", "fixed_frame_transforms"),
    *("allowed_collision_matrix", "link_padding", "link_scale", "object_colors", "world"),
    "is_diff",
)
ROBOT_STATE = ("joint_state", "multi_dof_joint_state", "attached_collision_objects", "is_diff")
ATTACHED = ("link_name", "object", "touch_links", "detach_posture", "weight")
#: Keys that only such a file has: it is one if any of them is at its top level.
MARKS = ("world", "allowed_collision_matrix", "robot_state", "robot_model_name")


def read_planning_scene(top: Value, path: Path, files: MeshFiles) -> SceneDescription:
    """Return the description in a planning scene. Raises SceneFileError with all its problems."""
    return _PlanningScene(top, files).description(path)


class _PlanningScene:
    """A planning scene that is being read."""

    def __init__(self, top: Value, files: MeshFiles) -> None:
        self._problems = top.problems
        self._fields = top.fields(KEYS)
        self._files = files
        self._frames = Frames()
        self._objects: list[SceneObject] = []
        self._matrix: list[AllowedRule] = []
        self._own_rules: list[AllowedRule] = []  # of parts and attached objects, matrix or not
        self._notes: list[str] = []
        self._lines: dict[str, int] = {}

    def description(self, path: Path) -> SceneDescription:
        for name, read in (
            ("fixed_frame_transforms", self._read_frames),
            ("world", self._read_world),
            ("robot_state", self._read_robot_state),
            ("allowed_collision_matrix", self._read_matrix),
            ("object_colors", self._read_colors),
            ("robot_model_name", self._read_robot),
            ("is_diff", self._read_diff),
        ):
            if name in self._fields:
                with self._problems.kept():
                    read(self._fields[name])
        name = ""
        if "name" in self._fields:
            with self._problems.kept():
                name = self._fields["name"].label()
        self._problems.finish()
        return SceneDescription(
            name or printable(path.stem),
            tuple(self._objects),
            allowed=(*self._matrix, *self._own_rules),
            notes=(*self._problems.doubts(), *self._notes),
        )

    def _read_frames(self, value: Value) -> None:
        for item in value.items():
            with self._problems.kept():
                fields = item.fields(("header", "child_frame_id", "transform"), ("child_frame_id",))
                frame = fields["child_frame_id"].text("the name of a frame")
                self._frames.add(frame, None)  # known, whatever is wrong with its transform
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
            if part.name in self._lines:
                first = f"first in line {self._lines[part.name]}"
                (item.peek("id") or item).refuse(f"the name {part.name} stands twice, {first}")
            self._lines[part.name] = item.line
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

    def _read_matrix(self, value: Value) -> None:
        self._matrix = read_matrix(value)

    def _read_colors(self, value: Value) -> None:
        colors: dict[str, Color] = {}
        for item in value.items():
            with self._problems.kept():
                fields = item.fields(("id", "color"), ("id", "color"))
                parts = fields["color"].fields(("r", "g", "b", "a"), ("r", "g", "b"))
                r, g, b, a = (parts[key].number() if key in parts else 1.0 for key in "rgba")
                red, green, blue, opacity = (min(max(part, 0.0), 1.0) for part in (r, g, b, a))
                colors[fields["id"].text("an id")] = red, green, blue, opacity
        self._objects = [_colored(thing, colors) for thing in self._objects]

    def _read_robot(self, value: Value) -> None:
        if value.label():
            self._notes.append(
                f"the robot {value.text()} is left out: its links are in its model, not in the "
                "file; what may touch them is kept"
            )

    def _read_diff(self, value: Value) -> None:
        if value.flag():
            self._notes.append("this is a difference to a scene that is not in the file")


def _colored(thing: SceneObject, colors: dict[str, Color]) -> SceneObject:
    """Return an object with the colour of its id, of which its name may be a part."""
    color = colors.get(thing.name, colors.get(thing.name.rpartition("/")[0]))
    return replace(thing, color=color) if color is not None else thing

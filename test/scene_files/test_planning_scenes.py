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

"""MoveIt planning scenes: objects, parts, frames, and the allowed collision matrix."""

from __future__ import annotations

from itertools import combinations, combinations_with_replacement
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
import yaml
from each import each
from hypothesis import given, settings
from hypothesis import strategies as st

import obb_collision as oc
from obb_collision.scene_files import SceneFileError, load_scene
from obb_collision.shapes import Box, Cone, Cylinder, Mesh, Sphere

FOLDER = Path(__file__).parents[1] / "data" / "moveit"


def test_objects_stand_where_the_file_says() -> None:
    description = load_scene(FOLDER / "shelf.yaml")
    assert description.names == ["tin", "board", "side"]
    tin, board, side = description.objects
    assert tin.shape == Cylinder(radius=0.03125, length=0.125)  # MoveIt names the height first
    assert tin.pose == (0.5, 0.25, 0.5625, 0, 0, 0.6, 0.8)
    assert (board.shape, side.shape) == (
        Box([0.5, 0.75, 0.03125]),
        Box([0.5, 0.03125, 1]),
    )


def test_the_matrix_says_what_may_touch() -> None:
    description = load_scene(FOLDER / "shelf.yaml")
    scene = description.build()
    assert scene.check().names() == [("board", "side")]  # the tin may stand on the board
    for name in ("arm_hand", "arm_link/0"):  # rules wait for the robot's links
        scene.add(name, Box([0.0625, 0.0625, 0.0625]), description.objects[0].pose)
    assert set(scene.check().names()) == {("board", "side"), ("tin", "arm_link/0")}
    assert len(description.notes) == 1
    assert "the robot arm is left out" in description.notes[0]


def test_messages_as_ros_prints_them_are_read() -> None:
    description = load_scene(FOLDER / "message.yaml")
    assert description.names == ["crate/0", "crate/1", "wedge", "cable"]
    scene = description.build()
    # the stand is 1 m up; on it the crate is turned by a quarter, x to y
    np.testing.assert_allclose(scene.obb("crate/0").center, [1, 0, 1], atol=1e-15)
    np.testing.assert_allclose(scene.obb("crate/1").center, [1, 0.25, 1], atol=1e-15)
    np.testing.assert_allclose(
        scene.obb("crate/0").rotation, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15
    )
    assert np.all(scene.obb("wedge").contains([[3, 0, 0], [4, 0, 0], [3, 1, 0], [3, 0, 1]]))
    assert description.objects[3].shape == Cone(radius=0.125, length=0.25)
    np.testing.assert_array_equal(scene.obb("cable").center, [0, 0, 1])
    assert description.objects[0].color == (0.5, 0.25, 0.125, 1.0)
    assert description.objects[2].color is None
    assert scene.check().names() == []  # parts of an object may touch each other
    left_out = " ".join(description.notes)
    assert "octomap" in left_out
    assert "held is left out: it is fixed to the robot's link arm_hand" in left_out
    assert "the robot arm is left out" in left_out


def at_one_place(scene: oc.Scene, names: list[str]) -> set[frozenset[str]]:
    """Add objects that all overlap; return the pairs among them that count."""
    for name in names:
        scene.add(name, Sphere(1.0), [50, 0, 0, 0, 0, 0, 1])
    return {frozenset(pair) for pair in scene.check().names()}


def test_attached_objects_may_touch_their_links() -> None:
    names = ["held", "arm_finger", "arm_hand", "cup"]
    found = at_one_place(load_scene(FOLDER / "message.yaml").build(), names)
    every = {frozenset(pair) for pair in combinations(names, 2)}
    assert every - found == {frozenset(("held", "arm_hand")), frozenset(("held", "arm_finger"))}


def test_defaults_of_the_matrix_count_where_it_has_no_entry() -> None:
    names = ["crate", "floor", "sensor", "glass", "cup"]
    found = at_one_place(load_scene(FOLDER / "message.yaml").build(), names)
    free = {("floor", "sensor"), ("floor", "cup"), ("sensor", "crate"), ("sensor", "cup")}
    assert {frozenset(pair) for pair in combinations(names, 2)} - found == set(map(frozenset, free))


NAMES = ["a", "b", "c[1]", "c*"]
OTHERS = [*NAMES, "c1", "d"]


@settings(max_examples=30)
@given(st.data())
def test_matrices_are_looked_up_as_moveit_does(tmp_path_factory: Any, data: st.DataObject) -> None:
    count = data.draw(st.integers(0, len(NAMES)))
    flags = {
        frozenset(pair): data.draw(st.booleans())
        for pair in combinations_with_replacement(range(count), 2)
    }
    matrix = [[flags[frozenset((i, j))] for j in range(count)] for i in range(count)]
    defaults = data.draw(st.dictionaries(st.sampled_from(OTHERS), st.booleans()))
    content = {
        "world": {"collision_objects": []},
        "allowed_collision_matrix": {
            "entry_names": NAMES[:count],
            "entry_values": matrix,
            "default_entry_names": list(defaults),
            "default_entry_values": list(defaults.values()),
        },
    }
    path = tmp_path_factory.mktemp("matrix") / "scene.yaml"
    path.write_text(yaml.safe_dump(content))
    found = at_one_place(load_scene(path).build(), OTHERS)
    for i, j in combinations(range(len(OTHERS)), 2):
        said = [defaults[OTHERS[k]] for k in (i, j) if OTHERS[k] in defaults]
        allowed = matrix[i][j] if j < count else bool(said) and all(said)
        assert (frozenset((OTHERS[i], OTHERS[j])) not in found) == allowed


OBJECT = "id: a, primitives: [{type: sphere, dimensions: [1]}]"
REFUSED = {
    "world: 3": ":1: world: must be a mapping",
    "world: {collision_objects: [{primitives: []}]}": "collision_objects[0]: needs id",
    "world: {collision_objects: [{id: a}]}": "collision_objects[0]: needs primitives or meshes",
    "world: {collision_objects: [{id: a, primitive: []}]}": "did you mean primitives?",
    "world:\n  collision_objects:\n  - id: a\n    planes: [{coef: [0, 0, 1, 0]}]": (
        ":4: world.collision_objects[0].planes: a plane is infinite and has no box; use a large,"
    ),
    "world: {collision_objects: [{id: a, primitives: [{type: torus, dimensions: [1]}]}]}": (
        "primitives[0].type: must be one of box, sphere, cylinder, cone, got torus"
    ),
    "world: {collision_objects: [{id: a, primitives: [{type: box, dimensions: [1, 1]}]}]}": (
        "primitives[0].dimensions: must be 3 positive numbers, got [1, 1]"
    ),
    "world: {collision_objects: [{id: a, primitives: [{type: cone, dimensions: [1, .nan]}]}]}": (
        "must be 2 positive numbers, got [1, .nan]"
    ),
    f"world: {{collision_objects: [{{{OBJECT}, primitive_poses: [{{}}, {{}}]}}]}}": (
        "primitive_poses: there are 1 primitives and 2 primitive_poses"
    ),
    f"world: {{collision_objects: [{{{OBJECT}, pose: {{position: [1, 2]}}}}]}}": (
        "pose.position: must be 3 numbers"
    ),
    f"world: {{collision_objects: [{{{OBJECT}, pose: {{position: {{x: 1, y: 2}}}}}}]}}": (
        "pose.position: needs z"
    ),
    f"world: {{collision_objects: [{{{OBJECT}, operation: 1}}]}}": "operation: must be 0 (ADD)",
    f"world: {{collision_objects: [{{{OBJECT}}}, {{{OBJECT}}}]}}": "the name a stands twice",
    f"world: {{collision_objects: [{{{OBJECT}, header: {{frame_id: x}}}}, "
    f"{{{OBJECT.replace('a', 'b', 1)}, header: {{frame_id: y}}}}]}}": (
        "header.frame_id: the file has neither the pose of y nor that of x"
    ),
    "world: {collision_objects: [{id: a, meshes: [{vertices: [[0, 0, 0]], triangles: [[0]]}]}]}": (
        "triangles[0]: must be 3 vertices"
    ),
    "world: {collision_objects: [{id: a, meshes: [{vertices: [[0, 0, 0]], "
    "triangles: [[0, 0, 1]]}]}]}": "triangles[0][2]: must be a whole number from 0 to 0, got 1",
    "world: {}\nallowed_collision_matrix: {entry_names: [a], entry_values: []}": (
        ":2: allowed_collision_matrix.entry_names: there are 1 entry_names and 0 rows"
    ),
    "world: {}\nallowed_collision_matrix: {entry_names: [a], entry_values: [[true, true]]}": (
        "entry_values[0]: must have 1 entries, one a name, got 2"
    ),
    "world: {}\nallowed_collision_matrix: {entry_names: [a], entry_values: [[1]]}": (
        "entry_values[0][0]: must be true or false, got 1"
    ),
    "world: {}\nallowed_collision_matrix: {entry_names: [a, a], "
    "entry_values: [[true, true], [true, true]]}": "entry_names: a stands twice",
    "world: {}\nallowed_collision_matrix: {entry_names: [a, b], "
    "entry_values: [[true, true], [false, true]]}": "not symmetric: b with a",
    "world: {}\nallowed_collision_matrix: {default_entry_names: [a]}": (
        "there are 1 default_entry_names and 0 default_entry_values"
    ),
    "world: {}\nobject_colours: []": "object_colours: unknown key; did you mean object_colors?",
    "world: {}\nrobot_state: {attached_collision_objects: [{link_name: a}]}": (
        "attached_collision_objects[0]: needs object"
    ),
    "world: {}\nname: [a]": ":2: name: must be a word, got [a]",
    f"world: {{collision_objects: [{{{OBJECT}, header: {{frame_id: [x]}}}}]}}": (
        "header.frame_id: must be a word, got [x]"
    ),
    f"world: {{collision_objects: [{{{OBJECT}, operation: [0]}}]}}": "operation: must be a word",
    "world: {}\nis_diff: [true]": "is_diff: must be true or false, got [true]",
    "world: {}\nis_diff: maybe": "is_diff: must be true or false, got maybe",
}


@each("text", REFUSED)
def test_what_is_wrong_is_told_by_line_and_key(text: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(text)
    with pytest.raises(SceneFileError) as error:
        load_scene(path)
    assert REFUSED[text] in str(error.value)


def test_meshes_may_be_files_as_in_motion_bench_maker(tmp_path: Path) -> None:
    folder = tmp_path / "kitchen_scenes"  # as a clone of the package has it, without ROS
    (folder / "scenes" / "meshes").mkdir(parents=True)
    file = folder / "scenes" / "kitchen.yaml"
    file.write_text((FOLDER / "kitchen.yaml").read_text())
    trimesh.creation.box((1.0, 2.0, 4.0)).export(folder / "scenes" / "meshes" / "door.stl")
    description = load_scene(file)
    assert description.names == ["front", "side/0", "side/1", "can"]
    front, side, other, _ = (thing.shape for thing in description.objects)
    assert isinstance(front, Mesh)
    assert front is side  # read once
    assert isinstance(other, Mesh)
    assert other.scale == (0.5, 0.5, 0.25)
    boxes = description.build().boxes
    np.testing.assert_allclose(np.sort(boxes.half_extents[0]), [0.5, 1.0, 2.0], rtol=1e-12)
    np.testing.assert_allclose(np.sort(boxes.half_extents[2]), [0.25, 0.5, 0.5], rtol=1e-12)
    np.testing.assert_allclose(boxes.centers[:3], [[0, 0, 0], [3, 0, 0], [3, 0, 5]], atol=1e-12)
    (folder / "scenes" / "meshes" / "door.stl").unlink()
    with pytest.raises(SceneFileError) as error:
        load_scene(file)
    first, second, *_ = str(error.value).splitlines()
    assert ":7: world.collision_objects[0].meshes[0].resource: mesh file " in first
    assert first.endswith("door.stl: there is no such file")
    assert ":14: world.collision_objects[1].meshes[0].resource: " in second


def test_names_full_of_letters_of_patterns_are_matched_as_they_are(tmp_path: Path) -> None:
    name = "[*?" * 85
    entry = f"{{id: '{name}', primitives: [{{type: sphere, dimensions: [1]}}]}}"
    matrix = f"{{entry_names: ['{name}', b], entry_values: [[true, true], [true, true]]}}"
    path = tmp_path / "scene.yaml"
    path.write_text(
        f"world: {{collision_objects: [{entry}, {entry.replace(name, 'b')}]}}\n"
        f"allowed_collision_matrix: {matrix}"
    )
    scene = load_scene(path).build()
    assert scene.names == [name, "b"]
    assert scene.check().names() == []


MESH_FILES = {
    "{resource: a.stl}": "meshes[0].resource: mesh file",
    "{resource: 'package://nobody/a.stl'}": "meshes[0].resource: mesh file package://nobody/a.stl",
    "{resource: 'http://a/b.stl'}": "only paths, file:// and package:// URIs can be read",
    "{resource: a.stl, dimensions: [1, 0, 1]}": "meshes[0].dimensions: must be 3 positive numbers",
    "{resource: a.stl, vertices: []}": "meshes[0].vertices: unknown key; there are resource, dim",
    "{dimensions: [1, 1, 1]}": "meshes[0].dimensions: unknown key",
    "{resource: [a]}": "meshes[0].resource: must be a path or a file:// or package:// URI, got [a]",
}


@each("mesh", MESH_FILES)
def test_mesh_files_that_cannot_be_used_are_refused(mesh: str, tmp_path: Path) -> None:
    path = tmp_path / "scene.yaml"
    path.write_text(f"world: {{collision_objects: [{{id: a, meshes: [{mesh}]}}]}}")
    with pytest.raises(SceneFileError) as error:
        load_scene(path)
    assert MESH_FILES[mesh] in str(error.value)


def test_one_unknown_frame_is_that_of_the_scene(tmp_path: Path) -> None:
    one = f"{{{OBJECT}, header: {{frame_id: odom}}}}"
    two = "{id: b, primitives: [{type: 2, dimensions: [1]}], header: {frame_id: /odom}, pose: "
    entries = [one, two + "{position: [1, 0, 0]}}"]
    path = tmp_path / "scene.yaml"
    path.write_text(f"world: {{collision_objects: [{', '.join(entries)}]}}")
    assert [thing.pose[0] for thing in load_scene(path).objects] == [0.0, 1.0]

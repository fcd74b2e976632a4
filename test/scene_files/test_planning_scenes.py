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

"""MoveIt planning scenes, with their matrix, and robots in scene files, with their meshes."""

from __future__ import annotations

from contextlib import closing
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
from processes import SharedWorker

import obb_collision as oc
from obb_collision.geometry.shapes.files import NO_FOLDERS
from obb_collision.robots.description import description_text
from obb_collision.scene.building.builder import Limits
from obb_collision.scene_files import (
    SceneDescription,
    SceneFileError,
    describe_scene,
    find_scene,
    load_scene,
    mesh_files,
)
from obb_collision.shapes import Box, Cone, Cylinder, Mesh, Sphere

FOLDER = Path(__file__).parents[1] / "data" / "moveit"


def test_objects_stand_where_the_file_says_and_the_matrix_says_what_may_touch() -> None:
    description = load_scene(FOLDER / "shelf.yaml")
    assert description.names == ["tin", "board", "side"]
    tin, board, side = description.objects
    assert tin.shape == Cylinder(radius=0.03125, length=0.125)  # MoveIt names the height first
    assert tin.pose == (0.5, 0.25, 0.5625, 0, 0, 0.6, 0.8)
    assert (board.shape, side.shape) == (Box([0.5, 0.75, 0.03125]), Box([0.5, 0.03125, 1]))
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
    turned = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    np.testing.assert_allclose(scene.obb("crate/0").rotation, turned, atol=1e-15)
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


@each("names, free", [
    ("held arm_finger arm_hand cup", "held arm_hand, held arm_finger"),
    ("crate floor sensor glass cup", "floor sensor, floor cup, sensor crate, sensor cup"),
])  # fmt: skip
def test_attached_objects_may_touch_their_links_and_defaults_count(names: str, free: str) -> None:
    """Defaults of the matrix where it has no entry."""
    found = at_one_place(load_scene(FOLDER / "message.yaml").build(), names.split())
    every = {frozenset(pair) for pair in combinations(names.split(), 2)}
    assert every - found == {frozenset(pair.split()) for pair in free.split(", ")}


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
    entries = {"entry_names": NAMES[:count], "entry_values": matrix}
    entries |= {"default_entry_names": [*defaults], "default_entry_values": [*defaults.values()]}
    path = tmp_path_factory.mktemp("matrix") / "scene.yaml"
    path.write_text(yaml.safe_dump({"world": {}, "allowed_collision_matrix": entries}))
    found = at_one_place(load_scene(path).build(), OTHERS)
    for i, j in combinations(range(len(OTHERS)), 2):
        said = [defaults[OTHERS[k]] for k in (i, j) if OTHERS[k] in defaults]
        allowed = matrix[i][j] if j < count else bool(said) and all(said)
        assert (frozenset((OTHERS[i], OTHERS[j])) not in found) == allowed


SPHERE = "primitives: [{type: sphere, dimensions: [1]}]"
A, B = (f"id: {name}, {SPHERE}" for name in "ab")


def world(*objects: str) -> str:
    """Return a file with objects."""
    return f"world: {{collision_objects: [{', '.join(f'{{{one}}}' for one in objects)}]}}"


def primitive(kind: str, size: str) -> str:
    return world(f"id: a, primitives: [{{type: {kind}, dimensions: {size}}}]")


def mesh(fields: str) -> str:
    return world(f"id: a, meshes: [{{{fields}}}]")


def matrix(names: str, values: str) -> str:
    fields = f"entry_names: {names}, entry_values: {values}"
    return f"world: {{}}\nallowed_collision_matrix: {{{fields}}}"


REFUSED = [
    (world("primitives: []"), "collision_objects[0]: needs id"),
    (world("id: a"), "collision_objects[0]: needs primitives or meshes"),
    ("world:\n  collision_objects:\n  - id: a\n    planes: [{coef: [0, 0, 1, 0]}]",
     ":4: world.collision_objects[0].planes: a plane is infinite and has no box; use a large,"),
    (primitive("torus", "[1]"), "[0].type: must be one of box, sphere, cylinder, cone, got torus"),
    (primitive("box", "[1, 1]"), "[0].dimensions: must be 3 positive numbers, got [1, 1]"),
    (primitive("cone", "[1, .nan]"), "must be 2 positive numbers, got [1, .nan]"),
    (world(f"{A}, primitive_poses: [{{}}, {{}}]"),
     "primitive_poses: there are 1 primitives and 2 primitive_poses"),
    (world(f"{A}, pose: {{position: [1, 2]}}"), "pose.position: must be 3 numbers"),
    (world(f"{A}, pose: {{position: {{x: 1, y: 2}}}}"), "pose.position: needs z"),
    (world(f"{A}, operation: 1"), "operation: must be 0 (ADD)"),
    (world(A, A), "the name a stands twice"),
    (world(f"{A}, header: {{frame_id: x}}", f"{B}, header: {{frame_id: y}}"),
     "header.frame_id: the file has neither the pose of y nor that of x"),
    (mesh("vertices: [[0, 0, 0]], triangles: [[0]]"), "triangles[0]: must be 3 vertices"),
    (mesh("vertices: [[0, 0, 0]], triangles: [[0, 0, 1]]"),
     "triangles[0][2]: must be a whole number from 0 to 0, got 1"),
    (mesh("resource: a.stl"), "meshes[0].resource: mesh file"),
    (mesh("resource: 'package://nobody/a.stl'"),
     "meshes[0].resource: mesh file package://nobody/a.stl"),
    (mesh("resource: 'http://a/b.stl'"), "only paths, file:// and package:// URIs can be read"),
    (mesh("resource: a.stl, dimensions: [1, 0, 1]"), "[0].dimensions: must be 3 positive numbers"),
    (mesh("resource: a.stl, vertices: []"), "vertices: unknown key; there are resource, dim"),
    (mesh("dimensions: [1, 1, 1]"), "meshes[0].dimensions: unknown key"),
    (matrix("[a]", "[]"),
     ":2: allowed_collision_matrix.entry_names: there are 1 entry_names and 0 rows"),
    (matrix("[a]", "[[true, true]]"), "entry_values[0]: must have 1 entries, one per name, got 2"),
    (matrix("[a, a]", "[[true, true], [true, true]]"), "entry_names: a stands twice"),
    (matrix("[a, b]", "[[true, true], [false, true]]"), "not symmetric: b with a"),
    ("world: {}\nallowed_collision_matrix: {default_entry_names: [a]}",
     "there are 1 default_entry_names and 0 default_entry_values"),
    ("world: {}\nrobot_state: {attached_collision_objects: [{link_name: a}]}",
     "attached_collision_objects[0]: needs object"),
    ("world: {}\nis_diff: maybe", "is_diff: must be true or false, got maybe"),
]  # fmt: skip


@each("text, reason", REFUSED)
def test_what_is_wrong_is_told_by_line_and_key(text: str, reason: str, write: Any) -> None:
    with pytest.raises(SceneFileError) as error:
        load_scene(write(text))
    assert reason in str(error.value)


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
    assert first.endswith("door.stl: the file does not exist")
    assert ":14: world.collision_objects[1].meshes[0].resource: " in second


def test_names_full_of_letters_of_patterns_are_matched_as_they_are(write: Any) -> None:
    name = "[*?" * 85
    _, allowed = matrix(f"['{name}', b]", "[[true, true], [true, true]]").split("\n")
    scene = load_scene(write(world(f"id: '{name}', {SPHERE}", B) + f"\n{allowed}")).build()
    assert scene.names == [name, "b"]
    assert scene.check().names() == []


def test_one_unknown_frame_is_that_of_the_scene(write: Any) -> None:
    one = f"{A}, header: {{frame_id: odom}}"
    two = B.replace("sphere", "2") + ", header: {frame_id: /odom}, pose: {position: [1, 0, 0]}"
    assert [thing.pose[0] for thing in load_scene(write(world(one, two))).objects] == [0.0, 1.0]


CONFIG = find_scene("arm_cell").parent
FILE = """\
objects: [{name: floor/0, shape: box, size: [1, 1, 1]}]
robots:
  - name: left
    urdf: arm.urdf
    position: [1, 2, 3]
    rpy: [0, 0, 0.5]
"""


def read(folder: Path, text: str) -> SceneDescription:
    """Return the description in a text beside the arm of the package."""
    for name in ("arm.urdf", "arm.srdf", "arm_finger.obj"):
        (folder / name).write_bytes((CONFIG / name).read_bytes())
    (folder / "cell.yaml").write_text(text)
    return load_scene(folder / "cell.yaml")


def test_a_robot_at_rest_stands_where_the_file_says(tmp_path: Path) -> None:
    (robot,) = read(tmp_path, FILE + "    joints: {turn: 0.5}\n").robots
    assert (robot.name, robot.robot.name, robot.srdf) == ("left", "arm", None)
    np.testing.assert_allclose(robot.pose, [1, 2, 3, 0, 0, np.sin(0.25), np.cos(0.25)])
    assert robot.state == (0.5, 0, 0, 0, 0, 0, 0)


@each("kind", ["urdf", "srdf"])
@each("file", ["../arm.xml", "http://x/arm.xml", "package://nobody/arm.xml"])
def test_descriptions_elsewhere_are_refused_as_such(tmp_path: Path, kind: str, file: str) -> None:
    folder = tmp_path / "scenes"
    folder.mkdir(exist_ok=True)
    (tmp_path / "arm.xml").write_bytes((CONFIG / f"arm.{kind}").read_bytes())
    line = f"    {kind}: {file}\n"
    text = FILE.replace("    urdf: arm.urdf\n", line) if kind == "urdf" else FILE + line
    with pytest.raises(SceneFileError) as refused:
        read(folder, text)
    assert f"robots[0].{kind}: {kind.upper()} " in str(refused.value)
    assert "arm.xml" in str(refused.value)
    assert "mesh file" not in str(refused.value)


@each("old, new, reason", [
    ("", "joints: {turn: 9}", "cell.yaml:7: robots[0].joints.turn: must be a number within the"),
    ("", "joints: {turn: .nan}", "must be a number within the joint's limits, -3.1 to 3.1"),
    ("", "joints: {tune: 0}", "no joint of the robot moves so; did you mean turn?"),
    ("", "joints: {grip_right: 0}", "no joint of the robot moves so"),
    ("", "motion: {period: 2.0}", "robots[0].motion: a scene does not move"),
    ("", "srdf: none.srdf", "none.srdf"),
    ("", "srdf: arm_finger.obj", "arm_finger.obj"),
    ("", "srdf: ../../../../etc/passwd", "/etc/passwd, which is not in a folder from which"),
    ("name: left", "name: left/1", "must be letters, digits and _, the first a letter"),
    ("urdf: arm.urdf", "urdf: arm.srdf", "arm.srdf"),
    ("  - name: left", "  - {name: left, urdf: arm.urdf}\n  - name: left", "stands twice"),
])  # fmt: skip
def test_bad_robots_are_refused_by_line(tmp_path: Path, old: str, new: str, reason: str) -> None:
    with pytest.raises(SceneFileError, match="robots") as error:
        read(tmp_path, FILE.replace(old, new) if old else f"{FILE}    {new}\n")
    assert reason in str(error.value)


def test_a_description_that_is_published_has_its_meshes_by_absolute_uris() -> None:
    text = description_text(CONFIG / "arm.urdf")
    assert text.count((CONFIG / "arm_finger.obj").as_uri()) == 2
    robot = oc.Robot.from_urdf(text, package_dirs=[CONFIG])
    known = oc.Robot.from_urdf(CONFIG / "arm.urdf")
    assert robot.joint_names == known.joint_names
    assert [len(placed) for placed in robot.shapes] == [len(placed) for placed in known.shapes]


OUTSIDE = "is not in a folder from which meshes are read"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """Return a scene file in the folder config of a package, without content."""
    for name in ("arm/config", "arm/meshes", "other"):
        (tmp_path / name).mkdir(parents=True)
    for folder in ("arm/config", "arm/meshes", "other"):
        trimesh.creation.box().export(tmp_path / folder / "part.stl")
    return tmp_path / "arm" / "config" / "scene.yaml"


def naming(scene: Path, file: str) -> Path:
    """Write a scene with one mesh."""
    scene.write_text(f"objects: [{{name: a, shape: mesh, file: '{file}'}}]")
    return scene


def faces(scene: Path, file: str, *folders: Path) -> int:
    """Return how many faces the mesh of a scene with this file has."""
    mesh = load_scene(naming(scene, file), mesh_folders=folders).objects[0].shape
    assert isinstance(mesh, Mesh)
    return len(mesh.faces)


def test_a_mesh_may_be_beside_the_scene_file_or_in_its_package(scene: Path) -> None:
    for file in ("part.stl", (scene.parent / "part.stl").as_uri()):
        assert faces(scene, file) == 12
    with pytest.raises(SceneFileError, match=OUTSIDE):
        faces(scene, "../meshes/part.stl")
    (scene.parents[1] / "package.xml").write_text("<package><name>arm</name></package>")
    for file in ("../meshes/part.stl", "package://arm/meshes/part.stl"):
        assert faces(scene, file) == 12
    with pytest.raises(SceneFileError, match=OUTSIDE):
        faces(scene, "package://arm/../other/part.stl")


def test_a_mesh_elsewhere_needs_its_folder_to_be_allowed(scene: Path, tmp_path: Path) -> None:
    (scene.parent / "link.stl").symlink_to(tmp_path / "other" / "part.stl")
    for file in ("../../other/part.stl", (tmp_path / "other/part.stl").as_uri(), "link.stl"):
        with pytest.raises(SceneFileError, match=rf"objects\[0\].file: mesh file .*{OUTSIDE}"):
            faces(scene, file)
        assert faces(scene, file, tmp_path / "other") == 12


@each("folders", ["/tmp", [1], None, {"/tmp"}])
def test_folders_are_a_sequence_of_paths(scene: Path, folders: object) -> None:
    with pytest.raises(TypeError, match="mesh_folders must be"):
        load_scene(naming(scene, "part.stl"), mesh_folders=folders)  # type: ignore[arg-type]


@each("limits, reason", [
    ((Limits(seconds=0.0),), "building took too long: 0 s is the limit"), ((Limits(),), ""),
    ((Limits(), 100), "it has 684 bytes, 100 is the limit"),
    ((Limits(), 1000, 11), "it has 12 triangles, 11 is the limit"),
])  # fmt: skip
def test_a_mesh_read_in_another_process_is_the_same_within_limits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, limits: Any, reason: str
) -> None:
    monkeypatch.setattr(mesh_files, "WorkerProcess", SharedWorker)  # to start takes long
    part = trimesh.creation.icosphere(5) if "too long" in reason else trimesh.creation.box()
    part.export(tmp_path / "part.stl")
    file = naming(tmp_path / "scene.yaml", "part.stl")
    with closing(mesh_files.MeshReading(NO_FOLDERS, *limits)) as reading:
        if reason:
            with pytest.raises(SceneFileError, match=reason):
                describe_scene(file, reading)
        else:
            there, here = describe_scene(file, reading), load_scene(file)
            assert there.objects[0].shape == here.objects[0].shape

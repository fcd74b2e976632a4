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

"""Robots in scene files: what is read, what is refused, and how their joints move."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh
from each import each

import obb_collision as oc
from obb_collision.geometry.shapes import NO_FOLDERS
from obb_collision.robots.description import description_text
from obb_collision.scene.building.process import Limits
from obb_collision.scene_files import (
    SceneDescription,
    SceneFileError,
    describe_scene,
    find_scene,
    load_scene,
)
from obb_collision.scene_files.mesh_files import MeshReading
from obb_collision.shapes import Mesh

CONFIG = find_scene("arm_cell").parent
FILE = """\
objects: [{name: floor/0, shape: box, size: [1, 1, 1]}]
robots:
  - name: left
    urdf: arm.urdf
    position: [1, 2, 3]
    rpy: [0, 0, 0.5]
"""


@pytest.fixture
def cell() -> SceneDescription:
    return load_scene("arm_cell")


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
    values, velocities = robot.joints(7.0)
    assert values.tolist() == [0.5, 0, 0, 0, 0, 0, 0]
    assert not velocities.any()


@each("kind", ["urdf", "srdf"])
@each("file", ["../arm.xml", "http://x/arm.xml", "package://nobody/arm.xml"])
def test_a_description_elsewhere_is_refused_as_what_it_is(
    tmp_path: Path, kind: str, file: str
) -> None:
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


def test_joints_pass_the_waypoints_at_their_times_and_keep_what_is_not_named(
    cell: SceneDescription,
) -> None:
    (arm,) = cell.robots
    rows = {name: row for row, name in enumerate(arm.robot.joint_names)}
    assert arm.joints(0.0)[0][rows["elbow"]] == 1.56
    assert arm.joints(1.5)[0][rows["elbow"]] == 1.62
    assert arm.joints(0.75)[0][rows["elbow"]] == pytest.approx(1.59)
    assert arm.joints(0.75)[1][rows["elbow"]] == pytest.approx(0.04)
    assert arm.joints(5.0)[0][rows["grip"]] == 0.01
    assert arm.joints(14.0 + 1.5)[0][rows["elbow"]] == arm.joints(1.5)[0][rows["elbow"]]
    last, first = arm.joints(14.0 - 1e-9)[0], arm.joints(0.0)[0]
    np.testing.assert_allclose(last, first, atol=1e-8)


def test_velocities_are_how_the_joints_change_and_all_is_within_the_limits(
    cell: SceneDescription,
) -> None:
    (arm,) = cell.robots
    for time in np.arange(0.013, 14.0, 0.37):
        (before, velocities), (after, _) = arm.joints(time), arm.joints(time + 1e-6)
        np.testing.assert_allclose((after - before) * 1e6, velocities, atol=1e-6)
        assert ((arm.robot.lower <= before) & (before <= arm.robot.upper)).all()
        assert (np.abs(velocities) <= arm.robot.velocity_limits).all()


def test_the_arm_of_the_cell_collides_only_with_a_board_on_its_way_out(
    cell: SceneDescription,
) -> None:
    (arm,) = cell.robots
    scene = oc.RobotScene({arm.name: arm.robot}, cell.build(), bases=[arm.pose])
    times = np.arange(0.0, 14.0, 0.1)
    report = scene.check(np.array([arm.joints(time)[0] for time in times]))
    assert {pair for pair in report.pairs if pair} == {
        ("arm/hand", "shelf/3"), ("arm/right_finger", "shelf/3")
    }  # fmt: skip
    assert not report.out_of_limits.any()
    assert set(times[~report.valid].round(1)) <= set(np.arange(9.0, 11.0, 0.1).round(1))


@each(
    "line, reason",
    [
        ("joints: {turn: 9}", "cell.yaml:7: robots[0].joints.turn: must be a number within the"),
        ("joints: {turn: .nan}", "must be a number within the joint's limits, -3.1 to 3.1"),
        ("joints: {tune: 0}", "no joint of the robot moves so; did you mean turn?"),
        ("joints: {grip_right: 0}", "no joint of the robot moves so"),
        ("motion: {period: 2.0}", "needs waypoints"),
        ("motion: {waypoints: [{joints: {}}], period: 2.0}", "at least 2 waypoints"),
        ("motion: {waypoints: [{joints: {}}, {}], period: 2.0}", "needs joints"),
        (
            "motion: {waypoints: [{joints: {}, time: 0}, {joints: {}, time: 3}], period: 2.0}",
            "times must ascend from 0 and stay below the period 2",
        ),
        ("srdf: none.srdf", "none.srdf"),
        ("srdf: arm_finger.obj", "arm_finger.obj"),
        ("srdf: ../../../../etc/passwd", "/etc/passwd, which is in no folder from which"),
        ("color: red", "unknown key"),
    ],
)
def test_what_cannot_be_used_is_refused_with_its_line(
    tmp_path: Path, line: str, reason: str
) -> None:
    with pytest.raises(SceneFileError) as error:
        read(tmp_path, f"{FILE}    {line}\n")
    assert reason in str(error.value)


@each(
    "old, new, reason",
    [
        ("name: left", "name: left/1", "must be letters, digits and _, the first a letter"),
        ("urdf: arm.urdf", "urdf: arm.srdf", "arm.srdf"),
        ("  - name: left", "  - {name: left, urdf: arm.urdf}\n  - name: left", "stands twice"),
    ],
)
def test_bad_names_and_descriptions_are_refused(
    tmp_path: Path, old: str, new: str, reason: str
) -> None:
    with pytest.raises(SceneFileError, match="robots") as error:
        read(tmp_path, FILE.replace(old, new))
    assert reason in str(error.value)


def test_a_description_that_is_published_has_its_meshes_by_absolute_uris() -> None:
    text = description_text(CONFIG / "arm.urdf")
    assert text.count((CONFIG / "arm_finger.obj").as_uri()) == 2
    robot = oc.Robot.from_urdf(text, package_dirs=[CONFIG])
    known = oc.Robot.from_urdf(CONFIG / "arm.urdf")
    assert robot.joint_names == known.joint_names
    assert [len(placed) for placed in robot.shapes] == [len(placed) for placed in known.shapes]


OUTSIDE = "is in no folder from which meshes are read"


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


def faces(mesh: object) -> int:
    assert isinstance(mesh, Mesh)
    return len(mesh.faces)


def test_a_mesh_may_be_beside_the_scene_file(scene: Path) -> None:
    for file in ("part.stl", (scene.parent / "part.stl").as_uri()):
        assert faces(load_scene(naming(scene, file)).objects[0].shape) == 12


def test_a_mesh_may_be_in_the_package_of_the_scene_file(scene: Path) -> None:
    naming(scene, "../meshes/part.stl")
    with pytest.raises(SceneFileError, match=OUTSIDE):
        load_scene(scene)
    (scene.parents[1] / "package.xml").write_text("<package><name>arm</name></package>")
    assert faces(load_scene(scene).objects[0].shape) == 12
    assert faces(load_scene(naming(scene, "package://arm/meshes/part.stl")).objects[0].shape) == 12
    with pytest.raises(SceneFileError, match=OUTSIDE):
        load_scene(naming(scene, "package://arm/../other/part.stl"))


def test_a_mesh_elsewhere_needs_its_folder_to_be_allowed(scene: Path, tmp_path: Path) -> None:
    (scene.parent / "link.stl").symlink_to(tmp_path / "other" / "part.stl")
    for file in ("../../other/part.stl", (tmp_path / "other/part.stl").as_uri(), "link.stl"):
        naming(scene, file)
        with pytest.raises(SceneFileError, match=rf"objects\[0\].file: mesh file .*{OUTSIDE}"):
            load_scene(scene)
        loaded = load_scene(scene, mesh_folders=[tmp_path / "other"])
        assert faces(loaded.objects[0].shape) == 12


@each("folders", ["/tmp", [1], None, {"/tmp"}])
def test_folders_are_a_sequence_of_paths(scene: Path, folders: object) -> None:
    with pytest.raises(TypeError, match="mesh_folders must be"):
        load_scene(naming(scene, "part.stl"), mesh_folders=folders)  # type: ignore[arg-type]


@pytest.fixture
def reading(request: pytest.FixtureRequest) -> Iterator[MeshReading]:
    made = MeshReading(NO_FOLDERS, *request.param)
    yield made
    made.close()


@pytest.mark.parametrize("reading", [(Limits(),)], indirect=True)
def test_a_mesh_read_in_another_process_is_the_same(scene: Path, reading: MeshReading) -> None:
    naming(scene, "part.stl")
    there, here = describe_scene(scene, reading), load_scene(scene)
    assert there.objects[0].shape == here.objects[0].shape


@pytest.mark.parametrize(
    ("reading", "reason"),
    [
        ((Limits(seconds=0.0),), "building took too long: 0 s is the limit"),
        ((Limits(), 100), "it has 684 bytes, 100 is the limit"),
        ((Limits(), 1000, 11), "it has 12 triangles, 11 is the limit"),
    ],
    indirect=["reading"],
)
def test_reading_in_another_process_has_limits(
    scene: Path, reading: MeshReading, reason: str
) -> None:
    with pytest.raises(SceneFileError, match=reason):
        describe_scene(naming(scene, "part.stl"), reading)

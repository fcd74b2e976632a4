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

"""The shapes of links: all geometries of URDF, meshes from where they may be."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from urdfs import link, urdf

import obb_collision as oc
from obb_collision.robots.description.xml_values import RobotError


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """Return the folder of a package ``bot`` with a mesh and a URDF's folder."""
    folder = tmp_path / "share" / "bot"
    (folder / "urdf").mkdir(parents=True)
    (folder / "meshes").mkdir()
    (folder / "package.xml").write_text("<package><name>bot</name></package>")
    body = trimesh.creation.box((1, 2, 3))
    body.apply_translation((0.5, 1.0, 1.5))  # from the origin to (1, 2, 3)
    body.export(folder / "meshes" / "box.stl")
    return folder


def mesh(filename: str, scale: str = "1 1 1") -> str:
    return urdf(link("a", f'<mesh filename="{filename}" scale="{scale}"/>'))


def vertices(robot: oc.Robot) -> np.ndarray:
    """Return the corners of the only mesh of a robot, scaled."""
    ((shape, _),) = robot.shapes[0]
    assert isinstance(shape, oc.shapes.Mesh)
    return shape.vertices * shape.scale


def test_every_geometry_becomes_a_shape_with_its_pose() -> None:
    geometries = (
        '<box size="1 2 3"/>', '<sphere radius="1"/>', '<cylinder radius="1" length="2"/>',
        '<capsule radius="1" length="2"/>',
    )  # fmt: skip
    text = urdf(link("a", *geometries)).replace(
        "<geometry><sphere", '<origin xyz="1 2 3" rpy="0 0 3.141592653589793"/><geometry><sphere'
    )
    (shapes,) = oc.Robot.from_urdf(text).shapes
    assert [shape for shape, _ in shapes] == [
        oc.shapes.Box((1, 2, 3)), oc.shapes.Sphere(1), oc.shapes.Cylinder(1, 2),
        oc.shapes.Capsule(1, 2),
    ]  # fmt: skip
    assert shapes[0][1] == (0, 0, 0, 0, 0, 0, 1)
    assert shapes[1][1][:3] == (1, 2, 3)
    np.testing.assert_allclose(shapes[1][1][3:], (0, 0, 1, 0), atol=1e-15)


def test_angles_are_about_fixed_axes_x_first() -> None:
    text = urdf(link("a", '<sphere radius="1"/>')).replace(
        "<geometry>", '<origin rpy="0.1 0.2 0.3"/><geometry>'
    )
    ((_, pose),) = oc.Robot.from_urdf(text).shapes[0]
    half = [np.sin(0.15), np.cos(0.15)]
    assert oc.OBB.from_quaternion([0] * 3, pose[3:], [1] * 3).rotation[2, 0] == pytest.approx(
        -np.sin(0.2)
    )
    alone = oc.Robot.from_urdf(text.replace("0.1 0.2 0.3", "0 0 0.3")).shapes[0][0][1]
    np.testing.assert_allclose(alone[3:], (0, 0, *half), atol=1e-16)


def test_meshes_are_found_by_every_way_of_naming_them(package: Path) -> None:
    file = package / "urdf" / "bot.urdf"
    corner = [1, 2, 3]
    for name, folders in {
        "../meshes/box.stl": None,
        "package://bot/meshes/box.stl": None,  # the URDF's own package
        f"file://{package}/meshes/box.stl": None,
        str(package / "meshes" / "box.stl"): None,
    }.items():
        file.write_text(mesh(name))
        assert vertices(oc.Robot.from_urdf(file, package_dirs=folders)).max(0).tolist() == corner
    text = mesh("package://bot/meshes/box.stl")
    for given in ([package.parent], {"bot": package}, str(package.parent), [package]):
        assert vertices(oc.Robot.from_urdf(text, package_dirs=given)).max(0).tolist() == corner


def test_meshes_are_read_from_no_other_folders(package: Path, tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "secret.stl")
    (package / "meshes" / "link.stl").symlink_to(tmp_path / "secret.stl")
    file = package / "urdf" / "bot.urdf"
    for name in (
        "../../../secret.stl", "package://bot/../../secret.stl", str(tmp_path / "secret.stl"),
        "../meshes/link.stl", "package://bot/meshes/link.stl",
    ):  # fmt: skip
        file.write_text(mesh(name))
        with pytest.raises(RobotError, match=r"bot\.urdf:2: mesh of .*no folder from which meshes"):
            oc.Robot.from_urdf(file)


def test_meshes_are_scaled_and_mirrored(package: Path) -> None:
    given = {"bot": package}
    for scale, corner in (("0.5 1 2", [0.5, 2, 6]), ("-1 1 1", [0, 2, 3]), ("-1 -2 1", [0, 0, 3])):
        text = mesh("package://bot/meshes/box.stl", scale)
        robot = oc.Robot.from_urdf(text, package_dirs=given)
        assert vertices(robot).max(0).tolist() == corner
        ((shape, _),) = robot.shapes[0]
        assert isinstance(shape, oc.shapes.Mesh)
        body = trimesh.Trimesh(vertices(robot), shape.faces)
        assert body.volume == pytest.approx(abs(6 * np.prod([float(s) for s in scale.split()])))


def test_a_mesh_that_cannot_be_read_is_named_with_its_line(package: Path) -> None:
    (package / "meshes" / "bad.stl").write_text("no mesh")
    for name in ("bad.stl", "none.stl", "box.exe", ""):
        with pytest.raises(RobotError, match=r"^urdf:2: mesh of geometry"):
            oc.Robot.from_urdf(mesh(f"package://bot/meshes/{name}"), package_dirs={"bot": package})


def test_each_mesh_is_read_once(package: Path) -> None:
    read: list[Path] = []

    def counted(path: Path, scale: tuple[float, float, float]) -> oc.shapes.Mesh:
        read.append(path)
        return oc.shapes.Mesh.from_file(path, scale)

    one = '<mesh filename="package://bot/meshes/box.stl"/>'
    robot = oc.Robot.from_urdf(
        urdf(link("a", one, one)), package_dirs={"bot": package}, read_mesh=counted
    )
    assert read == [package / "meshes" / "box.stl"]
    assert robot.shapes[0][0][0] is robot.shapes[0][1][0]


def test_the_arm_that_comes_with_the_package_is_read() -> None:
    config = Path(__file__).parents[3] / "config"
    robot = oc.Robot.from_urdf(config / "arm.urdf", config / "arm.srdf")
    assert len(robot.joint_names) == 7
    assert robot.doubts == ()
    assert robot.adjacent_pairs <= robot.disabled_pairs
    assert all(robot.shapes)

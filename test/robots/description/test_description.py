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

"""Descriptions of robots: names, limits, poses, shapes and SRDFs, and files that are refused."""

from __future__ import annotations

import math
import re
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from small_robots import LIMIT, joint, link, urdf
from support import refused

import obb_collision as oc
from obb_collision.geometry.shapes.files import MeshFolders
from obb_collision.robots.description import RobotError, xml_values

SMALL = urdf(
    '<link name="a"/>', '<link name="b"/>', '<link name="c"/>', '<link name="d"/>',
    joint("second", "prismatic", "b", "c", LIMIT),
    joint("first", "revolute", "a", "b", LIMIT + '<axis xyz="0 0 2"/><origin xyz="1 0 0"/>'),
    joint("third", "continuous", "b", "d", '<mimic joint="first" multiplier="-1" offset="0.5"/>'),
)  # fmt: skip


def test_names_are_in_the_order_of_the_tree() -> None:
    robot = oc.Robot.from_urdf(SMALL)
    assert robot.name == "r"
    assert robot.link_names == ("a", "b", "c", "d")
    assert robot.joint_names == ("first", "second")
    assert robot.lower.tolist() == [-1, -1]
    assert robot.upper.tolist() == [2, 2]
    assert robot.velocity_limits.tolist() == [3, 3]


def test_links_move_with_their_joints() -> None:
    robot = oc.Robot.from_urdf(SMALL)
    poses = robot.link_poses([[math.pi / 2, 0.5], [0.0, 0.0]])
    assert poses.shape == (2, 4, 7)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(poses[0, 1], [1, 0, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[0, 2], [1, 0.5, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[1, 3, 3:], [math.sin(0.25), 0, 0, math.cos(0.25)], atol=1e-15)
    assert np.array_equal(robot.link_poses([math.pi / 2, 0.5]), poses[0])


BALL = '<sphere radius="0.1"/>'
ARM = urdf(
    link("a", BALL), link("b", BALL), link("frame"), link("c", BALL), link("d", BALL),
    joint("ab", "revolute", "a", "b"), joint("bf", "fixed", "b", "frame", ""),
    joint("fc", "revolute", "frame", "c"), joint("fd", "revolute", "frame", "d"),
)  # fmt: skip


def robot(*elements: str) -> oc.Robot:
    return oc.Robot.from_urdf(ARM, urdf(*elements))


def bad(reason: str, *given: object, **more: Any) -> RobotError:
    """Return the error of a description that is refused for this reason."""
    with pytest.raises(RobotError, match=reason) as caught:
        oc.Robot.from_urdf(*given, **more)  # type: ignore[arg-type]
    return caught.value


def test_links_are_adjacent_through_links_without_shapes_and_pairs_disabled_by_name() -> None:
    pairs = {("a", "b"), ("b", "c"), ("b", "d"), ("c", "d")}
    assert oc.Robot.from_urdf(ARM).adjacent_pairs == pairs
    found = robot(
        '<disable_collisions link1="c" link2="a" reason="Never"/>',
        '<disable_default_collisions link="d"/>',
        '<enable_collisions link1="d" link2="a"/>',
        '<enable_collisions link1="d" link2="b"/>',
        '<disable_collisions link1="d" link2="b"/>',
    )
    assert found.default_disabled == ("d",)
    assert found.disabled_pairs == {("a", "c"), ("b", "d"), ("c", "d"), ("d", "frame")}
    assert oc.Robot.from_urdf(ARM).disabled_pairs == frozenset()


def test_groups_have_what_their_elements_and_subgroups_have() -> None:
    found = robot(
        '<group name="chain"><chain base_link="a" tip_link="c"/></group>',
        '<group name="link"><link name="d"/></group>',
        '<group name="joint"><joint name="ab"/></group>',
        '<group name="both"><group name="link"/><group name="joint"/></group>',
        '<group name="none"/>',
        '<group_state name="home" group="g"><joint name="ab" value="1.5"/></group_state>',
        '<end_effector name="tool" parent_link="a" group="g"/>',
    )
    assert found.group_states == {("g", "home"): {"ab": (1.5,)}}
    assert found.end_effectors == {"tool": "g"}
    groups = {name: (group.joints, group.links) for name, group in found.groups.items()}
    assert groups == {
        "chain": (("ab", "bf", "fc"), ("b", "frame", "c")),
        "link": (("fd",), ("d",)),
        "joint": (("ab",), ("b",)),
        "both": (("ab", "fd"), ("b", "d")),
        "none": ((), ()),
    }


DOUBTS = {
    '<disable_collisions link1="a" link2="x"/>': "its link2 'x' is not a link of the robot",
    '<disable_default_collisions link="x"/>': "its link 'x' is not a link",
    '<group name="g"><link name="x"/></group>': "its name 'x' is not a link",
    '<group name="g"><chain base_link="d" tip_link="c"/></group>': "is not above its tip_link",
    '<virtual_joint name="v" type="fixed" parent_frame="w" child_link="b"/>': "is not the root",
}


def test_what_the_robot_has_not_is_a_doubt_with_its_line_and_unknown_links_are_warned_of() -> None:
    for element, reason in DOUBTS.items():
        unknown = pytest.warns(
            UserWarning, match="the SRDF names links that the URDF does not have: 'x'$"
        )
        with unknown if "'x'" in reason else nullcontext():
            found = robot(element)
        assert len(found.doubts) == 1, element
        assert found.doubts[0].startswith("srdf:2: ")
        assert reason in found.doubts[0]
        assert found.disabled_pairs == frozenset()


def test_unknown_links_are_warned_of_once_and_many_are_not_all_named() -> None:
    elements = (f'<disable_collisions link1="a" link2="x{k}"/>' for k in (*range(9), 1))
    with pytest.warns(UserWarning, match="the URDF does not have") as caught:
        robot(*elements)
    (warning,) = caught
    assert warning.filename == __file__
    assert str(warning.message).endswith(": 'x0', 'x1', 'x2', 'x3', 'x4', ...")


def test_the_srdf_of_another_robot_is_refused() -> None:
    bad("^srdf:1: robot 's': the URDF is of robot 'r'", ARM, '<robot name="s"/>')


def test_a_robot_without_collision_geometry_is_a_doubt_and_warned_of_where_it_is_checked() -> None:
    bare = oc.Robot.from_urdf(urdf(link("a"), link("b"), joint("ab", "revolute", "a", "b")))
    (doubt,) = bare.doubts
    assert doubt == "urdf:1: robot 'r': no link has a <collision>: nothing collides with it"
    scene = oc.Scene()
    scene.add("shelf", oc.shapes.Box([9, 9, 9]))
    checker = oc.RobotScene({"first": bare, "second": oc.Robot.from_urdf(ARM)}, scene)
    states = np.zeros((1, len(checker.joint_names)))
    with pytest.warns(UserWarning, match="robot 'first' collides with nothing: no link") as caught:
        checker.check(states)
    assert caught[0].filename == __file__
    checker.check(states)  # once
    checker = oc.RobotScene(bare, scene)
    checker.attach("cup", oc.shapes.Sphere(1), "a")  # that collides
    assert not checker.check([0.0]).valid[0]


BAD_SRDF = {
    '<disable_collisions link1="a"/>': "its link2 is missing",
    '<virtual_joint name="v" type="hinge" parent_frame="w" child_link="a"/>': "its type must be",
    '<virtual_joint name="ab" type="fixed" parent_frame="w" child_link="a"/>': "the same name",
    '<virtual_joint name="v" type="fixed" child_link="a"/>': "its parent_frame is missing",
    '<group/>': "its name is missing",
    '<group name="g"/><group name="g"/>': "another group",
    '<group name="g"><group name="h"/></group><group name="h"><group name="g"/></group>':
        "a part of itself",
    '<group_state name="s" group="g"><joint name="ab" value="x"/></group_state>': "finite numbers",
    '<group_state name="s" group="g"><joint name="ab"/></group_state>': "value is missing",
}  # fmt: skip


def test_bad_srdfs_are_refused_with_the_place_within_the_limits_of_urdfs() -> None:
    for element, reason in BAD_SRDF.items():
        bad(rf"^srdf:2: .*{reason}", ARM, urdf(element))
    document = '<!DOCTYPE r [<!ENTITY a "b">]>\n<robot name="r"/>'
    bad(r"^srdf:2: a document type", ARM, document)
    bad("the root of an SRDF", ARM, "<sdf/>")


def test_groups_and_doubts_have_limits() -> None:
    groups = (f'<group name="g{k}"/>' for k in range(1001))
    bad("there are 1001 groups, 1000 is the limit", ARM, urdf(*groups))
    chains = '<chain base_link="a" tip_link="c"/>' * 10_001
    bad("there are 10001 parts of groups", ARM, urdf(f'<group name="g">{chains}</group>'))
    nested = [f'<group name="g{k}"><group name="g{k + 1}"/></group>' for k in range(1000)]
    assert len(robot(*nested).groups) == 1000
    with pytest.warns(UserWarning, match="'x', 'y'$"):
        found = robot(*('<disable_collisions link1="x" link2="y"/>' for _ in range(200)))
    assert len(found.doubts) == 100


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
    turn = '<origin rpy="0.1 0.2 0.3"/>'
    text = urdf(link("a", BALL)).replace("<geometry>", f"{turn}<geometry>")
    ((_, pose),) = oc.Robot.from_urdf(text).shapes[0]
    turned = oc.OBB.from_quaternion([0] * 3, pose[3:], [1] * 3).rotation
    assert turned[2, 0] == pytest.approx(-np.sin(0.2))
    alone = oc.Robot.from_urdf(text.replace("0.1 0.2 0.3", "0 0 0.3")).shapes[0][0][1]
    np.testing.assert_allclose(alone[3:], (0, 0, np.sin(0.15), np.cos(0.15)), atol=1e-16)


def test_meshes_are_found_by_every_way_of_naming_them(package: Path) -> None:
    file, at = package / "urdf" / "bot.urdf", f"{package}/meshes/box.stl"
    text = mesh("package://bot/meshes/box.stl")
    for name in ("../meshes/box.stl", "package://bot/meshes/box.stl", f"file://{at}", at):
        file.write_text(mesh(name))  # which is in the package
        assert vertices(oc.Robot.from_urdf(file)).max(0).tolist() == [1, 2, 3]
    for given in ([package.parent], {"bot": package}, str(package.parent), [package]):
        assert vertices(oc.Robot.from_urdf(text, package_dirs=given)).max(0).tolist() == [1, 2, 3]


def test_meshes_are_read_from_no_other_folders(package: Path, tmp_path: Path) -> None:
    trimesh.creation.box().export(tmp_path / "secret.stl")
    (package / "meshes" / "link.stl").symlink_to(tmp_path / "secret.stl")
    file = package / "urdf" / "bot.urdf"
    for name in (
        "../../../secret.stl", "package://bot/../../secret.stl", str(tmp_path / "secret.stl"),
        "../meshes/link.stl", "package://bot/meshes/link.stl",
    ):  # fmt: skip
        file.write_text(mesh(name))
        bad(r"bot\.urdf:2: mesh of .*not in a folder from which meshes", file)


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
        text = mesh(f"package://bot/meshes/{name}")
        bad(r"^urdf:2: mesh of geometry", text, package_dirs={"bot": package})


def test_each_mesh_is_read_once(package: Path) -> None:
    read: list[Path] = []

    def counted(path: Path, scale: tuple[float, float, float]) -> oc.shapes.Mesh:
        read.append(path)
        return oc.shapes.Mesh.from_file(path, scale)

    text = urdf(link("a", *['<mesh filename="package://bot/meshes/box.stl"/>'] * 2))
    robot = oc.Robot.from_urdf(text, package_dirs={"bot": package}, read_mesh=counted)
    assert read == [package / "meshes" / "box.stl"]
    assert robot.shapes[0][0][0] is robot.shapes[0][1][0]


def test_the_arm_that_comes_with_the_package_is_read() -> None:
    config = Path(__file__).parents[3] / "config"
    robot = oc.Robot.from_urdf(config / "arm.urdf", config / "arm.srdf")
    assert len(robot.joint_names) == 7
    assert robot.doubts == ()
    assert robot.adjacent_pairs <= robot.disabled_pairs
    assert all(robot.shapes)


A, B, C = map(link, "abc")
MIMIC, NEEDS_FILE = '<mimic joint="k"/>', "needs the URDF's file"


def fixed(name: str, parent: str, child: str) -> str:
    return joint(name, "fixed", parent, child, "")


def bad_joint(inner: str, kind: str = "revolute") -> str:
    return urdf(A, B, joint("j", kind, "a", "b", inner))


#: A URDF, the line and the element that are named, and why.
BAD = [
    ("<sdf/>", 1, "sdf", "the root of a URDF is <robot>"),
    ("<robot><link name='a'/></robot>", 1, "robot", "its name is missing"),
    (urdf(), 1, "robot 'r'", "there are no links"),
    (urdf(A, B, A), 4, "link 'a'", "another link"),
    (urdf("<link/>"), 2, "link of robot 'r'", "its name is missing"),
    (urdf(A, '<link name="a&#10;b"/>'), 3, "link", "U\\+000A"),
    (urdf(A, B, C, fixed("j", "a", "b"), fixed("j", "b", "c")), 6, "joint 'j'", "another joint"),
    (urdf(A, fixed("j", "x", "a")), 3, "joint 'j'", "its parent 'x' is not a link"),
    (urdf(A, fixed("j", "a", "x")), 3, "joint 'j'", "its child 'x' is not a link"),
    (urdf(A, '<joint name="j" type="fixed"><parent link="a"/></joint>'), 3, "joint", "<child>"),
    (bad_joint("", "hinge"), 4, "joint 'j'", "its type must be one of fixed, .*'hinge'"),
    (urdf(A, B, C, fixed("j", "a", "c"), fixed("k", "b", "c")), 6, "joint 'k'",
     "joint 'j' has the same child 'c'"),
    (urdf(A, B), 1, "robot 'r'", "there are 2 roots: 'a', 'b'"),
    (urdf(A, B, fixed("j", "a", "b"), fixed("k", "b", "a")), 1, "robot 'r'", "joints form a loop"),
    (urdf(A, B, C, fixed("j", "c", "b"), fixed("k", "b", "c")), 5, "joint 'j'", "part of a loop"),
    (urdf(A, B, fixed("j", "b", "b")), 4, "joint 'j'", "part of a loop"),
    (bad_joint('<axis xyz="0 0 0"/>' + LIMIT), 4, "axis of joint 'j'", "zero"),
    (bad_joint(""), 4, "joint 'j'", "<limit> is missing"),
    (bad_joint('<limit lower="2" upper="1"/>'), 4, "limit of joint 'j'", "exceeds its upper 1.0"),
    (bad_joint('<limit lower="nan"/>'), 4, "limit of joint 'j'", "its lower must be of finite num"),
    (bad_joint('<origin xyz="0 inf 0"/>' + LIMIT), 4, "origin of joint 'j'", "finite"),
    (bad_joint('<origin xyz="0 1e301 0"/>' + LIMIT), 4, "origin of joint 'j'", "up to 1e\\+300"),
    (bad_joint('<origin xyz="0 1"/>' + LIMIT), 4, "origin", "3 numbers, got '0 1'"),
    (bad_joint('<origin rpy="0 pi 0"/>' + LIMIT), 4, "origin", "finite numbers.*'pi'"),
    (bad_joint('<origin rpy="0 1_0 0"/>' + LIMIT), 4, "origin", "'1_0'"),  # python's numbers
    (bad_joint('<origin quat_xyzw="0 0 0 0"/>' + LIMIT), 4, "origin", "zero"),
    (bad_joint("<origin/><origin/>" + LIMIT), 4, "origin of joint 'j'", "occurs 2 times"),
    (bad_joint('<mimic joint="j"/>' + LIMIT), 4, "joint 'j'", "mimics itself"),
    (urdf(A, B, C, fixed("k", "a", "b"), joint("j", "revolute", "b", "c", MIMIC + LIMIT)), 6,
     "joint 'j'", "it mimics the fixed joint 'k'"),
    (bad_joint(MIMIC, "planar"), 4, "mimic of joint 'j'", "a planar joint can't mimic"),
    (urdf('<link name="a"><collision/></link>'), 2, "collision of link 'a'", "<geometry> is miss"),
    (urdf(link("a", "")), 2, "geometry of collision", "got none"),
    (urdf(link("a", '<sphere radius="1"/><sphere radius="1"/>')), 2, "geometry", "got 2"),
    (urdf(link("a", '<sphere radius="-1"/>')), 2, "sphere", "radius must be positive"),
    (urdf(link("a", "<sphere/>")), 2, "sphere", "its radius is missing"),
    (urdf(link("a", '<box size="1 -1 1"/>')), 2, "box", "size must not be negative"),
    (urdf(link("a", "<box/>")), 2, "box", "its size is missing"),
    (urdf(link("a", '<capsule radius="1e300" length="1e300"/>')), 2, "capsule", "exceed"),
    (urdf(link("a", "<mesh/>")), 2, "mesh", "its filename is missing"),
    (urdf(link("a", '<mesh filename="a.stl" scale="1 0 1"/>')), 2, "mesh", "zero"),
    (urdf(link("a", '<mesh filename="a.stl"/>')), 2, "mesh", NEEDS_FILE),
    (urdf(link("a", '<mesh filename="http://a/b.stl"/>')), 2, "mesh", "only paths, file://"),
    (urdf(link("a", '<mesh filename="package://nix/b.stl"/>')), 2, "mesh",
     "package 'nix' is in none of package_dirs"),
    (urdf(link("a", '<mesh filename="file:///dev/zero"/>')), 2, "mesh", "not in a folder from"),
    ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n<xacro:macro/></robot>', 2, "",
     "run xacro"),
    (urdf("<link"), 3, "", "not valid XML"),
    ("<", 1, "", "not valid XML"),
]  # fmt: skip


def test_bad_urdfs_are_refused_with_the_place(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    for text, line, element, reason in BAD:
        error = bad(reason, text)
        assert (error.file, error.line) == ("urdf", line), reason
        assert error.element.startswith(element), reason
        assert str(error).startswith(f"urdf:{line}: "), reason
        file.write_text(text)
        if reason != NEEDS_FILE:
            assert str(bad(reason, file)).startswith(f"{file}:{line}: "), reason
    bad(r"none\.urdf: urdf: the file does not exist", tmp_path / "none.urdf")
    bad("srdf: it is not a regular file", urdf(A), tmp_path)


EMPTY = "solid part\nendsolid part\n"
ODD_LIMIT = '<limit lower="2" upper="1" velocity="{}"/>'
#: What ROS reads, and why it is a doubt.
ODD: dict[str | bytes, str] = {
    urdf(A).replace(
        "<robot", "<!-- a --><?xml version='1.0'?><robot", 1
    ): "its declaration is not at",
    b"<?xml version='0.0'?>" + urdf(A).encode(): "urdf:1: its version of XML is unknown",
    urdf(link("a", '<sphere radius="0"/>')): "urdf:2: sphere of .*: its radius is 0: it is left",
    urdf(link("a", '<cylinder radius="0" length="1"/>')): "its radius is 0: it is left out",
    mesh("package://bot/meshes/empty.stl"): "empty.stl: it has no triangles: it is",
    bad_joint('<limit velocity="-1"/>'): "its velocity -1.0 is negative: it is ignored",
    bad_joint(ODD_LIMIT.format(1), "continuous"): "2.0 exceeds .*: a continuous joint has",
    bad_joint(ODD_LIMIT.format(1), "fixed"): "lower 2.0 exceeds .*: a fixed joint has",
    urdf(A, '<sensor:camera name="c"/>', "<gazebo sensor:x='1'/>"): "3: a prefix is not declared",
}


def test_what_ros_reads_is_used_and_named(package: Path) -> None:
    (package / "meshes" / "empty.stl").write_text(EMPTY)
    for text, reason in ODD.items():
        robot = oc.Robot.from_urdf(text, package_dirs={"bot": package})
        assert re.search(reason, robot.doubts[0]), robot.doubts
        assert not robot.shapes[0]
        assert np.isinf(robot.velocity_limits).all() or "exceeds" in reason
    refused(
        r"empty\.stl: it has no triangles$", oc.shapes.Mesh.from_file, package / "meshes/empty.stl"
    )


def test_folders_of_meshes_have_the_name_that_the_call_has(package: Path) -> None:
    text = mesh(f"file://{package}/meshes/box.stl")
    bad("shares of installed packages and package_dirs$", text)
    bad("shares of installed packages and mesh_folders$", text, package_dirs=MeshFolders(("/opt",)))
    other = mesh("package://other/box.stl")
    bad("'other' is in none of package_dirs", other)
    bad("'other' is in none of mesh_folders", other, package_dirs=MeshFolders(("/opt",)))


def test_a_joint_that_mimics_nothing_moves_by_itself_and_is_named() -> None:
    robot = oc.Robot.from_urdf(bad_joint(MIMIC + LIMIT))
    assert robot.joint_names == ("j",)
    doubt, _ = robot.doubts  # the other one is that nothing collides with it
    assert doubt == "urdf:4: joint 'j': it mimics 'k', which is not a joint: it moves by itself"


ENTITY = '<!DOCTYPE r [<!ENTITY {}>]>\n<robot name="r"><link name="{}"/></robot>'
LAUGHS = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(12))
HOSTILE = {
    "entity": ENTITY.format('a "b"', "&a;"),
    "outside": ENTITY.format('a SYSTEM "file:///etc/passwd"', "&a;"),
    "parameter": ENTITY.format('% a SYSTEM "file:///etc/passwd"> %a;<!ENTITY b "c"', "a"),
    "document type": '<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/x.dtd">' + urdf(A),
    "laughs": f'<!DOCTYPE r [<!ENTITY l0 "lol">{LAUGHS}]>\n' + urdf('<link name="&l12;"/>'),
    "xacro without its namespace": urdf("<xacro:macro/>"),
    "a prefix, and no end": urdf("<a:b/>", "<c>"),
    "unknown entity": urdf('<link name="&a;"/>'),
    "deep": urdf(A, "<x>" * 61 + "</x>" * 61),
    "very deep": urdf(A, "<x>" * 100_000),
    "zero bytes": urdf('<link name="\0"/>'),
    "half a surrogate": urdf('<link name="\ud800"/>'),
    "control character": urdf('<link name="&#1;"/>'),
    "attribute twice": urdf('<link name="a" name="b"/>'),
    "include": '<robot name="r" xmlns:xi="http://www.w3.org/2001/XInclude">'
    '<xi:include href="/etc/passwd" parse="text"/></robot>',
}


def test_hostile_xml_is_refused_in_every_encoding() -> None:
    for text in HOSTILE.values():
        bad("urdf", text)
    for encoding in ("utf-8", "utf-16", "utf-16-le", "latin-1", "utf-32"):
        text = f'<?xml version="1.0" encoding="{encoding}"?>' + HOSTILE["entity"]
        bad("urdf", text.encode(encoding))


def test_limits_bound_what_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    many = urdf(A, "<x/>" * 20_000)
    assert oc.Robot.from_urdf(many).link_names == ("a",)
    monkeypatch.setattr(xml_values, "MOST_ELEMENTS", 10_000)
    bad("more than 10000 elements", many)
    monkeypatch.setattr(xml_values, "LARGEST", 50_000)
    bad("bytes, 50000 is the limit", many)


def test_there_are_no_more_links_and_shapes_than_can_be_paired_and_as_many_are_read() -> None:
    links = urdf(*(link(f"l{k}") for k in range(1001)))
    bad(r"^urdf:1002: link 'l1000': there are 1001 links, 1000 is", links)
    balls = urdf(link("a", *['<sphere radius="1"/>'] * 2001))
    bad("there are 2001 collision geometries, 2000 is the limit", balls)
    names = [f"l{k}" for k in range(999)]
    star = urdf(
        link("hub"), *(link(name, '<box size="1 1 1"/>') for name in names),
        *(joint(f"j{name}", "fixed", "hub", name, "") for name in names),
    )  # fmt: skip
    srdf = urdf(*(f'<disable_default_collisions link="{name}"/>' for name in names))
    robot = oc.Robot.from_urdf(star, srdf)
    assert len(robot.adjacent_pairs) == 999 * 998 // 2
    assert len(robot.disabled_pairs) == 1000 * 999 // 2


def test_comments_declarations_and_other_elements_are_no_harm() -> None:
    text = '\ufeff<?xml version="1.0"\n encoding="utf-16"?><!-- <!DOCTYPE --><?pi x?>' + urdf(
        A, '<gazebo reference="a"><mu1>1</mu1></gazebo>', "<transmission/>", "<!-- <link/> -->"
    )
    assert oc.Robot.from_urdf(text).link_names == ("a",)
    with pytest.raises(RobotError, match=r"^urdf:4: "):  # the declaration's line counts
        oc.Robot.from_urdf(text.replace("<gazebo", "<link/><gazebo"))

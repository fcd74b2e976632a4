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

"""What is wrong with a URDF is refused with its file, line and element; nothing else happens."""

from __future__ import annotations

from pathlib import Path

import pytest
from small_robots import LIMIT, joint, link, urdf

import obb_collision as oc
from obb_collision.robots.description import RobotError, xml_values

A, B, C = link("a"), link("b"), link("c")
FIXED = '<joint name="{}" type="fixed"><parent link="{}"/><child link="{}"/></joint>'


def bad_joint(inner: str, kind: str = "revolute") -> str:
    return urdf(A, B, joint("j", kind, "a", "b", inner))


BAD = {
    "root": ("<sdf/>", 1, "sdf", "the root of a URDF is <robot>"),
    "no name": ("<robot><link name='a'/></robot>", 1, "robot", "its name is missing"),
    "no links": (urdf(), 1, "robot 'r'", "there are no links"),
    "link twice": (urdf(A, B, A), 4, "link 'a'", "another link"),
    "link without name": (urdf("<link/>"), 2, "link of robot 'r'", "its name is missing"),
    "line break in name": (urdf(A, '<link name="a&#10;b"/>'), 3, "link", "U\\+000A"),
    "joint twice": (
        urdf(A, B, C, FIXED.format("j", "a", "b"), FIXED.format("j", "b", "c")), 6, "joint 'j'",
        "another joint",
    ),
    "parent": (urdf(A, FIXED.format("j", "x", "a")), 3, "joint 'j'", "its parent 'x' is no link"),
    "child": (urdf(A, FIXED.format("j", "a", "x")), 3, "joint 'j'", "its child 'x' is no link"),
    "no child": (urdf(A, '<joint name="j" type="fixed"><parent link="a"/></joint>'), 3,
                 "joint 'j'", "<child> is missing"),
    "kind": (bad_joint("", "hinge"), 4, "joint 'j'", "its type must be one of fixed, .*'hinge'"),
    "two parents": (
        urdf(A, B, C, FIXED.format("j", "a", "c"), FIXED.format("k", "b", "c")), 6, "joint 'k'",
        "joint 'j' has the same child 'c'",
    ),
    "two roots": (urdf(A, B), 1, "robot 'r'", "there are 2 roots: 'a', 'b'"),
    "loop": (urdf(A, B, FIXED.format("j", "a", "b"), FIXED.format("k", "b", "a")), 1, "robot 'r'",
             "the joints form a loop"),
    "loop beside": (
        urdf(A, B, C, FIXED.format("j", "c", "b"), FIXED.format("k", "b", "c")), 5, "joint 'j'",
        "part of a loop",
    ),
    "to itself": (urdf(A, B, FIXED.format("j", "b", "b")), 4, "joint 'j'", "part of a loop"),
    "zero axis": (bad_joint('<axis xyz="0 0 0"/>' + LIMIT), 4, "axis of joint 'j'", "zero"),
    "no limit": (bad_joint(""), 4, "joint 'j'", "<limit> is missing"),
    "limits": (bad_joint('<limit lower="2" upper="1"/>'), 4, "limit of joint 'j'",
               "its lower 2.0 exceeds its upper 1.0"),
    "velocity": (bad_joint('<limit velocity="-1"/>'), 4, "limit of joint 'j'", "not be negative"),
    "nan": (bad_joint('<limit lower="nan" upper="1"/>'), 4, "limit of joint 'j'",
            "its lower must be of finite numbers"),
    "infinite": (bad_joint('<origin xyz="0 inf 0"/>' + LIMIT), 4, "origin of joint 'j'", "finite"),
    "too large": (bad_joint('<origin xyz="0 1e301 0"/>' + LIMIT), 4, "origin of joint 'j'",
                  "up to 1e\\+300"),
    "two numbers": (bad_joint('<origin xyz="0 1"/>' + LIMIT), 4, "origin", "3 numbers, got '0 1'"),
    "words": (bad_joint('<origin rpy="0 pi 0"/>' + LIMIT), 4, "origin", "finite numbers.*'pi'"),
    "python's numbers": (bad_joint('<origin rpy="0 1_0 0"/>' + LIMIT), 4, "origin", "'1_0'"),
    "zero quaternion": (bad_joint('<origin quat_xyzw="0 0 0 0"/>' + LIMIT), 4, "origin", "zero"),
    "two origins": (bad_joint("<origin/><origin/>" + LIMIT), 4, "origin of joint 'j'", "are 2"),
    "mimics itself": (bad_joint('<mimic joint="j"/>' + LIMIT), 4, "joint 'j'", "mimics itself"),
    "mimics a fixed one": (
        urdf(A, B, C, FIXED.format("k", "a", "b"),
             joint("j", "revolute", "b", "c", '<mimic joint="k"/>' + LIMIT)), 6, "joint 'j'",
        "it mimics the fixed joint 'k'",
    ),
    "a planar one mimics": (bad_joint('<mimic joint="k"/>', "planar"), 4, "mimic of joint 'j'",
                            "a planar joint can't mimic"),
    "no geometry": (urdf('<link name="a"><collision/></link>'), 2, "collision of link 'a'",
                    "<geometry> is missing"),
    "empty geometry": (urdf(link("a", "")), 2, "geometry of collision", "got none"),
    "two geometries": (
        urdf(link("a", '<sphere radius="1"/><sphere radius="1"/>')), 2, "geometry", "got 2"
    ),
    "radius": (urdf(link("a", '<sphere radius="0"/>')), 2, "sphere", "radius must be positive"),
    "no radius": (urdf(link("a", "<sphere/>")), 2, "sphere", "its radius is missing"),
    "size": (urdf(link("a", '<box size="1 -1 1"/>')), 2, "box", "size must not be negative"),
    "no size": (urdf(link("a", "<box/>")), 2, "box", "its size is missing"),
    "huge": (urdf(link("a", '<capsule radius="1e300" length="1e300"/>')), 2, "capsule", "exceed"),
    "mesh without file": (urdf(link("a", "<mesh/>")), 2, "mesh", "its filename is missing"),
    "flat mesh": (urdf(link("a", '<mesh filename="a.stl" scale="1 0 1"/>')), 2, "mesh", "zero"),
    "no folder": (urdf(link("a", '<mesh filename="a.stl"/>')), 2, "mesh", "needs the URDF's file"),
    "http": (urdf(link("a", '<mesh filename="http://a/b.stl"/>')), 2, "mesh", "only paths, file://"),
    "package": (urdf(link("a", '<mesh filename="package://nix/b.stl"/>')), 2, "mesh",
                "package 'nix' is in none of package_dirs"),
    "device": (urdf(link("a", '<mesh filename="file:///dev/zero"/>')), 2, "mesh", "no folder from"),
    "xacro": ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">\n<xacro:macro/></robot>',
              2, "", "run xacro"),
    "no XML": (urdf("<link"), 3, "", "no XML"),
    "nothing": ("<", 1, "", "no XML"),
}  # fmt: skip


def test_bad_urdfs_are_refused_with_the_place(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    for name, (text, line, element, reason) in BAD.items():
        with pytest.raises(RobotError, match=reason) as caught:
            oc.Robot.from_urdf(text)
        error = caught.value
        assert (error.file, error.line) == ("urdf", line), name
        assert error.element.startswith(element), name
        assert str(error).startswith(f"urdf:{line}: "), name
        file.write_text(text)
        if name != "no folder":
            with pytest.raises(RobotError, match=reason) as caught:
                oc.Robot.from_urdf(file)
            assert str(caught.value).startswith(f"{file}:{line}: "), name


def test_a_file_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(RobotError, match=r"none\.urdf: urdf: there is no such file"):
        oc.Robot.from_urdf(tmp_path / "none.urdf")
    with pytest.raises(RobotError, match="srdf: it is no regular file"):
        oc.Robot.from_urdf(urdf(A), tmp_path)


def test_a_joint_that_mimics_nothing_moves_by_itself_and_is_named() -> None:
    robot = oc.Robot.from_urdf(bad_joint('<mimic joint="k"/>' + LIMIT))
    assert robot.joint_names == ("j",)
    assert robot.doubts == (
        "urdf:4: joint 'j': it mimics 'k', which is no joint: it moves by itself",
    )


ENTITY = '<!DOCTYPE r [<!ENTITY {}>]>\n<robot name="r"><link name="{}"/></robot>'
LAUGHS = "".join(f'<!ENTITY l{k + 1} "{f"&l{k};" * 10}">' for k in range(12))
HOSTILE = {
    "entity": ENTITY.format('a "b"', "&a;"),
    "outside": ENTITY.format('a SYSTEM "file:///etc/passwd"', "&a;"),
    "parameter": ENTITY.format('% a SYSTEM "file:///etc/passwd"> %a;<!ENTITY b "c"', "a"),
    "document type": '<!DOCTYPE robot SYSTEM "http://127.0.0.1:9/x.dtd">' + urdf(A),
    "laughs": f'<!DOCTYPE r [<!ENTITY l0 "lol">{LAUGHS}]>\n' + urdf('<link name="&l12;"/>'),
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
    texts: list[str | bytes] = [*HOSTILE.values()]
    for encoding in ("utf-8", "utf-16", "utf-16-le", "latin-1", "utf-32"):
        text = f'<?xml version="1.0" encoding="{encoding}"?>' + HOSTILE["entity"]
        texts.append(text.encode(encoding))
    for each in texts:
        with pytest.raises(RobotError):
            oc.Robot.from_urdf(each)


def test_limits_bound_what_is_read(monkeypatch: pytest.MonkeyPatch) -> None:
    many = urdf(A, "<x/>" * 20_000)
    assert oc.Robot.from_urdf(many).link_names == ("a",)
    monkeypatch.setattr(xml_values, "MOST_ELEMENTS", 10_000)
    with pytest.raises(RobotError, match="more than 10000 elements"):
        oc.Robot.from_urdf(many)
    monkeypatch.setattr(xml_values, "LARGEST", 50_000)
    with pytest.raises(RobotError, match="bytes, 50000 is the limit"):
        oc.Robot.from_urdf(many)


def test_there_are_no_more_links_and_shapes_than_can_be_paired() -> None:
    with pytest.raises(
        RobotError, match=r"^urdf:1002: link 'l1000': there are 1001 links, 1000 is"
    ):
        oc.Robot.from_urdf(urdf(*(link(f"l{k}") for k in range(1001))))
    many = ['<sphere radius="1"/>'] * 2001
    with pytest.raises(RobotError, match="there are 2001 collision geometries, 2000 is the limit"):
        oc.Robot.from_urdf(urdf(link("a", *many)))


def test_as_many_links_as_there_may_be_are_read_whatever_connects_them() -> None:
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

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

"""What an SRDF says of a robot, and what it names that the robot has not."""

from __future__ import annotations

import pytest
from urdfs import joint, link, urdf

import obb_collision as oc
from obb_collision.robots.description.xml_values import RobotError

BALL = '<sphere radius="0.1"/>'
ARM = urdf(
    link("a", BALL), link("b", BALL), link("frame"), link("c", BALL), link("d", BALL),
    joint("ab", "revolute", "a", "b"), joint("bf", "fixed", "b", "frame", ""),
    joint("fc", "revolute", "frame", "c"), joint("fd", "revolute", "frame", "d"),
)  # fmt: skip


def robot(*elements: str) -> oc.Robot:
    return oc.Robot.from_urdf(ARM, urdf(*elements))


def test_links_are_adjacent_through_links_without_shapes() -> None:
    pairs = {("a", "b"), ("b", "c"), ("b", "d"), ("c", "d")}
    assert oc.Robot.from_urdf(ARM).adjacent_pairs == pairs


def test_pairs_are_disabled_by_name_and_by_default() -> None:
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
    )
    groups = {name: (group.joints, group.links) for name, group in found.groups.items()}
    assert groups == {
        "chain": (("ab", "bf", "fc"), ("b", "frame", "c")),
        "link": (("fd",), ("d",)),
        "joint": (("ab",), ("b",)),
        "both": (("ab", "fd"), ("b", "d")),
        "none": ((), ()),
    }


def test_states_of_groups_have_values_by_joint() -> None:
    found = robot('<group_state name="home" group="g"><joint name="ab" value="1.5"/></group_state>')
    assert found.group_states == {("g", "home"): {"ab": (1.5,)}}


def test_end_effectors_have_a_group() -> None:
    found = robot('<end_effector name="tool" parent_link="a" group="g"/>')
    assert found.end_effectors == {"tool": "g"}


DOUBTS = {
    '<disable_collisions link1="a" link2="x"/>': "its link2 'x' is no link of the robot",
    '<disable_default_collisions link="x"/>': "its link 'x' is no link",
    '<group name="g"><link name="x"/></group>': "its name 'x' is no link",
    '<group name="g"><chain base_link="d" tip_link="c"/></group>': "is not above its tip_link",
    '<virtual_joint name="v" type="fixed" parent_frame="w" child_link="b"/>': "is not the root",
}


def test_what_the_robot_has_not_is_a_doubt_with_its_line() -> None:
    for element, reason in DOUBTS.items():
        found = robot(element)
        assert len(found.doubts) == 1, element
        assert found.doubts[0].startswith("srdf:2: ")
        assert reason in found.doubts[0]
        assert found.disabled_pairs == frozenset()
    assert "of another robot" in oc.Robot.from_urdf(ARM, '<robot name="s"/>').doubts[0]


BAD = {
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
    for element, reason in BAD.items():
        with pytest.raises(RobotError, match=rf"^srdf:2: .*{reason}"):
            robot(element)
    with pytest.raises(RobotError, match=r"^srdf:2: a document type"):
        oc.Robot.from_urdf(ARM, '<!DOCTYPE r [<!ENTITY a "b">]>\n<robot name="r"/>')
    with pytest.raises(RobotError, match="the root of an SRDF"):
        oc.Robot.from_urdf(ARM, "<sdf/>")


def test_groups_and_doubts_have_limits() -> None:
    with pytest.raises(RobotError, match="there are 1001 groups, 1000 is the limit"):
        robot(*(f'<group name="g{k}"/>' for k in range(1001)))
    chains = '<chain base_link="a" tip_link="c"/>' * 10_001
    with pytest.raises(RobotError, match="there are 10001 parts of groups"):
        robot(f'<group name="g">{chains}</group>')
    nested = [f'<group name="g{k}"><group name="g{k + 1}"/></group>' for k in range(1000)]
    assert len(robot(*nested).groups) == 1000
    found = robot(*('<disable_collisions link1="x" link2="y"/>' for _ in range(200)))
    assert len(found.doubts) == 100

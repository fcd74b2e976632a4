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

"""Mutated descriptions of robots: elements, names and numbers changed, in URDF and SRDF at once."""

from __future__ import annotations

import re
from pathlib import Path
from random import Random

from obb_collision.robots.description.robot import Robot
from tools.fuzz.files.meshes import OBJ
from tools.fuzz.mutations.data import damaged

MESH = "part.obj"
"""The mesh of the robot, in the folder of its URDF."""
JOINTS = """
<joint name="j{k}" type="{kind}"><parent link="l{k}"/><child link="l{n}"/>
<origin xyz="0 0 0.1" rpy="0.1 0 0"/><axis xyz="0 1 0"/>
<limit lower="-1" upper="1" velocity="1" effort="1"/>
{mimic}</joint>"""
LINKS = """
<link name="l{k}">
<collision><origin xyz="0.1 0 0"/>
<geometry>{geometry}</geometry></collision></link>"""
GEOMETRIES = (
    '<box size="1 1 1"/>', '<sphere radius="1"/>', '<cylinder radius="1" length="2"/>',
    '<capsule radius="1" length="2"/>', f'<mesh filename="{MESH}" scale="1 1 -1"/>',
    '<mesh filename="package://bot/part.obj"/>',
)  # fmt: skip
KINDS = ("revolute", "continuous", "prismatic", "planar", "floating", "fixed")
SRDF = """<robot name="bot">
<virtual_joint name="v" type="planar" parent_frame="world" child_link="l0"/>
<group name="a"><chain base_link="l0" tip_link="l3"/></group>
<group name="b"><group name="a"/><joint name="j4"/><link name="l5"/></group>
<group_state name="s" group="a"><joint name="j0" value="0.5"/></group_state>
<disable_default_collisions link="l1"/>
<enable_collisions link1="l1" link2="l2"/>
<disable_collisions link1="l0" link2="l3"/>
</robot>"""
VALUES = (
    *("nan", "inf", "-inf", "1e308", "1e999", "-1", "0", "", "0x10", "1_0", "é", "\u0663", "1,5"),
    *("1 2", "1 2 3", "0 0 0", "1 2 3 4", "l0", "l1", "j0", "j1", "v", "x" * 1_000_000),
    *("file:///dev/zero", "package://bot/../../etc/passwd", "../../../../etc/passwd", MESH),
    *("http://127.0.0.1:9/a.stl", "&amp;", "&#0;", "&a;", "&#1114111;", "&lt;", "<", '"'),
)
INSERTED = (
    '<!DOCTYPE robot [<!ENTITY a "b">]>', '<!ENTITY a SYSTEM "file:///etc/passwd">', "<!--", "-->",
    "<![CDATA[", "<?xml version='1.0'?>", "<x>" * 100, "<x/>" * 1000, "</robot>", "<robot>",
    '<robot xmlns="http://www.ros.org/wiki/xacro">', "<link/>", "<joint/>", "<collision/>",
    "<mimic joint='j0'/>", "<origin quat_xyzw='0 0 0 0'/>",
)  # fmt: skip


def urdf() -> str:
    """Return a robot with every kind of joint and geometry."""
    links = [LINKS.format(k=k, geometry=one) for k, one in enumerate((*GEOMETRIES, ""))]
    links[-1] = '<link name="l6"/>'
    joints = [
        JOINTS.format(k=k, n=k + 1, kind=kind, mimic='<mimic joint="j0"/>' if k == 1 else "")
        for k, kind in enumerate(KINDS)
    ]
    return '<robot name="bot">' + "\n".join(links + joints) + "\n</robot>"


def mutated_robot(seed: int, number: int) -> tuple[bytes, bytes]:
    """Return a URDF and an SRDF of which one was changed, or both, by their number."""
    random = Random(f"{seed} robot {number}")
    return mutated(urdf(), random), mutated(SRDF, random)


def mutated(text: str, random: Random) -> bytes:
    """Return a description with some lines changed, or none."""
    lines = text.splitlines()
    for _ in range(random.choice((0, 0, 1, 1, 2, 4))):
        row = random.randrange(len(lines))
        choice = random.random()
        if choice < 0.15:
            del lines[row]
        elif choice < 0.3:
            lines.insert(row, random.choice(lines))
        elif choice < 0.45:
            lines.insert(row, random.choice(INSERTED))
        else:
            lines[row] = _with_other_value(lines[row], random)
        lines = lines or [""]
    data = "\n".join(lines).encode()
    return damaged(data, random) if random.random() < 0.1 else data


def _with_other_value(line: str, random: Random) -> str:
    """Replace the value of an attribute, or its name, or that of an element."""
    found = list(re.finditer(r'"[^"]*"|\b\w+(?==)|(?<=<)\w+', line))
    if not found:
        return random.choice(VALUES)
    one = random.choice(found)
    value = random.choice(VALUES)
    return line[: one.start()] + (f'"{value}"' if line[one.start()] == '"' else value) + line[
        one.end() :
    ]  # fmt: skip


def read_robot(folder: Path, seed: int, number: int) -> str:
    """Read a robot and place its links; returns why it was refused, or an empty text."""
    (folder / MESH).write_bytes(OBJ)
    for name, data in zip(("bot.urdf", "bot.srdf"), mutated_robot(seed, number), strict=True):
        (folder / name).write_bytes(data)
    try:
        robot = Robot.from_urdf(
            folder / "bot.urdf", folder / "bot.srdf", {"bot": folder},
            move_virtual_joint=bool(number % 2),
        )  # fmt: skip
        robot.link_poses([1.0] * len(robot.joint_names))
    except ValueError as error:
        return f"{type(error).__name__}: {error}"
    return ""

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

"""A robot from its URDF: names, limits, poses."""

import math
from pathlib import Path

import numpy as np
import pytest

import obb_collision as oc
from obb_collision.robots.description.xml_values import RobotError


def urdf(*elements: str) -> str:
    """Return a URDF with a robot of some elements."""
    return '<robot name="r">\n' + "\n".join(elements) + "\n</robot>"


def joint(name: str, kind: str, parent: str, child: str, inner: str = "") -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inner}</joint>"
    )


LIMIT = '<limit lower="-1" upper="2" velocity="3" effort="1"/>'
ARM = urdf(
    '<link name="a"/>', '<link name="b"/>', '<link name="c"/>', '<link name="d"/>',
    joint("second", "prismatic", "b", "c", LIMIT),
    joint("first", "revolute", "a", "b", LIMIT + '<axis xyz="0 0 2"/><origin xyz="1 0 0"/>'),
    joint("third", "continuous", "b", "d", '<mimic joint="first" multiplier="-1" offset="0.5"/>'),
)  # fmt: skip


def test_names_are_in_the_order_of_the_tree() -> None:
    robot = oc.Robot.from_urdf(ARM)
    assert robot.name == "r"
    assert robot.link_names == ("a", "b", "c", "d")
    assert robot.joint_names == ("first", "second")
    assert robot.lower.tolist() == [-1, -1]
    assert robot.upper.tolist() == [2, 2]
    assert robot.velocity_limits.tolist() == [3, 3]


def test_links_move_with_their_joints() -> None:
    robot = oc.Robot.from_urdf(ARM)
    poses = robot.link_poses([[math.pi / 2, 0.5], [0.0, 0.0]])
    assert poses.shape == (2, 4, 7)
    half = math.sqrt(0.5)
    np.testing.assert_allclose(poses[0, 1], [1, 0, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[0, 2], [1, 0.5, 0, 0, 0, half, half], atol=1e-15)
    np.testing.assert_allclose(poses[1, 3, 3:], [math.sin(0.25), 0, 0, math.cos(0.25)], atol=1e-15)
    assert np.array_equal(robot.link_poses([math.pi / 2, 0.5]), poses[0])


def test_an_error_names_file_line_and_element(tmp_path: Path) -> None:
    file = tmp_path / "bad.urdf"
    file.write_text(ARM.replace('lower="-1"', 'lower="3"'))
    with pytest.raises(RobotError, match=r"bad\.urdf:6: limit of joint 'second': its lower 3\.0"):
        oc.Robot.from_urdf(file)

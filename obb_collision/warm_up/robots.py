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

"""Robots: their kinematics, checks of their states and motions, and pairs of their links."""

from __future__ import annotations

import numpy as np

import obb_collision as oc

_BODY = """<collision><geometry><cylinder radius="0.05" length="0.2"/></geometry></collision>
<collision><geometry><sphere radius="0.1"/></geometry></collision>
<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>"""
_LINKS = "".join(f'<link name="{name}">{_BODY}</link>' for name in "abcd")
_JOINTS = "".join(
    f'<joint name="{a}{b}" type="revolute"><parent link="{a}"/><child link="{b}"/>'
    '<origin xyz="0 0 0.3"/><axis xyz="0 1 0"/><limit lower="-2" upper="2"/></joint>'
    for a, b in ("ab", "bc", "cd")
)
ARM = f'<robot name="arm">{_LINKS}{_JOINTS}</robot>'


def run() -> None:
    """Run what robots need, with a scene of every kind of shape."""
    robot = oc.Robot.from_urdf(ARM)
    robot.link_poses(np.zeros(3))
    scene = oc.Scene()
    scene.add("floor", oc.shapes.Box((4.0, 4.0, 0.1)), (0.0, 0.0, -0.3, 0.0, 0.0, 0.0, 1.0))
    scene.add("ball", oc.shapes.Sphere(0.1), (0.3, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0))
    scene.add("pole", oc.shapes.Cylinder(0.1, 1.0), (0.5, 0.0, 0.6, 0.0, 0.0, 0.0, 1.0))
    checker = oc.RobotScene([robot], scene)
    states = np.array([[0.0, 0.0, 0.0], [1.5, 0.5, 1.0], [0.5, 1.9, 1.9]])
    for accuracy in ("sphere", "aabb", "obb", "hull", "mesh"):
        checker.accuracy = accuracy
        checker.check(states)
        checker.check(states, all_pairs=True)
        checker.check_motions(states[:2], states[1:])
        checker.distances(states)
    checker.check_path(states)
    oc.prove_pairs(robot, 1.0)

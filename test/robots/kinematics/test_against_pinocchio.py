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

"""Link poses equal those of pinocchio on all robots of example-robot-data, where both are there."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from each import each
from scipy.spatial.transform import Rotation

import obb_collision as oc
from obb_collision.robots.description import driven

pinocchio: Any = pytest.importorskip("pinocchio")
try:
    files = importlib.metadata.files("example-robot-data") or []
except importlib.metadata.PackageNotFoundError:
    pytest.skip("example-robot-data is not installed", allow_module_level=True)

URDFS = sorted(Path(str(file.locate())).resolve() for file in files if file.suffix == ".urdf")
SHARE = next(folder for folder in URDFS[0].parents if folder.name == "share")
#: Metres and radians: pinocchio's rounding errors, along the longest of the chains, reach 1e-14.
TOLERANCE = 1e-12
STATES = 20


def test_there_are_as_many_as_there_were() -> None:
    assert len(URDFS) >= 69


def robot_of(file: Path) -> oc.Robot:
    """Return a robot, all of whose meshes are one triangle: only its links matter here."""

    def triangle(path: Path, scale: tuple[float, float, float]) -> oc.shapes.Mesh:
        return oc.shapes.Mesh(np.eye(3), [[0, 1, 2]], scale)

    return oc.Robot.from_urdf(file, package_dirs=[SHARE], read_mesh=triangle)


@each("file", URDFS)
def test_link_poses_are_pinocchios(file: Path) -> None:
    if "<link" not in file.read_text():
        with pytest.raises(ValueError, match="there are no links"):
            robot_of(file)
        return
    robot = robot_of(file)
    model = pinocchio.buildModelFromUrdf(str(file))
    data = model.createData()
    states = np.random.default_rng(7).uniform(-3.0, 3.0, (STATES, len(robot.joint_names)))
    poses = robot.link_poses(states)
    for state, pose in zip(states, poses, strict=True):
        pinocchio.framesForwardKinematics(model, data, configuration(robot, model, state))
        for link, name in enumerate(robot.link_names):
            frame = data.oMf[model.getFrameId(name, pinocchio.FrameType.BODY)]
            np.testing.assert_allclose(pose[link, :3], frame.translation, rtol=0, atol=TOLERANCE)
            rotation = Rotation.from_quat(pose[link, 3:]).as_matrix()
            np.testing.assert_allclose(rotation, frame.rotation, rtol=0, atol=TOLERANCE)


def configuration(robot: oc.Robot, model: Any, state: np.ndarray) -> np.ndarray:
    """Return pinocchio's numbers for a state: joints that mimic others have some of their own."""
    values = dict(zip(robot.joint_names, state, strict=True))
    joints = {joint.name: joint for joint in robot.joints}
    numbers = pinocchio.neutral(model)
    for name, joint in zip(model.names[1:], list(model.joints)[1:], strict=True):
        if name + "/trans_x" in values:
            parts = ("trans_x", "trans_y", "trans_z", "rot_x", "rot_y", "rot_z", "rot_w")
            free = np.array([values[f"{name}/{part}"] for part in parts])
            free[3:] /= np.linalg.norm(free[3:])
            numbers[joint.idx_q : joint.idx_q + 7] = free
            continue
        driver, multiplier, offset = driven(joints[name], joints)
        value = multiplier * values[driver] + offset
        given = value if joint.nq == 1 else (np.cos(value), np.sin(value))
        numbers[joint.idx_q : joint.idx_q + joint.nq] = given
    return numbers
